"""The overlay: a frame with each track's box, identity and distances drawn on it, for a person's eyes.

+------------------------+   A track's label stands at its box, inside the image, and never on another label:
| 22.4 m ±0.7   car 12   |     large the fused distance and its sigma, then class and id in the track's colour;
| M 23.1  S 22.4  G 22.0 |     the methods side by side, by the letters of `METHOD_LETTERS`;
| TTC 3.6 s  closing ... |     when the gap shrinks: time to collision and closing speed, amber or red.
+========================+   Near tracks choose their place first; one that finds no room for a full label gets
|    box: solid = seen,  |   the first line alone, and one that finds none for that is left with its box.
|    dashed = predicted  |
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from detection.classes import ROAD_CLASSES
from detection.detections import FloatArray, Image
from track_range.results import FrameResult

Bgr = tuple[int, int, int]
BLACK, GREY, WHITE = (0, 0, 0), (210, 210, 210), (255, 255, 255)
AMBER, RED = (0, 170, 255), (50, 50, 240)

METHOD_LETTERS = {"mono": "M", "lane": "L", "ground": "P", "stereo": "S", "sgbm": "G"}
"""The small figures' letters; a legend in the corner spells them out."""

METHOD_WORDS = {"ground": "ground plane", "sgbm": "dense stereo"}
"""Words of the legend where the method's own name says little."""

TTC_AMBER_S, TTC_RED_S = 4.0, 2.0

CLOSING_SHOWN_MPS = 0.5
"""Slower closing is within the distance filter's noise on a standing gap."""

TTC_SHOWN_S = 30.0
"""A longer time to collision warns of nothing; the closing speed alone is shown."""

BOLD, REGULAR = 700, 450
"""Font weights, 100..900."""


LUMA_MIN = 0.5
"""Of full white: darker text is hard to read on a label's backing."""


def track_palette() -> tuple[Bgr, ...]:
    """Twelve colours, bright enough to be read on a dark label, following ones far apart.

    Hues run from 75 to 325 degrees: red and amber are kept for warnings.
    """
    hues = np.linspace(75, 325, 6)[[0, 3, 1, 4, 2, 5]] / 360
    rgb = np.array([colorsys.hsv_to_rgb(hue, tone, 1.0) for tone in (0.85, 0.4) for hue in hues.tolist()])
    luma = rgb @ (0.299, 0.587, 0.114)
    white = np.clip((LUMA_MIN - luma) / (1 - luma), 0, 1)[:, None]
    bgr = np.rint(255 * (rgb + white * (1 - rgb)))[:, ::-1].astype(int)
    return tuple((int(blue), int(green), int(red)) for blue, green, red in bgr)


PALETTE = track_palette()


def track_colour(track_id: int) -> Bgr:
    """The colour of a track, the same in every frame."""
    return PALETTE[track_id % len(PALETTE)]


def alarm_colour(ttc_s: float) -> Bgr | None:
    """Red below 2 s to collision, amber below 4 s, else none (NaN: none)."""
    if ttc_s < TTC_RED_S:
        return RED
    return AMBER if ttc_s < TTC_AMBER_S else None


@dataclass(frozen=True, slots=True)
class Span:
    """A piece of text in one size and colour; `back` is the colour behind it, None = the label's own backing."""

    text: str
    size_px: int
    weight: int
    bgr: Bgr
    back: Bgr | None = None


Lines = Sequence[Sequence[Span]]

BESIDE = ((0, 0, 0, -1), (1, 0, -1, -1), (0, 1, 0, 0), (1, 1, -1, 0), (1, 0, 0, 0), (0, 0, -1, 0), (0, 0, 0, 0))
AWAY = tuple((0, 0, across, -1 - up) for up in (0, 1, 2, 3, 4, -1, -2) for across in (0, 0.5, -0.5, 1, -1, 1.5, -1.5))
PLACES = np.array(BESIDE + AWAY, np.float64).reshape(-1, 2, 2)
"""(K, 2, 2) where a label may stand, best first: its upper left corner minus the box's, in box widths and heights,
then label widths and heights: above the box, below, beside it, inside it, then away from it in growing steps."""


