"""TextRenderer: measures and draws labels, as text on a darkened background; a line may contain a progress bar.

[TTC 2.8 s  cl|osing 13.3 m/s   ]    the text has another colour on the filled part of the bar

The widths of texts are cached, because most texts recur (names, legend, distances).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from operator import attrgetter

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.pipeline.colours import AMBER, BLACK, WHITE, Bgr
from track_range.views.overlay.labels import Line, Lines

_MARGIN_PX = 6
"""Left margin of the text."""

_STRIPE_PX = 3
"""Width of the stripe in the colour of the track."""

_N_CACHED_WIDTHS = 4096
"""Number of texts whose widths are cached."""


class TextRenderer:
    """Draws text in OpenCV's built-in font; not thread-safe."""

    def __init__(self) -> None:
        """Load the font."""
        self._font = cv2.FontFace("sans")
        self._width_px = lru_cache(_N_CACHED_WIDTHS)(self._new_width_px)

    def sizes_px(self, labels: Sequence[Lines]) -> FloatArray:
        """(N, 2) width and height of each label in pixels, including margins."""
        sizes = []
        for lines in labels:
            sizes.append((max(map(self._line_width_px, lines)) + 6.0, sum(map(line_height_px, lines)) + 2.0))
        return np.array(sizes, np.float64).reshape(-1, 2)

    def write(self, canvas: Image, lines: Lines, place: FloatArray, *, stripe: Bgr | None = None) -> None:
        """Draw lines on a darkened background in the rectangle `place` (4,), with an optional stripe at the left."""
        left, top, right, bottom = np.rint(place).astype(int).tolist()
        background = canvas[top:bottom, left:right]
        np.right_shift(background, 2, out=background)
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
        """Draw the spans of a line in their colours, or all in the colour `bgr`."""
        x, top = corner
        height = line_height_px(line)
        for span in line:
            origin, colour = (x, top + height - height // 5), span.bgr if bgr is None else bgr
            end, _ = cv2.putText(canvas, span.text, origin, colour, self._font, span.size_px, span.weight)
            x = end[0] + span.size_px // 2

    def _line_width_px(self, line: Line) -> int:
        return sum([self._width_px(span.text, span.size_px, span.weight) for span in line])

    def _new_width_px(self, text: str, size_px: int, weight: int) -> int:
        """Width in pixels of a text and the gap after it."""
        box = cv2.getTextSize((0, 0), text, (0, 0), self._font, size_px, weight)
        return int(box[2]) + size_px // 2


def line_height_px(line: Line) -> int:
    """Height of a line of text in pixels: 1.25 times its largest font size."""
    return max(line, key=attrgetter("size_px")).size_px * 5 // 4
