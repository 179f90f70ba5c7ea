"""Pen: measures labels and draws them, text on a darkened backing; a line may itself be a bar that fills.

[TTC 2.8 s  cl|osing 13.3 m/s   ]    text in one colour where the bar is filled, in another where it is not

Pieces of text come again and again (a name, a legend, 22.4 m): their widths are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.overlay.colours import AMBER, BLACK, WHITE, Bgr
from track_range.overlay.labels import Line, Lines

_MARGIN_PX = 6
_STRIPE_PX = 3
_KEPT_WIDTHS = 4096


class Pen:
    """Writes in OpenCV's own font; one instance serves one thread."""

    def __init__(self) -> None:
        """Load the font."""
        self._font = cv2.FontFace("sans")
        self._width_px = lru_cache(_KEPT_WIDTHS)(self._new_width_px)

    def sizes_px(self, labels: Sequence[Lines]) -> FloatArray:
        """(N, 2) width and height of each label on its backing, with margins."""
        sizes = [
            (max(map(self._line_width_px, lines)) + 6.0, sum(map(line_height_px, lines)) + 2.0) for lines in labels
        ]
        return np.array(sizes, np.float64).reshape(-1, 2)

    def write(self, canvas: Image, lines: Lines, place: FloatArray, *, stripe: Bgr | None = None) -> None:
        """Lines on a darkened backing at `place` (4,), with a stripe in the track's colour at the left."""
        left, top, right, bottom = np.rint(place).astype(int).tolist()
        backing = canvas[top:bottom, left:right]
        np.right_shift(backing, 2, out=backing)
        if stripe is not None:
            cv2.rectangle(canvas, (left, top), (left + _STRIPE_PX - 1, bottom - 1), stripe, -1)
        for line in lines:
            height = line_height_px(line)
            self._write_line(canvas, line, (left + _MARGIN_PX, top))
            if line[0].fill is not None and (filled := round(line[0].filled * (right - left - _STRIPE_PX))):
                bar = canvas[top + 1 : top + height + 1, left + _STRIPE_PX : left + _STRIPE_PX + filled]
                cv2.rectangle(bar, (0, 0), (filled, height), line[0].fill, -1)
                on_bar = BLACK if line[0].fill == AMBER else WHITE
                self._write_line(bar, line, (_MARGIN_PX - _STRIPE_PX, -1), bgr=on_bar)
            top += height

    def _write_line(self, canvas: Image, line: Line, corner: tuple[int, int], *, bgr: Bgr | None = None) -> None:
        """The line's pieces in their colours, or all in one."""
        x, top = corner
        height = line_height_px(line)
        for span in line:
            at, colour = (x, top + height - height // 5), span.bgr if bgr is None else bgr
            end, _ = cv2.putText(canvas, span.text, at, colour, self._font, span.size_px, span.weight)
            x = end[0] + span.size_px // 2

    def _line_width_px(self, line: Line) -> int:
        return sum([self._width_px(span.text, span.size_px, span.weight) for span in line])

    def _new_width_px(self, text: str, size_px: int, weight: int) -> int:
        """Width of the text and the gap after it."""
        box = cv2.getTextSize((0, 0), text, (0, 0), self._font, size_px, weight)
        return int(box[2]) + size_px // 2


def line_height_px(line: Line) -> int:
    """Height of a line of text: a quarter more than its largest span."""
    return max([span.size_px for span in line]) * 5 // 4
