"""`track-range calibrate`: images of a board -> a rig file, the residual of each view, a picture, what is missing."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console

from track_range.calibration.board_images import board_images
from track_range.calibration.board_search import FoundViews, find_views
from track_range.calibration.figures import mono_figures, pair_figures, tilt_deg
from track_range.calibration.picture import calibration_picture
from track_range.foundation.errors import UsageError
from track_range.report.tables import Column, grid_of
from track_range.results.output_files import check_outputs, write_bytes, write_text
from track_range.run.progress import say, step_progress
from track_range.stereo.calibration.board_views import RejectedView
from track_range.stereo.calibration.boards import board_of
from track_range.stereo.calibration.coverage import view_shape
from track_range.stereo.calibration.one_camera import CameraCalibration, ViewFit, calibrate_camera
from track_range.stereo.calibration.two_cameras import PairCalibration, PairFit, calibrate_pair
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig
from track_range.terminal_tables import tell_grid

_BOARD_M = (0.1, 20.0)
"""Usual distance of a board; others make a wrong --square-mm likely."""

_SOFT_PX = 6.0
"""Edges wider than this in most views: out of focus."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateOptions:
    """What the command line says; `mono` or `stereo` is None, and what is None else has a default."""

    mono: str | None
    stereo: tuple[str, str] | None
    board: str
    square_mm: float | None
    out: Path
    picture: Path | None = None
    json_file: Path | None = None
    n_lens_terms: int = 5


def calibrate(options: CalibrateOptions, console: Console) -> dict[str, Any]:
    """Calibrate, print what was found, write the rig, the picture and, where asked, the figures; these are returned.

    Raises:
        UsageError: no source or two, or words that name no board.
        ImageFileError, VideoError: images cannot be read.
        CalibrationError: no calibration can be made of them.
        OutputError, RigError: a file cannot be written, or is an input.
    """
    sources = _sources(options)
    try:
        board = board_of(options.board, options.square_mm)
    except ValueError as error:
        raise UsageError(f"--board, --square-mm: {error}") from error
    picture = options.picture or options.out.parent / f"{options.out.stem}.png"
    images = board_images(sources)
    check_outputs([file for file in (options.out, picture, options.json_file) if file is not None], images.files)
    with step_progress(console, "looking for boards") as advance:
        found = find_views(images, board, advance)
    _tell_search(found, console)
    figures, eyes = _calibrated(found, options, console)
    figures = {"board": board.name, "square_mm": board.square_m * 1000, "sources": list(sources), **figures}
    figures["warnings"] += _doubts(found, eyes)
    say(console, "± are standard deviations, from leaving out views in turn.")
    for warning in figures["warnings"]:
        say(console, f"Warning: {warning}")
    write_bytes(picture, cv2.imencode(".png", calibration_picture(eyes))[1].tobytes())
    if options.json_file is not None:
        write_text(options.json_file, json.dumps(figures, indent=2, allow_nan=False) + "\n")
    say(console, f"Written: {options.out}, {picture}" + (f", {options.json_file}" if options.json_file else "") + ".")
    return figures


def _sources(options: CalibrateOptions) -> tuple[str, ...]:
    if (options.mono is None) == (options.stereo is None):
        raise UsageError("give --mono IMAGES, or --stereo LEFT RIGHT.")
    return (options.mono,) if options.mono is not None else options.stereo or ()


def _tell_search(found: FoundViews, console: Console) -> None:
    for note in found.notes:
        say(console, note)
    say(console, f"Board found in {len(found.shots)} of {found.n_images} {_views_of(found)}.")
    _tell_rejected(found.rejected, console)


def _tell_rejected(rejected: Sequence[RejectedView], console: Console) -> None:
    """One line per kind of reason; what differs within a kind is left to the figures."""
    by_kind: dict[str, list[RejectedView]] = {}
    for view in rejected:
        by_kind.setdefault(view.reason.partition(":")[0], []).append(view)
    for kind, views in by_kind.items():
        shown = ", ".join(view.name for view in views[:8]) + (f" and {len(views) - 8} more" if len(views) > 8 else "")
        say(console, f"Left out: {shown}: {views[0].reason if len(views) == 1 else kind}.")


def _views_of(found: FoundViews) -> str:
    return "pairs" if found.shots and len(found.shots[0]) == 2 else "images"