def distance_text(distance_m: float) -> str:
    """Metres with one decimal, from 100 m with none; "-" for NaN."""
    if not np.isfinite(distance_m):
        return "-"
    return f"{distance_m:.0f}" if distance_m >= 99.95 else f"{distance_m:.1f}"


def label_lines(result: FrameResult, row: int, *, class_names: Sequence[str], sizes_px: tuple[int, int]) -> Lines:
    """One to three lines for a track: fused distance and identity, the methods, the closing speed."""
    large_px, small_px = sizes_px
    tracks, ranges = result.tracks, result.ranges
    identity = f"{class_names[int(tracks.class_id[row])]} {int(tracks.track_id[row])}"
    named = Span(identity, small_px, BOLD, track_colour(int(tracks.track_id[row])))
    known = (ranges[name] for name in ("fused", "fused_kf") if name in ranges)  # a predicted box is not measured
    shown = next((found for found in known if np.isfinite(found.distance_m[row])), None)
    metres = Span(f"{distance_text(shown.distance_m[row]) if shown else '-'} m", large_px, BOLD, WHITE)
    sigma = [Span(f"±{distance_text(shown.sigma_m[row])}", small_px, REGULAR, WHITE)] if shown else []
    lines = [[metres, *sigma, named]]
    methods = [(letter, ranges[name]) for name, letter in METHOD_LETTERS.items() if name in ranges]
    if methods:
        figures = "  ".join(f"{letter} {distance_text(found.distance_m[row])}" for letter, found in methods)
        lines.append([Span(figures, small_px, REGULAR, GREY)])
    closing = closing_span(float(result.closing_mps[row]), float(result.ttc_s[row]), small_px)
    return [*lines, [closing]] if closing else lines


def closing_span(closing_mps: float, ttc_s: float, size_px: int) -> Span | None:
    """Time to collision and closing speed on amber or red where it is urgent; None where the gap does not shrink."""
    if not closing_mps > CLOSING_SHOWN_MPS:
        return None
    text = f"closing {closing_mps:.1f} m/s"
    if ttc_s < TTC_SHOWN_S:
        text = f"TTC {ttc_s:.1f} s  {text}"
    back = alarm_colour(ttc_s)
    front = GREY if back is None else BLACK if back == AMBER else WHITE
    return Span(text, size_px, REGULAR if back is None else BOLD, front, back)


def corner_lines(result: FrameResult, size_px: int, *, warning: str = "") -> tuple[Lines, Lines]:
    """What the two upper corners say: frame number and time, with a warning; the legend of the letters and strokes."""
    clock = [Span(f"frame {result.frame.index}", size_px, BOLD, WHITE)]
    clock.append(Span(f"{result.frame.time_s:.2f} s", size_px, REGULAR, WHITE))
    if warning:
        clock.append(Span(warning, size_px, BOLD, AMBER))
    letters = [
        f"{letter} {METHOD_WORDS.get(name, name)}" for name, letter in METHOD_LETTERS.items() if name in result.ranges
    ]
    legend = "   ".join(["large: fused ±1 sigma", *letters, "dashed: predicted"])
    return [clock], [[Span(legend, size_px, REGULAR, GREY)]]


def text_sizes_px(height_px: int) -> tuple[int, int, int]:
    """Large text, small text and stroke for an image of this height: 15, 11, 2 at 374 px; 26, 18, 3 at 720 px."""
    return round(4 + 0.03 * height_px), max(11, round(3.5 + 0.02 * height_px)), max(1, round(1 + 0.0025 * height_px))


def label_places(boxes: FloatArray, size_px: FloatArray, image_px: tuple[int, int]) -> FloatArray:
    """(N, K, 4) places for labels of (N, 2) widths and heights at (N, 4) boxes, best first, in an image (W, H)."""
    spans = np.stack([boxes[:, 2:] - boxes[:, :2], size_px], axis=1)
    corner = boxes[:, None, :2] + np.einsum("kij,nij->nkj", PLACES, spans)
    corner = np.clip(corner, 0.0, np.maximum(np.array(image_px) - size_px, 0.0)[:, None]).round()
    return np.concatenate([corner, corner + size_px[:, None]], axis=2)


