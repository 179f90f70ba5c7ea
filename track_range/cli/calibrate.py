"""`track-range calibrate`: a rig file from images of a board, with the residual of each view and a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from track_range.calibration.board_search import BoardSearch
from track_range.calibration.figures import tilt_deg
from track_range.calibration.from_boards import calibrate_views, find_boards
from track_range.calibration.settings import CalibrationSettings
from track_range.cli.console import console, print_grid, print_line
from track_range.cli.lazy import single_app
from track_range.cli.parameters import command
from track_range.foundation.errors import UsageError
from track_range.report.tables import Column, grid_of
from track_range.run.progress import step_progress
from track_range.stereo.calibration.board_views import RejectedView
from track_range.stereo.calibration.coverage import view_shape
from track_range.stereo.calibration.one_camera import CameraCalibration, ViewFit
from track_range.stereo.calibration.two_cameras import PairCalibration, PairFit

_N_COEFFICIENTS = (0, 4, 5, 8)


def _calibrate(settings: CalibrationSettings) -> None:
    if settings.lens_terms not in _N_COEFFICIENTS:
        numbers = ", ".join(map(str, _N_COEFFICIENTS))
        raise UsageError(f"--lens-terms {settings.lens_terms}: expected one of {numbers}.")
    progress = partial(step_progress, console)
    found = find_boards(settings, progress)
    _print_search(found)
    calibration = calibrate_views(found, settings, progress)
    _print_rejected(calibration.result.rejected)
    _print_views(calibration.result.fits)
    _print_cameras(calibration.cameras)
    if isinstance(calibration.result, PairCalibration):
        _print_pair(calibration.result)
    print_line(console, "± are standard deviations, from leaving out views in turn.")
    for warning in calibration.warnings:
        print_line(console, f"Warning: {warning}")
    print_line(console, f"Written: {', '.join(map(str, calibration.save(settings)))}.")


def _print_search(found: BoardSearch) -> None:
    for note in found.notes:
        print_line(console, note)
    print_line(console, f"Board found in {len(found.shots)} of {found.n_images} {_views_of(found)}.")
    _print_rejected(found.rejected)


def _print_rejected(rejected: Sequence[RejectedView]) -> None:
    """One line per kind of reason; what differs within a kind is left to the figures."""
    by_kind: dict[str, list[RejectedView]] = {}
    for view in rejected:
        by_kind.setdefault(view.reason.partition(":")[0], []).append(view)
    for kind, views in by_kind.items():
        shown = ", ".join(view.name for view in views[:8]) + (f" and {len(views) - 8} more" if len(views) > 8 else "")
        print_line(console, f"Left out: {shown}: {views[0].reason if len(views) == 1 else kind}.")


def _views_of(found: BoardSearch) -> str:
    return "pairs" if found.shots and len(found.shots[0]) == 2 else "images"


def _print_views(fits: Sequence[ViewFit] | Sequence[PairFit]) -> None:
    lefts = [fit.left if isinstance(fit, PairFit) else fit for fit in fits]
    columns = [
        Column("residual px", [fit.rms_px for fit in fits], "{:.2f}"),
        Column("rows px", [fit.rows_px if isinstance(fit, PairFit) else None for fit in fits], "{:.2f}"),
        Column("tilt deg", [tilt_deg(fit) for fit in lefts], "{:.0f}"),
        Column("size %", [100 * float(view_shape(fit.view)[2]) for fit in lefts], "{:.0f}"),
        Column("corner blur px", [fit.view.edge_px for fit in lefts], "{:.1f}"),
    ]
    print_grid(console, grid_of("Views used", "view", [fit.view.name for fit in lefts], columns))


def _print_cameras(cameras: Mapping[str, CameraCalibration]) -> None:
    for name, found in cameras.items():
        camera, std, seen = found.camera, found.std, found.coverage
        print_line(
            console,
            f"{name}: fx {camera.fx_px:.2f} ± {std.fx_px:.2f}, fy {camera.fy_px:.2f} ± {std.fy_px:.2f}, "
            f"cx {camera.cx_px:.2f} ± {std.cx_px:.2f}, cy {camera.cy_px:.2f} ± {std.cy_px:.2f} px; "
            f"residual {found.rms_px:.3f} px RMS over {len(found.fits)} views.",
        )
        lens = ", ".join(f"{term:.4g}" for term in camera.distortion) or "none"
        print_line(console, f"{' ' * len(name)}  lens terms {lens}.")
        print_line(
            console,
            f"{' ' * len(name)}  corners span {_percent(seen.x_span)} of the width and {_percent(seen.y_span)} of the "
            f"height, boards {_percent(seen.size_range)} of the image's side, tilts {seen.tilt_range_deg[0]:.0f} to "
            f"{seen.tilt_range_deg[1]:.0f} degrees.",
        )


def _percent(span: tuple[float, float]) -> str:
    return f"{100 * span[0]:.0f} to {100 * span[1]:.0f} %"


def _print_pair(found: PairCalibration) -> None:
    print_line(
        console,
        f"baseline {1000 * found.rig.baseline_m:.2f} ± {1000 * found.baseline_sd_m:.2f} mm, if the squares have "
        f"the given size; residual {found.rms_px:.3f} px RMS over {len(found.fits)} pairs.",
    )
    print_line(
        console,
        f"Rows after rectification differ by {found.rows_px:.3f} px on average, by {found.held_out_rows_px:.3f} px in "
        "pairs held out of the fit.",
    )


app = single_app(command(CalibrationSettings, _calibrate))
