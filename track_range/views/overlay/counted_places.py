"""CountedPlaces: lines and zones of a camera that stands still, with the counts so far, on the overlay."""

from collections import Counter as Tally
from collections.abc import Callable, Sequence

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.pipeline.colours import AMBER, BLACK, WHITE
from track_range.pipeline.frame_result import FrameResult
from track_range.results.counts.counter import Anchors, LineCounter
from track_range.results.counts.places import Place
from track_range.views.overlay import labels

_N_POINTS = 24  # of each edge, which is a curve in undistorted images of a wide lens
_ARROWS = {"up": "↑", "down": "↓", "left": "←", "right": "→"}


class CountedPlaces:
    """Draws the places of one video in the order of its frames; `shown` moves points (N, 2) of the
    video to the picture.
    """

    def __init__(
        self, places: Sequence[Place], anchors: Anchors, shown: Callable[[FloatArray], FloatArray]
    ) -> None:
        self._counter = LineCounter(places, anchors)
        self._lines = [shown(_outline(place)) for place in places]
        self._text = labels.TextRenderer()

    def draw(self, canvas: Image, result: FrameResult) -> None:
        """Draw the places with their counts up to this frame."""
        self._counter.update(result)
        height, width = canvas.shape[:2]
        _, size_px, line_px = labels.text_sizes_px((width, height))
        for place, line in zip(self._counter.places, self._lines, strict=True):
            inside = np.isfinite(line).all(axis=1)
            stroke = [np.rint(line[inside]).astype(np.int32)]
            cv2.polylines(canvas, stroke, place.is_zone, BLACK, line_px + 2)
            cv2.polylines(canvas, stroke, place.is_zone, AMBER, line_px, cv2.LINE_AA)
            if not inside.any():
                continue
            lines = [[labels.Span(self._words(place), size_px, labels.BOLD, WHITE)]]
            (w, h), *_ = self._text.sizes_px([lines]).tolist()
            x, y = line[inside][0].tolist()
            x, y = min(max(x, 0.0), max(width - w, 0.0)), min(max(y, 0.0), max(height - h, 0.0))
            if w <= width and h <= height:
                self._text.write(canvas, lines, np.array([x, y, x + w, y + h]), stripe=AMBER)

    def _words(self, place: Place) -> str:
        own = [one for one in self._counter.crossings if one.place == place.name]
        tally = Tally(one.direction or one.kind for one in own)
        if place.is_zone:
            return f"{place.name}  in {tally['enter']}  out {tally['exit']}"
        parts = [f"{_ARROWS[direction]} {n}" for direction, n in sorted(tally.items())]
        return "  ".join([place.name, *(parts or ["0"])])


def _outline(place: Place) -> FloatArray:
    """(N, 2) points along the line, or around the zone."""
    ends = np.roll(place.xy_px, -1, axis=0) if place.is_zone else place.xy_px[1:]
    starts = place.xy_px if place.is_zone else place.xy_px[:1]
    part = np.linspace(0.0, 1.0, _N_POINTS)[:, None]
    return np.concatenate([a + part * (b - a) for a, b in zip(starts, ends, strict=True)])
