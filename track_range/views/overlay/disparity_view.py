"""Colour-coded disparities of dense stereo: alone, or below the overlay with boxes and a scale."""

from __future__ import annotations

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.pipeline.colours import GREY, WHITE, track_colour
from track_range.pipeline.frame_result import FrameResult
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.sgbm import disparity_picture
from track_range.views.overlay.annotator import Overlay, draw_box, draw_inner_windows
from track_range.views.overlay.labels import BOLD, REGULAR, Span, TextRenderer, text_sizes_px

REDDEST_M = 5.0  # distance in metres shown in the reddest colour; nearer ones have the same colour
SCALE_M = (5, 7, 10, 15, 20, 30, 50)  # distances on the scale, in metres


class DisparityPicture:
    """Draws the disparities of dense stereo: near is red, far is blue, unknown is black; not thread-safe."""

    def __init__(self, rig: StereoRig) -> None:
        self._focal_baseline_px_m = rig.left.fx_px * rig.baseline_m
        self._text = TextRenderer()

    def draw(self, result: FrameResult) -> Image:
        """Colour-coded disparities, (H, W, 3) uint8 BGR; black if dense stereo did not run."""
        largest_px = self._focal_baseline_px_m / REDDEST_M
        if result.disparity is None:
            return np.zeros_like(result.frame.left)
        return disparity_picture(result.disparity, largest_px=largest_px)

    def draw_marked(self, result: FrameResult) -> Image:
        """Colour-coded disparities with the boxes and inner windows of the tracks, and a scale at the lower edge."""
        canvas = self.draw(result)
        boxes = np.clip(result.tracks.xyxy_px, -20.0, np.tile(canvas.shape[1::-1], 2) + 20.0)
        valid = np.isfinite(boxes).all(axis=1)
        for row in np.flatnonzero(valid).tolist():
            bgr, is_observed = track_colour(int(result.tracks.track_id[row])), bool(result.tracks.observed[row])
            draw_box(canvas, boxes[row], bgr=bgr, line_px=1, dashed=not is_observed)
        observed = boxes[valid & result.tracks.observed]
        draw_inner_windows(canvas, observed, [WHITE] * len(observed))
        self._draw_scale(canvas)
        return canvas

    def _draw_scale(self, canvas: Image) -> None:
        size_px = text_sizes_px((canvas.shape[1], canvas.shape[0]))[1]
        level = np.rint(255 * REDDEST_M / np.array(SCALE_M)).astype(np.uint8)
        swatches = cv2.applyColorMap(level[:, None], cv2.COLORMAP_TURBO)[:, 0].tolist()
        line = [Span("dense stereo, m", size_px, BOLD, WHITE)]
        for metres, (blue, green, red) in zip(SCALE_M, swatches, strict=True):
            line += [Span("■■", size_px, BOLD, (blue, green, red)), Span(str(metres), size_px, REGULAR, GREY)]
        width, height = self._text.sizes_px([[line]])[0]
        corner: FloatArray = np.array(canvas.shape[1::-1], np.float64)
        if width <= corner[0]:
            self._text.write(canvas, [line], np.concatenate([corner - (width, height), corner]))


class StackedPicture:
    """Draws the overlay with the disparities below it; not thread-safe."""

    def __init__(self, overlay: Overlay, rig: StereoRig) -> None:
        self._overlay, self._disparity = overlay, DisparityPicture(rig)

    def draw(self, result: FrameResult) -> Image:
        """Overlay above disparities, (2 H, W, 3) uint8 BGR."""
        return np.vstack([self._overlay.draw(result), self._disparity.draw_marked(result)])
