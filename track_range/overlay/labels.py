"""Text of the overlay: what a track's label and the corners say, and how text is drawn on its backing.

+------------------------+   large the fused distance and its sigma, then class and id in the track's colour;
| 22.4 m ±0.7   car 12   |   what each method says, by the letters of the registry;
| M 23.1  S 22.4  G 22.0 |   when the gap shrinks: time to collision and closing speed, on a bar that fills as the
|#TTC 3.6 s##closing 6.2 |   time runs out, amber or red; "passes in" and no bar for what is not on our way.
+------------------------+
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from track_range.overlay.colours import AMBER, CALM, GREY, WHITE, Bgr, alarm_colour, track_colour
from track_range.ranging.registry import methods
from track_range.run.frame_result import FrameResult

CLOSING_SHOWN_MPS = 0.5
"""Slower closing is within the distance filter's noise on a standing gap."""

TTC_SHOWN_S = 30.0
"""A longer time to collision warns of nothing; the closing speed alone is shown."""

BAR_S = 8.0
"""The bar of the time to collision is empty at this much, full at none."""

LONGEST_NAME = 24
"""Letters of a class's name that are shown."""

_LEAST_ASPECT = 0.75
"""Height / width of an old television's picture."""

BOLD, REGULAR = 700, 450
"""Font weights, 100..900."""


@dataclass(frozen=True, slots=True)
class Span:
    """A piece of text in one size and colour.

    Attributes:
        fill: the colour of the bar behind the text; None = no bar.
        filled: how much of the line's length that takes, 0..1.
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
    """Large text, small text and stroke for an image (W, H): 15, 11, 2 at 374 rows; 26, 18, 3 at 1280 x 720.

    An upright image has the text of one as wide that lies: labels are as wide there.
    """
    height_px = min(image_px[1], _LEAST_ASPECT * image_px[0])
    return round(4 + 0.03 * height_px), max(11, round(3.5 + 0.02 * height_px)), max(1, round(1 + 0.0025 * height_px))


def distance_text(distance_m: float) -> str:
    """Metres with one decimal, from 100 m with none; "-" for NaN."""
    if not math.isfinite(distance_m):
        return "-"
    return f"{distance_m:.0f}" if distance_m >= 99.95 else f"{distance_m:.1f}"


def sigma_text(sigma_m: float) -> str:
    """As a distance, but never ±0.0: below 0.1 m with two decimals."""
    return f"{sigma_m:.2f}" if sigma_m < 0.095 else distance_text(sigma_m)


def shown_name(name: str) -> str:
    """A class's name on one line, and no longer than a label has room for."""
    line = "".join(letter if letter.isprintable() else " " for letter in name)
    return line if len(line) <= LONGEST_NAME else line[: LONGEST_NAME - 1] + "…"


def shown_distance(result: FrameResult, row: int) -> tuple[float, float]:
    """The fused distance and its sigma, else the filtered ones (a predicted box is not measured); NaN = unknown."""
    known = (result.ranges[name] for name in ("fused", "fused_kf") if name in result.ranges)
    pairs = ((float(found.distance_m[row]), float(found.sigma_m[row])) for found in known)
    return next((pair for pair in pairs if math.isfinite(pair[0])), (math.nan, math.nan))


def label_lines(result: FrameResult, row: int, *, class_names: Sequence[str], sizes_px: tuple[int, int]) -> Lines:
    """One to three lines for a track: fused distance and identity, the methods, the closing speed."""
    large_px, small_px = sizes_px
    tracks, ranges = result.tracks, result.ranges
    identity = f"{shown_name(class_names[int(tracks.class_id[row])])} {int(tracks.track_id[row])}"
    named = Span(identity, small_px, BOLD, track_colour(int(tracks.track_id[row])))
    distance_m, sigma_m = shown_distance(result, row)
    metres = Span(f"{distance_text(distance_m)} m", large_px, BOLD, WHITE)
    sigma = [Span(f"±{sigma_text(sigma_m)}", small_px, REGULAR, WHITE)] if math.isfinite(distance_m) else []
    lines = [[metres, *sigma, named]]
    measured = (
        (method.letter, float(ranges[method.name].distance_m[row])) for method in methods() if method.name in ranges
    )
    figures = [f"{letter} {distance_text(metres)}" for letter, metres in measured if math.isfinite(metres)]
    if figures:
        lines.append([Span("  ".join(figures), small_px, REGULAR, GREY)])
    closing = closing_span(
        float(result.closing_mps[row]), float(result.ttc_s[row]), small_px, may_hit=result.may_hit(row)
    )
    return [*lines, [closing]] if closing else lines


def closing_span(closing_mps: float, ttc_s: float, size_px: int, *, may_hit: bool = True) -> Span | None:
    """Time to collision and closing speed on a bar, amber or red where urgent; None where the gap does not shrink.

    What does not come at us has no bar: it passes.
    """
    if not closing_mps > CLOSING_SHOWN_MPS:
        return None
    speed = f"closing {closing_mps:.1f} m/s"
    alarm = alarm_colour(ttc_s, may_hit=may_hit)
    text = f"{'TTC' if may_hit else 'passes in'} {ttc_s:.1f} s  {speed}" if ttc_s < TTC_SHOWN_S else speed
    filled = min(1.0, 1 - ttc_s / BAR_S) if may_hit and ttc_s < BAR_S else 0.0
    return Span(text, size_px, REGULAR if alarm is None else BOLD, WHITE, alarm or CALM, filled)


def corner_lines(
    result: FrameResult, size_px: int, *, status: Sequence[str] = (), warning: str = ""
) -> tuple[Lines, Lines]:
    """What the two upper corners say: frame number and time, status, a warning; the legend of letters and strokes."""
    clock = [Span(f"frame {result.frame.index}", size_px, BOLD, WHITE)]
    clock += [Span(text, size_px, REGULAR, WHITE) for text in (f"{result.frame.time_s:.2f} s", *status)]
    if warning:
        clock.append(Span(warning, size_px, BOLD, AMBER))
    letters = [f"{method.letter} {method.title}" for method in methods() if method.name in result.ranges]
    legend = "   ".join(["large: fused ±1 sigma", *letters, "dashed: predicted"])
    return [clock], [[Span(legend, size_px, REGULAR, GREY)]]
