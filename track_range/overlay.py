"""The overlay: a frame with each track's box, identity and distances drawn on it, for a person's eyes.

Box solid = seen, dashed = predicted; corners inside it = where stereo looks; the label (`overlay_text.py`) stands
at the box, inside the image, and never on another label (`label_places.py`). At the lower left the road from
above (`birds_eye.py`), on the road the own lane's lines. Near tracks choose their place first; one that finds no room
for a full label gets the first line alone, and one that finds none for that is left with its box.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from detection.classes import ROAD_CLASSES
from detection.detections import FloatArray, Image
from stereo.camera import PinholeCamera
from track_range.birds_eye import BirdsEye
from track_range.label_places import free_place, label_places, place_costs
from track_range.overlay_colours import track_colour
from track_range.overlay_marks import draw_box, draw_inner_window, draw_lanes, draw_leader
from track_range.overlay_text import Lines, corner_lines, label_lines, text_sizes_px
from track_range.overlay_writing import Pen
from track_range.results import FrameResult

Status = Callable[[], Sequence[str]]
"""Words on how the run goes, such as its frames per second."""

_STEREO_METHODS = ("stereo", "sgbm")


class Overlay:
    """Draws the results of one video, in their order; one instance serves one thread.

    Args:
        class_names: by class id.
        camera: of the images, for the inset.
        status: what the upper left corner says beside the frame's number and time.
        warning: what it says in amber.
    """

    def __init__(
        self,
        class_names: Sequence[str] = ROAD_CLASSES,
        *,
        camera: PinholeCamera | None = None,
        status: Status = tuple,
        warning: str = "",
    ) -> None:
        self.class_names = tuple(class_names)
        self._status, self._warning = status, warning
        self._pen = Pen()
        self._inset = BirdsEye(camera)
        self._habits: dict[int, int] = {}

    def draw(self, result: FrameResult) -> Image:
        """A new (H, W, 3) uint8 BGR image: the left frame with its tracks drawn on it.

        Boxes may reach outside the image; a box with NaN is left out; a NaN distance is shown as "-".
        """
        canvas = result.frame.left.copy()
        line_px = text_sizes_px(len(canvas))[2]
        boxes = result.tracks.xyxy_px
        nearest_first = [int(row) for row in np.argsort(-boxes[:, 3]) if np.isfinite(boxes[row]).all()]
        # Edges outside the image are brought near it: the drawing takes 32-bit pixels and as many dashes as asked.
        size_px = np.array(canvas.shape[1::-1], np.float64)
        boxes = np.clip(boxes, -8.0 * line_px, np.tile(size_px, 2) + 8.0 * line_px)
        if result.lanes is not None:
            draw_lanes(canvas, result.lanes, line_px=line_px)
        self._draw_boxes(canvas, result, boxes, nearest_first[::-1])
        self._inset.draw(canvas, result)
        self._draw_labels(canvas, result, boxes, nearest_first)
        return canvas

    def _draw_boxes(self, canvas: Image, result: FrameResult, boxes: FloatArray, rows: Sequence[int]) -> None:
        """Boxes and inner windows in the order of `rows`."""
        line_px = text_sizes_px(len(canvas))[2]
        looks_inside = any(method in result.ranges for method in _STEREO_METHODS)
        for row in rows:
            colour, seen = track_colour(int(result.tracks.track_id[row])), bool(result.tracks.observed[row])
            draw_box(canvas, boxes[row], bgr=colour, line_px=line_px, dashed=not seen)
            if looks_inside and seen:
                draw_inner_window(canvas, boxes[row], bgr=colour)

    def _draw_labels(self, canvas: Image, result: FrameResult, boxes: FloatArray, rows: Sequence[int]) -> None:
        """The corners, then each track's label in the order of `rows`, each beside those before it."""
        sizes_px = text_sizes_px(len(canvas))[:2]
        full = [label_lines(result, row, class_names=self.class_names, sizes_px=sizes_px) for row in rows]
        corners = corner_lines(result, sizes_px[1], status=self._status(), warning=self._warning)
        taken = self._draw_corners(canvas, corners)
        ids = [int(result.tracks.track_id[row]) for row in rows]
        placed = self._placed(full, ids, boxes[rows], taken=taken, image_px=(canvas.shape[1], canvas.shape[0]))
        for i, (_, place) in placed.items():
            draw_leader(canvas, place, boxes[rows[i]], bgr=track_colour(ids[i]))
        for i, (lines, place) in placed.items():
            self._pen.write(canvas, lines, place, stripe=track_colour(ids[i]))

    def _placed(
        self,
        full: Sequence[Lines],
        ids: Sequence[int],
        boxes: FloatArray,
        *,
        taken: FloatArray,
        image_px: tuple[int, int],
    ) -> dict[int, tuple[Lines, FloatArray]]:
        """What each label says and where, by its number, for those that find room."""
        habits = [self._habits.get(track_id) for track_id in ids]
        short = [lines[:1] for lines in full]
        sizes = [(texts, label_places(boxes, self._pen.sizes_px(texts), image_px)) for texts in (full, short)]
        tries = [(texts, places, place_costs(places, boxes, habits)) for texts, places in sizes]
        placed: dict[int, tuple[Lines, FloatArray]] = {}
        self._habits = {}
        for i, track_id in enumerate(ids):
            for texts, places, costs in tries:
                number = free_place(places[i], costs[i], taken)
                if number is not None:
                    placed[i] = (texts[i], places[i, number])
                    taken = np.vstack([taken, places[i, number]])
                    self._habits[track_id] = number
                    break
        return placed

    def _draw_corners(self, canvas: Image, corners: Sequence[Lines]) -> FloatArray:
        """Draw the clock at the upper left and the legend, if there is room, at the upper right.

        Returns:
            (2 or 3, 4) what these, and the inset, take.
        """
        (w, h), (legend_w, legend_h) = self._pen.sizes_px(corners).tolist()
        left = canvas.shape[1] - legend_w
        places = np.array([[0, 0, w, h], [left, 0, left + legend_w, legend_h]])[: 1 if left < w else 2]
        for lines, place in zip(corners, places, strict=False):
            self._pen.write(canvas, lines, place)
        return np.vstack([places, self._inset.place((canvas.shape[1], canvas.shape[0]))])
