"""`track-range calibrate ground`: fits the plane of the road of a camera that stands still."""

from track_range.calibration.ground import calibrate_ground
from track_range.calibration.settings import GroundCalibrationSettings
from track_range.cli.shared.console import console, print_grid, print_line
from track_range.cli.shared.parameters import command
from track_range.views.tables import SIGMA, Column, grid_of


def calibrate_and_print(settings: GroundCalibrationSettings) -> None:
    """Fit the plane, print what it is known to, and write the files of the settings."""
    calibration = calibrate_ground(settings)
    residuals = calibration.plane.residuals
    columns = [
        Column("measured - fitted", [residual.value for residual in residuals], "{:+.2f}"),
        Column(SIGMA, [residual.sigma for residual in residuals], "{:.2f}"),
    ]
    names = [f"{residual.name}, {residual.unit}" for residual in residuals]
    print_grid(console, grid_of("Residuals", "measurement", names, columns))
    print_line(console, *calibration.sentences)
    print_line(console, f"Written: {', '.join(calibration.save(settings))}.")


app = command(GroundCalibrationSettings, calibrate_and_print)
