"""The overlay: a frame with each track's box, identity and distances drawn on it, for a person's eyes.

Box solid = seen, dashed = predicted; corners inside it = the window that stereo matches; the label (`labels.py`) stands
at the box, inside the image, and never on another label (`label_layout.py`). At the lower left the road from
above (`birds_eye.py`), on the road the own lane's lines. Near tracks choose their place first; one that finds no room
for a full label gets the first line alone, and one that finds none for that is left with its box.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray, Image
from track_range.overlay.birds_eye import BirdsEye
from track_range.overlay.colours import track_colour
from track_range.overlay.label_layout import LabelPlacer
from track_range.overlay.labels import BOLD, Lines, corner_lines, label_lines, text_sizes_px
from track_range.overlay.marks import draw_box, draw_inner_windows, draw_lanes, draw_leader
from track_range.overlay.text import Pen
from track_range.ranging.registry import methods
from track_range.run.frame_result import FrameResult
from track_range.stereo.geometry.camera import PinholeCamera

Status = Callable[[], Sequence[str]]
"""Words on how the run goes, such as its frames per second."""

MOST_LABELS = 100
"""More never find room: of a crowd, the nearest get labels."""


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
        self._placer = LabelPlacer()

    def draw(self, result: FrameResult) -> Image:
        """A new (H, W, 3) uint8 BGR image: the left frame with its tracks drawn on it.

        Boxes may reach outside the image; a box with NaN is left out; a NaN distance is shown as "-".
        """
        canvas = result.frame.left.copy()
        line_px = text_sizes_px((canvas.shape[1], canvas.shape[0]))[2]
        boxes = result.tracks.xyxy_px
        whole = np.flatnonzero(np.isfinite(boxes).all(axis=1))
        nearest_first = whole[np.argsort(-boxes[whole, 3])].tolist()
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
        """Boxes in the order of `rows`, then the inner windows of those that are seen."""
        line_px = text_sizes_px((canvas.shape[1], canvas.shape[0]))[2]
        uses_right = any("right_image" in method.needs and method.name in result.ranges for method in methods())
        seen = result.tracks.observed.tolist()
        colours = {row: track_colour(int(result.tracks.track_id[row])) for row in rows}
        for row in rows:
            draw_box(canvas, boxes[row], bgr=colours[row], line_px=line_px, dashed=not seen[row])
        matched = [row for row in rows if seen[row] and uses_right]
        draw_inner_windows(canvas, boxes[matched], [colours[row] for row in matched])

    def _draw_labels(self, canvas: Image, result: FrameResult, boxes: FloatArray, rows: Sequence[int]) -> None:
        """The corners, then each track's label in the order of `rows`, each beside those before it."""
        image_px = (canvas.shape[1], canvas.shape[0])
        *sizes_px, line_px = text_sizes_px(image_px)
        corners = corner_lines(result, sizes_px[1], status=self._status(), warning=self._warning)
        taken = self._draw_corners(canvas, corners)
        rows = rows[:MOST_LABELS]
        full = [
            label_lines(result, row, class_names=self.class_names, sizes_px=(sizes_px[0], sizes_px[1])) for row in rows
        ]
        lines_of = (full, [lines[:1] for lines in full])
        found = self._placer.place(
            [int(result.tracks.track_id[row]) for row in rows],
            boxes[rows],
            np.stack([self._pen.sizes_px(lines) for lines in lines_of]),
            taken=taken,
            image_px=image_px,
            urgent=[lines[-1][0].weight == BOLD and lines[-1][0].fill is not None for lines in full],
        )
        placed = [(row, lines_of[at[0]][i], at[1]) for i, (row, at) in enumerate(zip(rows, found, strict=True)) if at]
        colours = {row: track_colour(int(result.tracks.track_id[row])) for row, _, _ in placed}
        for row, _, place in placed:
            draw_leader(canvas, place, boxes[row], bgr=colours[row], line_px=line_px)
        for row, lines, place in placed:
            self._pen.write(canvas, lines, place, stripe=colours[row])

    def _draw_corners(self, canvas: Image, corners: Sequence[Lines]) -> FloatArray:
        """Draw the clock at the upper left and the legend at the upper right, where there is room.

        Returns:
            (1 to 3, 4) what these, and the inset, take.
        """
        (w, h), (legend_w, legend_h) = self._pen.sizes_px(corners).tolist()
        width = canvas.shape[1]
        places = np.array([[0, 0, w, h], [width - legend_w, 0, width, legend_h]])
        places = places[: 0 if w > width else 1 if w + legend_w > width else 2]
        for lines, place in zip(corners, places, strict=False):
            self._pen.write(canvas, lines, place)
        return np.vstack([places, self._inset.place((width, canvas.shape[0]))])
