"""`track-range calibrate`: calibrates a camera or a stereo pair from images of a board, or one
camera from a drive.
"""

from collections.abc import Mapping, Sequence
from functools import partial

from track_range.calibration.from_boards import LENS_NAMES, calibrate_views, find_boards
from track_range.calibration.settings import CalibrationSettings
from track_range.cli.shared.console import console, print_grid, print_line
from track_range.cli.shared.lazy import Lazy
from track_range.cli.shared.parameters import command_group
from track_range.foundation.errors import UsageError
from track_range.run.progress import step_progress
from track_range.stereo.calibration.board_views import RejectedView
from track_range.stereo.calibration.coverage import view_shape
from track_range.stereo.calibration.one_camera import CameraCalibration, ViewFit
from track_range.stereo.calibration.two_cameras import PairCalibration, PairFit
from track_range.views.tables import Column, grid_of

_BOARD_OPTIONS = ("square_mm", "lens_terms", "picture")
_ROAD_OPTIONS = (
    *("known_distance", "known_height", "known_width", "known_lane_width"),
    *("camera_height_m", "camera_model", "lens_fov_deg", "force"),
)
_N_COEFFICIENTS = (0, 4, 5, 8)


def _calibrate(settings: CalibrationSettings) -> None:
    _check(settings)
    if settings.is_from_road:
        from track_range.cli.commands.calibrate.drive import calibrate_from_drives_and_print

        calibrate_from_drives_and_print(settings.of_drive)
        return
    progress = partial(step_progress, console)
    search = find_boards(settings, progress)
    unit = "pairs" if search.shots and len(search.shots[0]) == 2 else "images"
    print_line(
        console, *search.notes, f"Board found in {len(search.shots)} of {search.n_images} {unit}."
    )
    _print_rejected(search.rejected)
    calibration = calibrate_views(search, settings, progress)
    _print_rejected(calibration.result.rejected)
    _print_views(calibration.result.fits)
    _print_cameras(calibration.cameras)
    if isinstance(calibration.result, PairCalibration):
        _print_pair(calibration.result)
    warnings = (f"Warning: {warning}" for warning in calibration.warnings)
    print_line(console, "± = standard deviation (jackknife over views).", *warnings)
    print_line(console, f"Written: {', '.join(map(str, calibration.save(settings)))}.")


def _check(settings: CalibrationSettings) -> None:
    """Raise UsageError for impossible lenses, and for options of the other calibration (from the
    road or boards).
    """
    if settings.is_from_road and settings.lens != "pinhole":
        raise UsageError(
            f"--lens {settings.lens}: expected --board, since a drive shows the distortion of a "
            "pinhole only."
        )
    fields = CalibrationSettings.model_fields
    for name in _BOARD_OPTIONS if settings.is_from_road else _ROAD_OPTIONS:
        if getattr(settings, name) != fields[name].default:
            expected = (
                "expected --board"
                if settings.is_from_road
                else "expected one camera and no --board"
            )
            raise UsageError(
                f"{settings.flag(name)}: {expected}; omit this option, or correct the "
                "other options."
            )
    if settings.is_from_road:
        return
    if settings.lens_terms not in _N_COEFFICIENTS:
        numbers = ", ".join(map(str, _N_COEFFICIENTS))
        raise UsageError(f"--lens-terms {settings.lens_terms}: expected one of {numbers}.")
    if settings.lens not in LENS_NAMES:
        raise UsageError(f"--lens {settings.lens}: expected one of {', '.join(LENS_NAMES)}.")
    if settings.lens != "pinhole" and settings.lens_terms != fields["lens_terms"].default:
        raise UsageError(
            "--lens-terms: expected --lens pinhole, since a fisheye always has four terms; omit "
            "--lens-terms."
        )


def _print_rejected(rejected: Sequence[RejectedView]) -> None:
    """Print a line per kind of reason, with the names of its views."""
    by_kind: dict[str, list[RejectedView]] = {}
    for view in rejected:
        by_kind.setdefault(view.reason.partition(":")[0], []).append(view)
    for kind, views in by_kind.items():
        shown = ", ".join(view.name for view in views[:8]) + (
            f" and {len(views) - 8} more" if len(views) > 8 else ""
        )
        print_line(console, f"Rejected: {shown}: {views[0].reason if len(views) == 1 else kind}.")


