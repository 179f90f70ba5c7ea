"""The picture of a calibration: coverage and residuals of the corners, and the residual of each view.

left   the image plane: density of corners as shades, residuals as arrows, enlarged by the factor in the title
right  one bar per view: its residual and name
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.stereo.calibration.one_camera import CameraCalibration, ViewFit

_PANEL_PX, _BARS_PX, _MARGIN_PX, _TITLE_PX = 960, 520, 16, 40
"""Widths of the left panel and of the bars, width of the margins, and height of the title, px."""

_ARROW_PX = 24.0  # length of the arrow for the 90th percentile of the residuals, px
_CELL_PX = 24  # side of a cell in which corners are counted, px

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_INK, _GRID = (40, 40, 40), (200, 200, 200)
_WORST_BGR, _BAR_BGR = (60, 60, 220), (190, 130, 60)
_MAX_ROW_PX, _MIN_ROW_PX = 26, 9  # largest and smallest height of a bar with its margins, px


def calibration_picture(cameras: Mapping[str, CameraCalibration]) -> Image:
    """(H, W, 3) BGR: one row of panels per camera, with its name as title."""
    return np.vstack([_row(name, calibration) for name, calibration in cameras.items()])


def _row(name: str, calibration: CameraCalibration) -> Image:
    height_px = round(_PANEL_PX * calibration.camera.height_px / calibration.camera.width_px)
    canvas = np.full((height_px + _TITLE_PX + _MARGIN_PX, _PANEL_PX + _BARS_PX + 3 * _MARGIN_PX, 3), 255, np.uint8)
    factor, plane = _plane(calibration, height_px)
    canvas[_TITLE_PX : _TITLE_PX + height_px, _MARGIN_PX : _MARGIN_PX + _PANEL_PX] = plane
    n_views = len(calibration.fits)
    title = f"{name}: {n_views} views, residual {calibration.rms_px:.3f} px RMS; arrows x {factor:.0f}"
    cv2.putText(canvas, title, (_MARGIN_PX, _TITLE_PX - 14), _FONT, 0.6, _INK, 1, cv2.LINE_AA)
    _draw_bars(canvas[_TITLE_PX : _TITLE_PX + height_px, _PANEL_PX + 2 * _MARGIN_PX : -_MARGIN_PX], calibration.fits)
    return canvas


def _plane(calibration: CameraCalibration, height_px: int) -> tuple[float, Image]:
    """The enlargement of the arrows, and the drawing of the image plane."""
    fits = calibration.fits
    scale = _PANEL_PX / calibration.camera.width_px
    xy_px = np.concatenate([fit.view.xy_px for fit in fits]) * scale
    residual_px = np.concatenate([fit.residual_px for fit in fits])
    length_px = float(np.percentile(np.linalg.norm(residual_px, axis=1), 90))
    factor = _ARROW_PX / max(length_px * scale, 1e-6)
    plane = _shades(xy_px, height_px)
    for third in (1, 2):
        cv2.line(plane, (third * _PANEL_PX // 3, 0), (third * _PANEL_PX // 3, height_px), _GRID, 1)
        cv2.line(plane, (0, third * height_px // 3), (_PANEL_PX, third * height_px // 3), _GRID, 1)
    hues = np.repeat(np.linspace(0, 179, len(fits), endpoint=False), [len(fit.view.xy_px) for fit in fits])
    colours = cv2.cvtColor(
        np.stack([hues, np.full_like(hues, 255), np.full_like(hues, 150)], 1).astype(np.uint8)[None], cv2.COLOR_HSV2BGR
    )[0]
    for start, step, colour in zip(xy_px, residual_px * scale * factor, colours, strict=True):
        tail, tip = start.round().astype(int).tolist(), (start + step).round().astype(int).tolist()
        cv2.arrowedLine(plane, tail, tip, colour.tolist(), 1, cv2.LINE_AA, tipLength=0.25)
    cv2.rectangle(plane, (0, 0), (_PANEL_PX - 1, height_px - 1), _INK, 1)
    return factor, plane


def _shades(xy_px: FloatArray, height_px: int) -> Image:
    """Density of the corners (N, 2) per cell, from white (none) to blue-green (most)."""
    bins = (max(height_px // _CELL_PX, 1), _PANEL_PX // _CELL_PX)
    counts, _, _ = np.histogram2d(xy_px[:, 1], xy_px[:, 0], bins=bins, range=((0, height_px), (0, _PANEL_PX)))
    fraction = np.sqrt(counts / max(counts.max(), 1))
    wide = cv2.resize(fraction.astype(np.float32), (_PANEL_PX, height_px), interpolation=cv2.INTER_NEAREST)
    dark = np.array([235.0, 225.0, 150.0])
    return np.asarray(255 - wide[..., None] * (255 - dark), np.uint8)


def _draw_bars(area: Image, fits: Sequence[ViewFit]) -> None:
    """Draw one bar per view into `area`; the three worst are red."""
    height_px, width_px = area.shape[:2]
    row_px = int(np.clip(height_px // max(len(fits), 1), _MIN_ROW_PX, _MAX_ROW_PX))
    rms_px = np.array([fit.rms_px for fit in fits])
    worst = set(np.argsort(-rms_px)[:3].tolist())
    names_px = width_px * 2 // 5
    longest_px = width_px - names_px - 60
    for i, fit in enumerate(fits[: height_px // row_px]):
        top = i * row_px
        size = min(0.45, row_px / 32)
        end = names_px + max(round(longest_px * rms_px[i] / rms_px.max()), 1)
        colour = _WORST_BGR if i in worst else _BAR_BGR
        cv2.rectangle(area, (names_px, top + 2), (end, top + row_px - 2), colour, cv2.FILLED)
        cv2.putText(area, fit.view.name[-28:], (0, top + row_px - 4), _FONT, size, _INK, 1, cv2.LINE_AA)
        cv2.putText(area, f"{rms_px[i]:.2f}", (end + 4, top + row_px - 4), _FONT, size, _INK, 1, cv2.LINE_AA)
