"""Pen: measures labels and draws them, text on a darkened backing; a line may itself be a bar that fills.

[TTC 2.8 s  cl|osing 13.3 m/s   ]    text in one colour where the bar is filled, in another where it is not
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from detection.detections import FloatArray, Image
from track_range.overlay_colours import AMBER, BLACK, WHITE, Bgr
from track_range.overlay_text import Line, Lines, Span

_MARGIN_PX = 6
_STRIPE_PX = 3


class Pen:
    """Writes in OpenCV's own font; one instance serves one thread."""

    def __init__(self) -> None:
        """Load the font."""
        self._font = cv2.FontFace("sans")

    def sizes_px(self, labels: Sequence[Lines]) -> FloatArray:
        """(N, 2) width and height of each label on its backing, with margins."""
        widths = [max(sum(map(self._width_px, line)) for line in lines) for lines in labels]
        heights = [sum(map(line_height_px, lines)) for lines in labels]
        return np.asarray(np.array([widths, heights], np.float64).reshape(2, -1).T + np.array([6.0, 2.0]))

    def write(self, canvas: Image, lines: Lines, place: FloatArray, *, stripe: Bgr | None = None) -> None:
        """Lines on a darkened backing at `place` (4,), with a stripe in the track's colour at the left."""
        left, top, right, bottom = np.rint(place).astype(int).tolist()
        backing = canvas[top:bottom, left:right]
        np.right_shift(backing, 2, out=backing)
        if stripe is not None:
            canvas[top:bottom, left : left + _STRIPE_PX] = stripe
        for line in lines:
            height = line_height_px(line)
            self._write_line(canvas, line, (left + _MARGIN_PX, top))
            if line[0].fill is not None and (filled := round(line[0].filled * (right - left - _STRIPE_PX))):
                bar = canvas[top + 1 : top + height + 1, left + _STRIPE_PX : left + _STRIPE_PX + filled]
                bar[:] = line[0].fill
                self._write_line(bar, [on_bar(span) for span in line], (_MARGIN_PX - _STRIPE_PX, -1))
            top += height

    def _write_line(self, canvas: Image, line: Line, corner: tuple[int, int]) -> None:
        x, top = corner
        height = line_height_px(line)
        baseline = top + height - height // 5
        for span in line:
            end, _ = cv2.putText(canvas, span.text, (x, baseline), span.bgr, self._font, span.size_px, span.weight)
            x = end[0] + span.size_px // 2

    def _width_px(self, span: Span) -> int:
        """Width of the text and the gap after it."""
        box = cv2.getTextSize((0, 0), span.text, (0, 0), self._font, span.size_px, span.weight)
        return int(box[2]) + span.size_px // 2


def line_height_px(line: Line) -> int:
    """Height of a line of text: a quarter more than its largest span."""
    return max(span.size_px for span in line) * 5 // 4


def on_bar(span: Span) -> Span:
    """A piece of text as it is on the filled part of its bar: black on amber, white elsewhere."""
    return replace(span, bgr=BLACK if span.fill == AMBER else WHITE)
