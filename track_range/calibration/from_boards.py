"""Calibration of one camera or a pair from images of a board: a rig file, the residual of each view, a picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from track_range.calibration.board_images import board_images
from track_range.calibration.board_search import FoundViews, find_views
from track_range.calibration.figures import mono_figures, pair_figures
from track_range.calibration.picture import calibration_picture
from track_range.calibration.settings import CalibrationSettings
from track_range.foundation.errors import UsageError
from track_range.foundation.progress import StepProgress, no_progress
from track_range.results.output_files import check_outputs, write_bytes, write_text
from track_range.stereo.calibration.boards import Board, board_of
from track_range.stereo.calibration.one_camera import CameraCalibration, calibrate_camera
from track_range.stereo.calibration.two_cameras import PairCalibration, calibrate_pair
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig

_BOARD_M = (0.1, 20.0)
"""Usual distance of a board; others make a wrong --square-mm likely."""

_SOFT_PX = 6.0
"""Edges wider than this in most views: out of focus."""


@dataclass(frozen=True, slots=True)
class BoardCalibration:
    """A camera or a pair of cameras calibrated from images of a board.

    Attributes:
        found: the views of the board.
        result: the calibration.
        figures: everything that was measured, as plain values for JSON.
    """

    found: FoundViews
    result: CameraCalibration | PairCalibration
    figures: dict[str, Any]

    @property
    def cameras(self) -> dict[str, CameraCalibration]:
        """The calibration of each camera, by name."""
        if isinstance(self.result, PairCalibration):
            return {"left": self.result.left, "right": self.result.right}
        return {"camera": self.result}

    @property
    def warnings(self) -> list[str]:
        """What looks wrong, but not wrong enough to refuse."""
        return list(self.figures["warnings"])

    def save(self, settings: CalibrationSettings) -> list[Path]:
        """Write the rig, the picture and, where `settings.json_file` is given, the figures; the files' names.

        Raises:
            OutputError, RigError: a file cannot be written.
        """
        n_views, rms_px = len(self.result.fits), self.result.rms_px
        comments = [f"track-range calibrate: {n_views} views, residual {rms_px:.3f} px RMS"]
        if isinstance(self.result, PairCalibration):
            save_rig(self.result.rig, settings.out, comments=comments)
        else:
            save_camera(self.result.camera, settings.out, comments=comments)
        picture = picture_file(settings)
        write_bytes(picture, cv2.imencode(".png", calibration_picture(self.cameras))[1].tobytes())
        if settings.json_file is None:
            return [settings.out, picture]
        write_text(settings.json_file, json.dumps(self.figures, indent=2, allow_nan=False) + "\n")
        return [settings.out, picture, settings.json_file]


def calibrate(settings: CalibrationSettings, progress: StepProgress = no_progress) -> BoardCalibration:
    """Find the board in the images and calibrate; nothing is written before `BoardCalibration.save`.

    Raises:
        UsageError: no source or two, or text that describes no board.
        ImageFileError, VideoError: images cannot be read.
        CalibrationError: the views do not suffice for a calibration.
        OutputError: a result would overwrite an image.
    """
    return calibrate_views(find_boards(settings, progress), settings, progress)


def find_boards(settings: CalibrationSettings, progress: StepProgress = no_progress) -> FoundViews:
    """The views of the board in the images, the first half of `calibrate`."""
    images = board_images(_sources(settings))
    outputs = (settings.out, picture_file(settings), settings.json_file)
    board = _board(settings)
    check_outputs([file for file in outputs if file is not None], images.files)
    with progress("looking for boards") as advance:
        return find_views(images, board, advance)


def calibrate_views(
    found: FoundViews, settings: CalibrationSettings, progress: StepProgress = no_progress
) -> BoardCalibration:
    """The calibration from views of the board, the second half of `calibrate`."""
    result: CameraCalibration | PairCalibration
    with progress("calibrating") as advance:
        if settings.stereo is None:
            views = [shot[0] for shot in found.shots]
            result = calibrate_camera(views, n_distortion_coefficients=settings.lens_terms, advance=advance)
            measured = mono_figures(result, found)
        else:
            pairs = [(shot[0], shot[1]) for shot in found.shots]
            result = calibrate_pair(pairs, n_distortion_coefficients=settings.lens_terms, advance=advance)
            measured = pair_figures(result, found)
    board = _board(settings)
    figures = {
        "board": board.name,
        "square_mm": board.square_m * 1000,
        "sources": list(_sources(settings)),
        **measured,
    }
    calibration = BoardCalibration(found, result, figures)
    figures["warnings"] += _warnings(found, calibration.cameras)
    return calibration


def picture_file(settings: CalibrationSettings) -> Path:
    """Where the picture of residuals and coverage goes."""
    return settings.picture or settings.out.parent / f"{settings.out.stem}.png"


def _sources(settings: CalibrationSettings) -> tuple[str, ...]:
    if (settings.mono is None) == (settings.stereo is None):
        raise UsageError("give --mono IMAGES, or --stereo LEFT RIGHT.")
    return (settings.mono,) if settings.mono is not None else settings.stereo or ()


def _board(settings: CalibrationSettings) -> Board:
    try:
        return board_of(settings.board, settings.square_mm)
    except ValueError as error:
        raise UsageError(f"--board, --square-mm: {error}") from error


def _warnings(found: FoundViews, cameras: Mapping[str, CameraCalibration]) -> list[str]:
    """What looks wrong, but not wrong enough to refuse."""
    warnings = []
    first = next(iter(cameras.values()))
    distance_m = float(np.median([fit.board_to_camera[2, 3] for fit in first.fits]))
    if not _BOARD_M[0] <= distance_m <= _BOARD_M[1]:
        warnings.append(f"the boards stand {distance_m:.3g} m away: is --square-mm right?")
    if float(np.median([view.edge_px for shot in found.shots for view in shot])) > _SOFT_PX:
        warnings.append("most images are out of focus; the lens should be focused and fixed before it is calibrated.")
    sizes = {f"{each.camera.width_px}x{each.camera.height_px} px" for each in cameras.values()}
    if len(sizes) > 1:
        warnings.append(
            f"images of the two cameras differ in size ({', '.join(sorted(sizes))}); a run needs videos of one size."
        )
    return warnings