def shared_areas(places: FloatArray, others: FloatArray) -> FloatArray:
    """(..., K) area in px that each of (..., K, 4) boxes shares with (M, 4) others, summed over these."""
    corners = places[..., None]
    width = np.minimum(corners[..., 2, :], others[:, 2]) - np.maximum(corners[..., 0, :], others[:, 0])
    height = np.minimum(corners[..., 3, :], others[:, 3]) - np.maximum(corners[..., 1, :], others[:, 1])
    return np.asarray(np.einsum("...m,...m->...", np.maximum(width, 0.0), np.maximum(height, 0.0)), np.float64)


def place_costs(places: FloatArray, boxes: FloatArray) -> FloatArray:
    """(N, K) what each of (N, K, 4) places costs: the area of boxes it covers, and its number in the list."""
    w, h = (places[:, 0, 2:] - places[:, 0, :2]).T
    # A step down the list costs as much as a hundredth of the label's area laid over boxes.
    return shared_areas(places, boxes) + np.outer(0.01 * w * h, np.arange(places.shape[1]))


def free_place(places: FloatArray, costs: FloatArray, taken: FloatArray) -> FloatArray | None:
    """The cheapest of (K, 4) places that covers none of the labels in `taken`; None if every place covers one."""
    free = shared_areas(places, taken) == 0
    return np.asarray(places[np.argmin(np.where(free, costs, np.inf))]) if free.any() else None


