"""Texts of the overlay: label of a track, and texts in the upper corners.

+------------------------+   fused distance (large) and its sigma, class and track ID in the colour of the track;
| 22.4 m ±0.7   car 12   |   distance by each method, after its letter in the registry;
| M 23.1  S 22.4  G 22.0 |   for a closing object time to collision and closing speed, on a bar that fills as the time
|#TTC 3.6 s##closing 6.2 |   decreases, amber or red if urgent; "passes in" without a bar if it will pass by.
+------------------------+
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from track_range.pipeline.colours import AMBER, CALM, GREY, WHITE, Bgr, track_colour, warning_colour
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.registry import methods

CLOSING_SHOWN_MPS = 0.5
"""Smallest closing speed that is shown, in m/s; slower ones are within the noise of the distance filter."""

TTC_SHOWN_S = 30.0
"""Longest time to collision that is shown, in seconds; beyond it only the closing speed is shown."""

BAR_S = 8.0
"""Time to collision in seconds at which its bar is empty; at 0 s it is full."""

LONGEST_NAME = 24
"""Longest class name that is shown in full, in characters."""

_LEAST_ASPECT = 0.75
"""Largest height / width of an image (4:3) up to which the text size follows the height."""

BOLD, REGULAR = 700, 450
"""Font weights, 100..900."""


@dataclass(frozen=True, slots=True)
class Span:
    """A piece of text in one size and colour.

    Attributes:
        text: the text.
        size_px: font size in pixels.
        weight: font weight, 100..900.
        bgr: colour of the text.
        fill: colour of the bar behind the line; None = no bar.
        filled: length of the bar as a fraction of the line, 0..1.
    """

    text: str
    size_px: int
    weight: int
    bgr: Bgr
    fill: Bgr | None = None
    filled: float = 0.0


Line = Sequence[Span]
Lines = Sequence[Line]


def text_sizes_px(image_px: tuple[int, int]) -> tuple[int, int, int]:
    """Large text, small text and stroke width in px for an image (W, H): 26, 18 and 3 at 1280 x 720.

    In images taller than 4:3 the sizes follow the width, which limits the width of labels.
    """
    height_px = min(image_px[1], _LEAST_ASPECT * image_px[0])
    return round(4 + 0.03 * height_px), max(11, round(3.5 + 0.02 * height_px)), max(1, round(1 + 0.0025 * height_px))


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
    line = name if name.isprintable() else "".join(character if character.isprintable() else " " for character in name)
    return line if len(line) <= LONGEST_NAME else line[: LONGEST_NAME - 1] + "…"


def shown_distance(result: FrameResult, row: int) -> tuple[float, float]:
    """Fused, else filtered distance with its sigma in metres (predicted boxes have no fused one); NaN = unknown."""
    for name in ("fused", "fused_kf"):
        if name in result.ranges and math.isfinite(result.ranges[name].distance_m[row]):
            return float(result.ranges[name].distance_m[row]), float(result.ranges[name].sigma_m[row])
    return math.nan, math.nan


def label_lines(result: FrameResult, row: int, *, class_names: Sequence[str], sizes_px: tuple[int, int]) -> Lines:
    """Label of a track in one to three lines: fused distance and identity, distances by method, closing speed."""
    large_px, small_px = sizes_px
    tracks, ranges = result.tracks, result.ranges
    identity = f"{shown_name(class_names[int(tracks.class_id[row])])} {int(tracks.track_id[row])}"
    named = Span(identity, small_px, BOLD, track_colour(int(tracks.track_id[row])))
    distance_m, sigma_m = shown_distance(result, row)
    metres = Span(f"{distance_text(distance_m)} m", large_px, BOLD, WHITE)
    sigma = [Span(f"±{sigma_text(sigma_m)}", small_px, REGULAR, WHITE)] if math.isfinite(distance_m) else []
    lines = [[metres, *sigma, named]]
    figures = []
    for method in methods():
        if method.name in ranges and math.isfinite(ranges[method.name].distance_m[row]):
            figures.append(f"{method.letter} {distance_text(float(ranges[method.name].distance_m[row]))}")
    if figures:
        lines.append([Span("  ".join(figures), small_px, REGULAR, GREY)])
    closing = closing_span(
        float(result.closing_mps[row]),
        float(result.ttc_s[row]),
        small_px,
        alarm=warning_colour(result, row),
        may_hit=result.may_hit(row),
    )
    return [*lines, [closing]] if closing else lines


def closing_span(
    closing_mps: float, ttc_s: float, size_px: int, *, alarm: Bgr | None = None, may_hit: bool = True
) -> Span | None:
    """Time to collision and closing speed on a bar; None for objects that do not approach.

    Args:
        closing_mps: closing speed.
        ttc_s: time to collision; NaN = unknown.
        size_px: font size.
        alarm: colour of the bar if the track is marked, amber or red.
        may_hit: False for objects that will pass by, which have no bar.
    """
    if not closing_mps > CLOSING_SHOWN_MPS:
        return None
    speed = f"closing {closing_mps:.1f} m/s"
    text = f"{'TTC' if may_hit else 'passes in'} {ttc_s:.1f} s  {speed}" if ttc_s < TTC_SHOWN_S else speed
    filled = min(1.0, 1 - ttc_s / BAR_S) if may_hit and ttc_s < BAR_S else 0.0
    return Span(text, size_px, REGULAR if alarm is None else BOLD, WHITE, alarm or CALM, filled)


def corner_lines(
    result: FrameResult, size_px: int, *, status: Sequence[str] = (), warning: str = ""
) -> tuple[Lines, Lines]:
    """Texts of the upper left corner (frame number, time, status, warning) and of the upper right one (legend)."""
    clock = [Span(f"frame {result.frame.index}", size_px, BOLD, WHITE)]
    clock += [Span(text, size_px, REGULAR, WHITE) for text in (f"{result.frame.time_s:.2f} s", *status)]
    if warning:
        clock.append(Span(warning, size_px, BOLD, AMBER))
    letters = [f"{method.letter} {method.title}" for method in methods() if method.name in result.ranges]
    legend = "   ".join(["large: fused ±1 sigma", *letters, "dashed: predicted"])
    return [clock], [[Span(legend, size_px, REGULAR, GREY)]]
