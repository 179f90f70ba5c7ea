"""Texts of the overlay, their layout and their drawing: label of a track, and texts in the upper
corners.

+------------------------+   fused distance (large) and its sigma, class and track ID in the colour of the track;
| 22.4 m ±0.7   car 12   |   distance by each method, after its letter in the registry;
| M 23.1  S 22.4  G 22.0 |   for a closing object time to collision of the front and closing speed, on a bar that fills
|#TTC 3.6 s##closing 6.2 |   as the time decreases, amber or red if urgent; "beside in" without a bar if it passes by.
+------------------------+   The text has another colour on the filled part of the bar.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.pipeline.colours import (
    AMBER,
    BLACK,
    CALM,
    GREY,
    WHITE,
    Bgr,
    track_colour,
    warning_colour,
)
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.registry import methods
from track_range.ranging.warning.safety import apart_m
from track_range.results.counts.counter import KMH
from track_range.views.tables import NOT_FUSED

# smallest closing speed that is shown; slower ones are within the noise of the distance filter
CLOSING_SHOWN_MPS = 0.5
# longest time to collision that is shown, in seconds; beyond it only the closing speed is shown
TTC_SHOWN_S = 30.0
BAR_S = 8.0  # time to collision in seconds at which its bar is empty; at 0 s it is full
LONGEST_NAME = 24  # longest class name that is shown in full, in characters
# smallest left margin of the text; the stripe in the colour of the track has half of it
_MARGIN_PX = 6
_N_CACHED_WIDTHS = 4096  # number of texts whose widths are cached
# largest height / width of an image (4:3) up to which the text size follows the height
_LEAST_ASPECT = 0.75
BOLD, REGULAR = 700, 450  # font weights, 100..900


@dataclass(frozen=True, slots=True)
class Span:
    """A piece of text in one size and colour."""

    text: str
    size_px: int
    weight: int  # font weight, 100..900
    bgr: Bgr
    fill: Bgr | None = None  # colour of the bar behind the line; None = no bar
    filled: float = 0.0  # length of the bar as a fraction of the line, 0..1


Line = Sequence[Span]
Lines = Sequence[Line]


@cache  # of few sizes of images
def text_sizes_px(image_px: tuple[int, int]) -> tuple[int, int, int]:
    """Large text, small text and stroke width in px for an image (W, H): 26, 18 and 3 at 1280 x
    720.

    In images taller than 4:3 the sizes follow the width, which limits the width of labels.
    """
    height_px = min(image_px[1], _LEAST_ASPECT * image_px[0])
    return (
        round(4 + 0.03 * height_px),
        max(11, round(3.5 + 0.02 * height_px)),
        max(1, round(1 + 0.0025 * height_px)),
    )


def distance_text(distance_m: float) -> str:
    """Distance in metres with one decimal, without decimals from 100 m; "-" for NaN."""
    if not math.isfinite(distance_m):
        return "-"
    return f"{distance_m:.0f}" if distance_m >= 99.95 else f"{distance_m:.1f}"


def sigma_text(sigma_m: float) -> str:
    """Sigma in metres, formatted as a distance but with two decimals below 0.1 m."""
    return f"{sigma_m:.2f}" if sigma_m < 0.095 else distance_text(sigma_m)


def shown_name(name: str) -> str:
    """Class name on one line, shortened to `LONGEST_NAME` characters."""
    line = (
        name
        if name.isprintable()
        else "".join(character if character.isprintable() else " " for character in name)
    )
    return line if len(line) <= LONGEST_NAME else line[: LONGEST_NAME - 1] + "…"


def shown_distance(result: FrameResult, row: int) -> tuple[float, float]:
    """Fused, else filtered distance (as for predicted boxes) with its sigma in metres; NaN =
    unknown.
    """
    for name in ("fused", "fused_kf"):
        if name in result.ranges and math.isfinite(result.ranges[name].distance_m[row]):
            return float(result.ranges[name].distance_m[row]), float(
                result.ranges[name].sigma_m[row]
            )
    return math.nan, math.nan


def label_lines(
    result: FrameResult, row: int, *, class_names: Sequence[str], sizes_px: tuple[int, int]
) -> Lines:
    """Label of a track in one to three lines: fused distance and identity, distances by method,
    closing speed.
    """
    large_px, small_px = sizes_px
    tracks, ranges = result.tracks, result.ranges
    identity = f"{shown_name(class_names[int(tracks.class_id[row])])} {int(tracks.track_id[row])}"
    named = Span(identity, small_px, BOLD, track_colour(int(tracks.track_id[row])))
    distance_m, sigma_m = shown_distance(result, row)
    metres = Span(f"{distance_text(distance_m)} m", large_px, BOLD, WHITE)
    sigma = (
        [Span(f"±{sigma_text(sigma_m)}", small_px, REGULAR, WHITE)]
        if math.isfinite(distance_m)
        else []
    )
    lines = [[metres, *sigma, named]]
    figures = [
        f"{method.letter} {distance_text(float(ranges[method.name].distance_m[row]))}"
        for method in methods()
        if method.name in ranges and math.isfinite(ranges[method.name].distance_m[row])
    ]
    if figures:
        lines.append([Span("  ".join(figures), small_px, REGULAR, GREY)])
    closing_mps = float(result.closing_mps[row])
    if not closing_mps > CLOSING_SHOWN_MPS:  # the usual case, of which nothing more is shown
        return lines
    alarm, warnings = warning_colour(result, row), result.warnings
    by_track_s = result.safety.ttc_front_s if result.alarms.has_safety else result.ttc_s
    ttc_s, passes = float(by_track_s[row]), False
    if math.isnan(ttc_s) and alarm is None:  # no contact is possible
        passes = bool(apart_m(warnings.path_offset_m, result.tracks.class_id)[row] > 0)
        ttc_s = float(result.ttc_s[row]) if passes else ttc_s
    closing = closing_span(closing_mps, ttc_s, small_px, alarm=alarm, passes=passes)
    return [*lines, [closing]] if closing else lines


def with_speed(result: FrameResult, row: int, lines: Lines) -> Lines:
    """The label of a track of a camera that stands still: its speed over ground, if it is known,
    in the place of the distance, which begins the second line; without a time to collision.
    """
    speed_mps, sigma_mps = result.motion.speed_mps[row], result.motion.speed_sigma_mps[row]
    metres, *others = lines[0]
    if not math.isfinite(speed_mps):
        return lines[:1]
    *sigma, named = others
    speed = replace(metres, text=f"{KMH * speed_mps:.0f}")
    unit = replace(named, text=f"±{KMH * sigma_mps:.0f} km/h", weight=REGULAR, bgr=WHITE)
    far = replace(named, text=" ".join(span.text for span in (metres, *sigma)), bgr=GREY)
    return [[speed, unit, named], [replace(far, weight=REGULAR)]]


def closing_span(
    closing_mps: float,
    ttc_s: float,
    size_px: int,
    *,
    alarm: Bgr | None = None,
    passes: bool = False,
) -> Span | None:
    """Time to collision (NaN = unknown) and closing speed on a bar; None for objects that do not
    approach.

    `alarm` is the colour of the bar of a marked track, amber or red; objects that will pass by
    (`passes`) have no bar, and their time is the time until they are beside the camera.
    """
    if not closing_mps > CLOSING_SHOWN_MPS:
        return None
    speed = f"closing {closing_mps:.1f} m/s"
    text = (
        f"{'beside in' if passes else 'TTC'} {ttc_s:.1f} s  {speed}"
        if ttc_s < TTC_SHOWN_S
        else speed
    )
    filled = min(1.0, 1 - ttc_s / BAR_S) if ttc_s < BAR_S and not passes else 0.0
    return Span(text, size_px, REGULAR if alarm is None else BOLD, WHITE, alarm or CALM, filled)


def corner_lines(
    result: FrameResult,
    size_px: int,
    *,
    status: Sequence[str] = (),
    warning: str = "",
    large: str = "fused",
) -> tuple[Lines, Lines]:
    """Texts of the upper left corner (frame number, time, status, warning) and of the upper right
    corner (legend); `large` is what the large numbers of the labels are.
    """
    clock = [Span(f"frame {result.frame.index}", size_px, BOLD, WHITE)]
    clock += [
        Span(text, size_px, REGULAR, WHITE) for text in (f"{result.frame.time_s:.2f} s", *status)
    ]
    if result.scale_doubt is not None:
        warning = "scale in doubt"
    if warning:
        clock.append(Span(warning, size_px, BOLD, AMBER))
    shown = [
        method for method in methods() if method.measures_distance and method.name in result.ranges
    ]
    letters = [
        f"{method.letter} {method.title}{NOT_FUSED if method.name in result.shown_only else ''}"
        for method in shown
    ]
    legend = "   ".join([f"large: {large} ±1 sigma", *letters, "dashed: predicted"])
    return [clock], [[Span(legend, size_px, REGULAR, GREY)]]


class TextRenderer:
    """Draws text in OpenCV's built-in font on a darkened background; not thread-safe."""

    def __init__(self) -> None:
        self._font = cv2.FontFace("sans")
        self._width_px = lru_cache(_N_CACHED_WIDTHS)(self._new_width_px)

    def sizes_px(self, labels: Sequence[Lines]) -> FloatArray:
        """(N, 2) width and height of each label in pixels, including margins."""
        sizes = []
        for lines in labels:
            widths_px = [
                sum([self._width_px(span.text, span.size_px, span.weight) for span in line])
                for line in lines
            ]
            sizes.append(
                (max(widths_px) + _margin_px(lines), sum(map(line_height_px, lines)) + 2.0)
            )
        return np.array(sizes, np.float64).reshape(-1, 2)

    def write(
        self, canvas: Image, lines: Lines, place: FloatArray, *, stripe: Bgr | None = None
    ) -> None:
        """Draw lines on a darkened background in the rectangle `place` (4,), with an optional
        stripe at the left.
        """
        left, top, right, bottom = map(round, place.tolist())
        background = canvas[top:bottom, left:right]
        np.right_shift(background, 2, out=background)
        margin, stripe_px = _margin_px(lines), _margin_px(lines) // 2
        if stripe is not None:
            cv2.rectangle(canvas, (left, top), (left + stripe_px - 1, bottom - 1), stripe, -1)
        for line in lines:
            height = line_height_px(line)
            self._write_line(canvas, line, (left + margin, top))
            if line[0].fill is not None and (
                filled := round(line[0].filled * (right - left - stripe_px))
            ):
                bar = canvas[
                    top + 1 : top + height + 1, left + stripe_px : left + stripe_px + filled
                ]
                cv2.rectangle(bar, (0, 0), (filled, height), line[0].fill, -1)
                on_bar = BLACK if line[0].fill == AMBER else WHITE
                self._write_line(bar, line, (margin - stripe_px, -1), bgr=on_bar)
            top += height

    def _write_line(
        self, canvas: Image, line: Line, corner: tuple[int, int], *, bgr: Bgr | None = None
    ) -> None:
        """Draw the spans of a line in their colours, or all in the colour `bgr`."""
        x, top = corner
        height = line_height_px(line)
        for span in line:
            origin, colour = (x, top + height - height // 5), span.bgr if bgr is None else bgr
            end, _ = cv2.putText(
                canvas, span.text, origin, colour, self._font, span.size_px, span.weight
            )
            x = end[0] + span.size_px // 2

    def _new_width_px(self, text: str, size_px: int, weight: int) -> int:
        box = cv2.getTextSize((0, 0), text, (0, 0), self._font, size_px, weight)
        return int(box[2]) + size_px // 2


def _margin_px(lines: Lines) -> int:
    return max(_MARGIN_PX, lines[0][0].size_px // 4)


def line_height_px(line: Line) -> int:
    """Height of a line of text in pixels: 1.25 times its largest font size."""
    return max([span.size_px for span in line]) * 5 // 4


BESIDE = (
    (0, 0, 0, -1),
    (1, 0, -1, -1),
    (0, 1, 0, 0),
    (1, 1, -1, 0),
    (1, 0, 0, 0),
    (0, 0, -1, 0),
    (0, 0, 0, 0),
)
AWAY = tuple(
    (0, 0, across, -1 - up)
    for up in (0, 1, 2, 3, 4, -1, -2)
    for across in (0, 0.5, -0.5, 1, -1, 1.5, -1.5)
)
PLACES = np.array(BESIDE + AWAY, np.float64).reshape(-1, 2, 2)
"""(K, 2, 2) candidate positions of a label, best first: offset of its upper left corner from the
box's upper left corner, as a multiple of the box size plus a multiple of the label size. First at
the box and inside it, then farther away."""

# cost of each step along the list of candidates, as a fraction of the label's area
_STEP_COST = 0.01
# bonus for the position in the previous frame, as a fraction of the label's area
_PREVIOUS_BONUS = 0.1
# cost, of the label's area, above which a full label is shortened if that reduces it
_MAX_COST = 0.3


class LabelPlacer:
    """Places the labels of one video, frame by frame: near their boxes, inside the image, and
    without overlap.

    Labels are placed greedily in the given order. Each gets the free candidate position of the
    lowest cost: the area of boxes it covers, plus a term that grows along the list of candidates
    (near ones first), minus a bonus for the position in the previous frame, so that labels do not
    jump. Boxes before its own, of nearer road users, are not free. A label without a free position,
    or at a high cost, is shortened; if that does not help either, it is omitted, or, if it is
    urgent, covers nearer road users.
    """

    def __init__(self) -> None:
        self._previous: dict[tuple[int, int], int] = {}

    def place(
        self,
        ids: Sequence[int],
        boxes: FloatArray,
        sizes_px: FloatArray,
        *,
        occupied: FloatArray,
        image_px: tuple[int, int],
        urgent: Sequence[bool],
    ) -> list[tuple[int, FloatArray] | None]:
        """Size (0 = full, 1 = short) and rectangle (4,) of the label of each track id; None = no
        free position.

        `boxes` (N, 4) have no NaN; `sizes_px` (2, N, 2) are width and height of full and short
        labels, which must not cover `occupied` (M, 4). An `urgent` (N,) label is shortened only if
        the full one has no free position.
        """
        previous, self._previous = self._previous, {}
        placements: list[tuple[int, FloatArray] | None] = []
        last = [previous.get((0, track_id)) for track_id in ids]
        all_places, all_costs = _candidates(boxes, sizes_px[0], image_px, last)
        for i, track_id in enumerate(ids):
            size, places, costs = 0, all_places[i], all_costs[i]
            closed = np.concatenate([occupied, boxes[:i]])
            number = free_place(places, costs, closed)
            best_cost = math.inf if number is None else costs[number]
            is_expensive = not urgent[i] and best_cost > _MAX_COST * sizes_px[0, i].prod()
            if number is None or is_expensive:
                last_short = [previous.get((1, track_id))]
                short_size_px = sizes_px[1, i : i + 1]
                (short_places,), (short_costs,) = _candidates(
                    boxes, short_size_px, image_px, last_short, row=i
                )
                short = free_place(short_places, short_costs, closed)
                if short is not None and short_costs[short] < best_cost:
                    size, number, places = 1, short, short_places
            if number is None and urgent[i]:  # over other boxes
                number = free_place(places, costs, occupied)
            if number is None:
                placements.append(None)
                continue
            self._previous[size, track_id] = number
            occupied = np.concatenate([occupied, places[number : number + 1]])
            placements.append((size, places[number]))
        return placements


def _candidates(
    boxes: FloatArray,
    size_px: FloatArray,
    image_px: tuple[int, int],
    previous: list[int | None],
    *,
    row: int | None = None,
) -> tuple[FloatArray, FloatArray]:
    """(N, K, 4) candidate rectangles and (N, K) costs, for all boxes or box `row`; inf if larger
    than the image.
    """
    places = label_places(boxes if row is None else boxes[row : row + 1], size_px, image_px)
    costs = place_costs(places, boxes, previous)
    costs[(size_px > image_px).any(axis=1)] = np.inf
    return places, costs


def label_places(boxes: FloatArray, size_px: FloatArray, image_px: tuple[int, int]) -> FloatArray:
    """(N, K, 4) candidate rectangles of labels of size (N, 2) at (N, 4) boxes in an image (W, H),
    best first.
    """
    spans = np.stack([boxes[:, 2:] - boxes[:, :2], size_px], axis=1)
    corner = boxes[:, None, :2] + np.einsum("kij,nij->nkj", PLACES, spans)
    last_px = np.maximum(np.array(image_px) - size_px, 0.0)[:, None]
    corner = np.minimum(np.maximum(corner, 0.0), last_px).round()
    return np.concatenate([corner, corner + size_px[:, None]], axis=2)


def shared_areas(places: FloatArray, others: FloatArray) -> FloatArray:
    """(..., K) area in px^2 that each of (..., K, 4) rectangles shares with (M, 4) other
    rectangles, summed.
    """
    corners = places[..., None]
    width = np.minimum(corners[..., 2, :], others[:, 2]) - np.maximum(
        corners[..., 0, :], others[:, 0]
    )
    height = np.minimum(corners[..., 3, :], others[:, 3]) - np.maximum(
        corners[..., 1, :], others[:, 1]
    )
    return np.asarray(
        np.einsum("...m,...m->...", np.maximum(width, 0.0), np.maximum(height, 0.0)), np.float64
    )


def place_costs(
    places: FloatArray, boxes: FloatArray, previous: list[int | None] | None = None
) -> FloatArray:
    """(N, K) costs in px^2 of (N, K, 4) candidates; `previous`: candidate of each label in the last
    frame, or None.
    """
    w, h = (places[:, 0, 2:] - places[:, 0, :2]).T
    costs = shared_areas(places, boxes) + np.outer(_STEP_COST * w * h, np.arange(places.shape[1]))
    for row, number in enumerate(previous or ()):
        if number is not None:
            costs[row, number] -= _PREVIOUS_BONUS * w[row] * h[row]
    return costs


def free_place(places: FloatArray, costs: FloatArray, occupied: FloatArray) -> int | None:
    """Index of the cheapest of (K, 4) candidates that is free and has a finite cost; None if there
    is none.
    """
    left, top, right, bottom = places.T[:, :, None]
    x1, y1, x2, y2 = occupied.T
    overlaps = (left < x2) & (right > x1) & (top < y2) & (bottom > y1)
    costs = np.where(overlaps.any(axis=1), np.inf, costs)
    number = int(costs.argmin())
    return number if costs[number] < np.inf else None