def _calibrated(
    found: FoundViews, options: CalibrateOptions, console: Console
) -> tuple[dict[str, Any], dict[str, CameraCalibration]]:
    """The figures of the calibration, which is written and told, and each eye's part of it."""
    with step_progress(console, "calibrating") as advance:
        if options.stereo is None:
            views = [shot[0] for shot in found.shots]
            alone = calibrate_camera(views, n_lens_terms=options.n_lens_terms, advance=advance)
        else:
            pairs = [(shot[0], shot[1]) for shot in found.shots]
            both = calibrate_pair(pairs, n_lens_terms=options.n_lens_terms, advance=advance)
    if options.stereo is None:
        _tell_rejected(alone.rejected, console)
        _tell_views(alone.fits, console)
        _tell_cameras({"camera": alone}, console)
        save_camera(alone.camera, options.out, comments=[_headline(len(alone.fits), alone.rms_px)])
        return mono_figures(alone, found), {"camera": alone}
    _tell_rejected(both.rejected, console)
    _tell_views(both.fits, console)
    eyes = {"left": both.left, "right": both.right}
    _tell_cameras(eyes, console)
    _tell_pair(both, console)
    save_rig(both.rig, options.out, comments=[_headline(len(both.fits), both.rms_px)])
    return pair_figures(both, found), eyes


def _headline(n_views: int, rms_px: float) -> str:
    return f"track-range calibrate: {n_views} views, residual {rms_px:.3f} px RMS"


def _tell_views(fits: Sequence[ViewFit] | Sequence[PairFit], console: Console) -> None:
    lefts = [fit.left if isinstance(fit, PairFit) else fit for fit in fits]
    columns = [
        Column("residual px", [fit.rms_px for fit in fits], "{:.2f}"),
        Column("rows px", [fit.rows_px if isinstance(fit, PairFit) else None for fit in fits], "{:.2f}"),
        Column("tilt deg", [tilt_deg(fit) for fit in lefts], "{:.0f}"),
        Column("size %", [100 * float(view_shape(fit.view)[2]) for fit in lefts], "{:.0f}"),
        Column("edge px", [fit.view.edge_px for fit in lefts], "{:.1f}"),
    ]
    tell_grid(console, grid_of("Views used", "view", [fit.view.name for fit in lefts], columns))


def _tell_cameras(eyes: Mapping[str, CameraCalibration], console: Console) -> None:
    for name, found in eyes.items():
        camera, sds, seen = found.camera, found.sds, found.coverage
        say(
            console,
            f"{name}: fx {camera.fx_px:.2f} ± {sds.fx_px:.2f}, fy {camera.fy_px:.2f} ± {sds.fy_px:.2f}, "
            f"cx {camera.cx_px:.2f} ± {sds.cx_px:.2f}, cy {camera.cy_px:.2f} ± {sds.cy_px:.2f} px; "
            f"residual {found.rms_px:.3f} px RMS over {len(found.fits)} views.",
        )
        lens = ", ".join(f"{term:.4g}" for term in camera.distortion) or "none"
        say(console, f"{' ' * len(name)}  lens terms {lens}.")
        say(
            console,
            f"{' ' * len(name)}  corners span {_percent(seen.x_span)} of the width and {_percent(seen.y_span)} of the "
            f"height, boards {_percent(seen.size_range)} of the image's side, tilts {seen.tilt_range_deg[0]:.0f} to "
            f"{seen.tilt_range_deg[1]:.0f} degrees.",
        )


def _percent(span: tuple[float, float]) -> str:
    return f"{100 * span[0]:.0f} to {100 * span[1]:.0f} %"


def _tell_pair(found: PairCalibration, console: Console) -> None:
    say(
        console,
        f"baseline {1000 * found.rig.baseline_m:.2f} ± {1000 * found.baseline_sd_m:.2f} mm, if the squares are as "
        f"large as said; residual {found.rms_px:.3f} px RMS over {len(found.fits)} pairs.",
    )
    say(
        console,
        f"Rows after rectification differ by {found.rows_px:.3f} px on average, by {found.held_out_rows_px:.3f} px in "
        "pairs held out of the fit.",
    )


def _doubts(found: FoundViews, eyes: Mapping[str, CameraCalibration]) -> list[str]:
    """What looks wrong, but not wrong enough to refuse."""
    said = []
    first = next(iter(eyes.values()))
    distance_m = float(np.median([fit.board_to_camera[2, 3] for fit in first.fits]))
    if not _BOARD_M[0] <= distance_m <= _BOARD_M[1]:
        said.append(f"the boards stand {distance_m:.3g} m away: is --square-mm right?")
    if float(np.median([view.edge_px for shot in found.shots for view in shot])) > _SOFT_PX:
        said.append("most images are out of focus; the lens should be focused and fixed before it is calibrated.")
    sizes = {f"{eye.camera.width_px}x{eye.camera.height_px} px" for eye in eyes.values()}
    if len(sizes) > 1:
        said.append(
            f"images of the two eyes differ in size ({', '.join(sorted(sizes))}); a run wants videos of one size."
        )
    return said