def draw_box(canvas: Image, box: FloatArray, *, bgr: Bgr, line_px: int, dashed: bool) -> None:
    """Outline one box on a dark seam, dashed for a predicted one; parts outside the image are not drawn."""
    x1, y1, x2, y2 = np.rint(box).astype(int).tolist()
    if not dashed:
        cv2.rectangle(canvas, (x1, y1), (x2, y2), BLACK, line_px + 2)
        cv2.rectangle(canvas, (x1, y1), (x2, y2), bgr, line_px)
        return
    step = 7 * line_px
    across = [((x, y), (min(x + step // 2, x2), y)) for y in (y1, y2) for x in range(x1, x2, step)]
    down = [((x, y), (x, min(y + step // 2, y2))) for x in (x1, x2) for y in range(y1, y2, step)]
    strokes = np.array(across + down, np.int32).reshape(-1, 2, 2)
    cv2.polylines(canvas, list(strokes), False, BLACK, line_px + 2)
    cv2.polylines(canvas, list(strokes), False, bgr, line_px)


def draw_leader(canvas: Image, place: FloatArray, box: FloatArray, *, bgr: Bgr) -> None:
    """A thin line from a label to its box, where a gap lies between them."""
    low, high = np.maximum(place[:2], box[:2]), np.minimum(place[2:], box[2:])
    if (low > high + 2).any():
        # Between overlapping spans of an axis both ends take the same coordinate: the line is the shortest one.
        start = np.where(low > high, np.clip(box[:2], place[:2], place[2:]), low)
        end = np.clip(start, box[:2], box[2:])
        ends = np.rint([start, end]).astype(int).tolist()
        cv2.line(canvas, ends[0], ends[1], BLACK, 3)
        cv2.line(canvas, ends[0], ends[1], bgr, 1)


class Overlay:
    """Draws results, and `warning` in the corner of every frame; one instance serves one thread."""

    def __init__(self, class_names: Sequence[str] = ROAD_CLASSES, *, warning: str = "") -> None:
        self.class_names = tuple(class_names)
        self._warning = warning
        self._font = cv2.FontFace("sans")

    def draw(self, result: FrameResult) -> Image:
        """A new (H, W, 3) uint8 BGR image: the left frame with its tracks drawn on it.

        Boxes may reach outside the image; a box with NaN is left out; a NaN distance is shown as "-".
        """
        canvas = result.frame.left.copy()
        boxes, line_px = result.tracks.xyxy_px, text_sizes_px(len(canvas))[2]
        nearest_first = [int(row) for row in np.argsort(-boxes[:, 3]) if np.isfinite(boxes[row]).all()]
        # Edges outside the image are brought near it: the drawing takes 32-bit pixels and as many dashes as asked.
        size_px = np.array(canvas.shape[1::-1], np.float64)
        boxes = np.clip(boxes, -8.0 * line_px, np.tile(size_px, 2) + 8.0 * line_px)
        for row in reversed(nearest_first):
            colour, seen = track_colour(int(result.tracks.track_id[row])), bool(result.tracks.observed[row])
            draw_box(canvas, boxes[row], bgr=colour, line_px=line_px, dashed=not seen)
        self._draw_labels(canvas, result, boxes, nearest_first)
        return canvas

    def _draw_labels(self, canvas: Image, result: FrameResult, boxes: FloatArray, rows: Sequence[int]) -> None:
        """The corners, then each track's label in the order of `rows`, each beside those before it."""
        image_px, sizes_px = (canvas.shape[1], canvas.shape[0]), text_sizes_px(len(canvas))[:2]
        full = [label_lines(result, row, class_names=self.class_names, sizes_px=sizes_px) for row in rows]
        taken = self._draw_corners(canvas, corner_lines(result, sizes_px[1], warning=self._warning))
        places = label_places(boxes[rows], self._label_sizes_px(full), image_px)
        costs = place_costs(places, boxes[rows])
        labels = []
        for i, row in enumerate(rows):
            lines, place = full[i], free_place(places[i], costs[i], taken)
            if place is None:
                lines = full[i][:1]
                short = label_places(boxes[[row]], self._label_sizes_px([lines]), image_px)
                place = free_place(short[0], place_costs(short, boxes[rows])[0], taken)
            if place is not None:
                taken = np.vstack([taken, place])
                labels.append((lines, place, track_colour(int(result.tracks.track_id[row]))))
                draw_leader(canvas, place, boxes[row], bgr=labels[-1][2])
        for lines, place, colour in labels:
            self._draw_label(canvas, lines, place, stripe=colour)

    def _draw_corners(self, canvas: Image, corners: Sequence[Lines]) -> FloatArray:
        """Draw the clock at the upper left and the legend, if there is room, at the upper right: (1 or 2, 4) places."""
        (w, h), (legend_w, legend_h) = self._label_sizes_px(corners).tolist()
        left = canvas.shape[1] - legend_w
        places = np.array([[0, 0, w, h], [left, 0, left + legend_w, legend_h]])[: 1 if left < w else 2]
        for lines, place in zip(corners, places, strict=False):
            self._draw_label(canvas, lines, place)
        return places

    def _span_width_px(self, span: Span) -> int:
        """Width of the text and the gap after it."""
        box = cv2.getTextSize((0, 0), span.text, (0, 0), self._font, span.size_px, span.weight)
        return int(box[2]) + span.size_px // 2

    def _label_sizes_px(self, labels: Sequence[Lines]) -> FloatArray:
        """(N, 2) width and height of each label on its backing, with margins."""
        widths = [max(sum(map(self._span_width_px, line)) for line in lines) for lines in labels]
        heights = [sum(map(line_height_px, lines)) for lines in labels]
        return np.asarray(np.array([widths, heights], np.float64).T + np.array([6.0, 2.0]), np.float64)

    def _draw_label(self, canvas: Image, lines: Lines, place: FloatArray, *, stripe: Bgr | None = None) -> None:
        """Lines on a darkened backing at `place`, with a stripe in the track's colour at the left."""
        left, top, right, bottom = np.rint(place).astype(int).tolist()
        backing = canvas[top:bottom, left:right]
        np.right_shift(backing, 2, out=backing)
        if stripe is not None:
            canvas[top:bottom, left : left + 3] = stripe
        baseline = top
        for line in lines:
            x, height = left + 6, line_height_px(line)
            if line[0].back is not None:
                canvas[baseline + 1 : baseline + height + 1, left + 3 : right] = line[0].back
            baseline += height
            for span in line:
                at = (x, baseline - height // 5)
                end, _ = cv2.putText(canvas, span.text, at, span.bgr, self._font, span.size_px, span.weight)
                x = end[0] + span.size_px // 2


def line_height_px(line: Sequence[Span]) -> int:
    """Height of a line of text: a quarter more than its largest span."""
    return max(span.size_px for span in line) * 5 // 4
