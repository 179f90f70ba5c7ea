"""`track-range calibrate drive`: calibrates one camera from its drives."""

from functools import partial

from track_range.calibration.drive.calibration import DriveCalibration, calibrate_from_drives
from track_range.calibration.drive.known_metres import Detect
from track_range.calibration.settings import DriveSettings
from track_range.cli.shared.console import console, print_grid, print_line
from track_range.cli.shared.parameters import command
from track_range.detection.catalogue.lookup import DEFAULT_MODEL
from track_range.foundation.files.input_files import counted
from track_range.run.options.opened import DetectorOptions, open_detector
from track_range.run.progress import step_progress
from track_range.run.ready_model import ready_model
from track_range.stereo.calibration.boards import CalibrationError
from track_range.views.tables import SIGMA, Column, grid_of


def calibrate_from_drives_and_print(settings: DriveSettings) -> None:
    """Calibrate the camera, print what its recordings show, and write the files of the settings."""

    def open_detect() -> Detect:
        network = open_detector(
            ready_model(settings.detector or DEFAULT_MODEL, console), DetectorOptions()
        )
        return lambda frame: network.detect(frame.left)

    calibration = calibrate_from_drives(settings, open_detect, partial(step_progress, console))
    mounted = calibration.mounted
    frames, vehicles = (
        counted(mounted.n_frames, "frame"),
        counted(mounted.shapes.n_tracks, "vehicle"),
    )
    of = "the video" if len(settings.recordings) == 1 else f"{len(settings.recordings)} videos"
    print_line(console, f"{frames} of {of}, {vehicles}.")
    _print_sources(calibration)
    _print_residuals(calibration)
    print_line(console, *calibration.sentences, *mounted.estimate.advice)
    if calibration.fit.contradiction != 1.0 and not settings.force:
        raise CalibrationError(
            "expected measurements that agree, found a contradiction (see the warning), so "
            f"{settings.out or 'a calibration'} was not written; correct the boxes or metres, or "
            "give --force to write it with larger sigmas."
        )
    if files := calibration.save(settings):
        print_line(console, f"Written: {', '.join(map(str, files))}.")


def _print_sources(calibration: DriveCalibration) -> None:
    """Print the focal length by each source, and by all of them."""
    estimate = calibration.mounted.estimate.summary()
    rows = [*estimate["sources"], {**estimate, "source": "all", "sigma": estimate["focal_sigma"]}]
    columns = [
        Column("focal length px", [row["focal_px"] for row in rows], "{:.0f}"),
        Column(f"{SIGMA} %", [100 * row["sigma"] for row in rows], "{:.1f}"),
        Column("weight %", [100 * row.get("weight", 1.0) for row in rows], "{:.0f}"),
    ]
    names = [row["source"] for row in rows]
    print_grid(console, grid_of("Focal length by source", "source", names, columns))


def _print_residuals(calibration: DriveCalibration) -> None:
    residuals = calibration.fit.residuals
    if not residuals:
        return
    columns = [
        Column("measured - fitted", [residual.value for residual in residuals], "{:+.1f}"),
        Column(SIGMA, [residual.sigma for residual in residuals], "{:.1f}"),
    ]
    names = [f"{residual.name}: {residual.kind}, {residual.unit}" for residual in residuals]
    print_grid(console, grid_of("Residuals", "measurement", names, columns))


app = command(DriveSettings, calibrate_from_drives_and_print)