def _print_views(fits: Sequence[ViewFit] | Sequence[PairFit]) -> None:
    lefts = [fit.left if isinstance(fit, PairFit) else fit for fit in fits]
    columns = [
        Column("residual px", [fit.rms_px for fit in fits], "{:.2f}"),
        Column(
            "vertical px",
            [fit.row_error_px if isinstance(fit, PairFit) else None for fit in fits],
            "{:.2f}",
        ),
        Column("tilt deg", [fit.tilt_deg for fit in lefts], "{:.0f}"),
        Column("size %", [100 * float(view_shape(fit.view)[2]) for fit in lefts], "{:.0f}"),
        Column("corner blur px", [fit.view.edge_px for fit in lefts], "{:.1f}"),
    ]
    print_grid(console, grid_of("Views used", "view", [fit.view.name for fit in lefts], columns))


def _print_cameras(cameras: Mapping[str, CameraCalibration]) -> None:
    for name, calibration in cameras.items():
        camera, std, coverage = calibration.camera, calibration.std, calibration.coverage
        spans = (coverage.x_span, coverage.y_span, coverage.size_range)
        width, height, sizes = (f"{100 * low:.0f} to {100 * high:.0f} %" for low, high in spans)
        lens = ", ".join(f"{term:.4g}" for term in camera.distortion) or "none"
        model = f" of the lens model {camera.lens}" if camera.is_wide else ""
        margin = " " * len(name)
        print_line(
            console,
            f"{name}: fx {camera.fx_px:.2f} ± {std.fx_px:.2f}, fy {camera.fy_px:.2f} ± "
            f"{std.fy_px:.2f}, cx {camera.cx_px:.2f} ± {std.cx_px:.2f}, cy {camera.cy_px:.2f} ± "
            f"{std.cy_px:.2f} px; residual {calibration.rms_px:.3f} px RMS over "
            f"{len(calibration.fits)} views.",
            f"{margin}  distortion coefficients{model} {lens}.",
            f"{margin}  coverage: corners at {width} of the width, {height} of the height; boards "
            f"from {sizes} of the image side; tilts from {coverage.tilt_range_deg[0]:.0f} to "
            f"{coverage.tilt_range_deg[1]:.0f} degrees.",
        )


def _print_pair(pair: PairCalibration) -> None:
    left_px, right_px = pair.single_rms_px
    print_line(
        console,
        f"baseline {1000 * pair.rig.baseline_m:.2f} ± {1000 * pair.baseline_std_m:.2f} mm, given "
        f"the size of the squares; residual {pair.rms_px:.3f} px RMS over {len(pair.fits)} pairs.",
        f"Residuals of the cameras calibrated alone: left {left_px:.3f}, right {right_px:.3f} px "
        "RMS; a larger residual of the pairs means that boards moved between the images.",
        f"Vertical offset after rectification: {pair.row_error_px:.3f} px on average, "
        f"{pair.held_out_row_error_px:.3f} px in pairs held out of the fit.",
    )


app = command_group(
    CalibrationSettings,
    _calibrate,
    {
        "drive": Lazy(
            "track_range.cli.commands.calibrate.drive",
            "Calibrate one camera from its recordings of drives, without a board.",
            "The focal length and the lens distortion follow from the motion of the static scene in "
            "turns, the shapes of road users, the metadata of the files, and what you measured; "
            "height and pitch from the road. All recordings give one estimate, which narrows with "
            "each. A run of the same camera uses the file with --rig, and --rig here continues from "
            "it.",
            (
                "track-range calibrate drive monday.mp4 tuesday.mp4 --out rig.yaml",
                "track-range calibrate drive friday.mp4 --rig rig.yaml --out rig.yaml",
                "track-range calibrate drive drive.mp4 \\\n"
                "      --known-distance '3.2,610,340,702,415=12.4' --out rig.yaml",
            ),
        ),
        "ground": Lazy(
            "track_range.cli.commands.calibrate.ground",
            "Fit the plane of the road of a camera that stands still, for speeds in km/h.",
            "Metres on the road give the scale: four points of a rectangle, or lengths such as those "
            "of lane markings, in several directions. Pixels are those of the video, as a viewer "
            "of images shows them. What the measurements leave open is said; a run uses the file "
            "with --static-camera --ground.",
            (
                "track-range calibrate ground street.mp4 --known-point 410,620=0,0 \\\n"
                "      --known-point 905,622=0,-7 --known-point 788,291=40,-7 \\\n"
                "      --known-point 566,290=40,0 --out ground.yaml --picture ground.png",
                "track-range calibrate ground street.mp4 --focal-px 1150 \\\n"
                "      --known-length 410,620,905,622=7 --known-length 410,620,566,290=40",
            ),
        ),
    },
)
