"""turning_spans: the parts of a long recording with the largest turns, from a few small images.

Between two images the upper half, which shows little of the road, is shifted by about f times the
yaw: phase correlation (Kuglin and Hines, 1975) measures shifts of up to half of the image. The
expansion of the image while the camera drives straight ahead is symmetric and shifts nothing. Images
that are farther apart differ too much: between them the camera turns as before and after.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.stereo.geometry.frames import grey

# of the small images; focal length of a usual road camera, 0.8 image widths
_WIDTH_PX, _FOCAL_PX = 160, 128.0
_UPPER = 0.6  # fraction of the rows, from the top
# longest time between two images that are compared, and in which the rate is interpolated
_MAX_GAP_S, _MAX_UNSEEN_S = 0.6, 1.3
_MIN_RESPONSE = 0.03  # of the phase correlation; smaller ones are chance


class TurningSpan(NamedTuple):
    """A part of a recording, and its change of heading at the assumed focal length."""

    start_s: float
    end_s: float
    turn_deg: float


def turning_spans(
    images: Iterable[tuple[float, Image]],
    *,
    span_s: float = 10.0,
    min_turn_deg: float = 5.0,
) -> tuple[TurningSpan, ...]:
    """At most two spans of at most `span_s` seconds that do not overlap, the largest turn first.

    `images` are times and images (H, W) or (H, W, 3) of any size, 2 to 10 per second, or two of
    these each second.
    """
    times_s, heading_rad = _headings(images)
    spans = list[TurningSpan]()
    is_free = np.ones(len(times_s), np.bool_)
    while len(spans) < 2:
        best = max(
            (_turn(times_s, heading_rad, first, span_s, is_free) for first in range(len(times_s))),
            key=lambda span: span.turn_deg,
            default=None,
        )
        if best is None or best.turn_deg < min_turn_deg:
            break
        spans.append(best)
        is_free &= (times_s < best.start_s) | (times_s > best.end_s)
    return tuple(spans)


def _headings(images: Iterable[tuple[float, Image]]) -> tuple[FloatArray, FloatArray]:
    """(N,) times, and (N,) sums of the yaw since the first image, rad."""
    times_s, rates, before = list[float](), list[float](), None
    for time_s, image in images:
        small = _small(image)
        if before is not None:
            gap_s = time_s - times_s[-1]
            is_near = gap_s <= _MAX_GAP_S and before.shape == small.shape
            rates.append(_yaw_rad(before, small) / gap_s if is_near else math.nan)
        before = small
        times_s.append(time_s)
    return np.array(times_s), _integrated(np.array(times_s), np.array(rates))


def _yaw_rad(before: FloatArray, now: FloatArray) -> float:
    """The yaw between two small images; 0 where they have nothing in common."""
    window = cv2.createHanningWindow(now.shape[::-1], cv2.CV_32F)
    (shift_px, _), response = cv2.phaseCorrelate(before, now, window)
    if response <= _MIN_RESPONSE:
        return 0.0
    return -math.atan(shift_px / _FOCAL_PX)


def _integrated(times_s: FloatArray, rate: FloatArray) -> FloatArray:
    """(N,) sums of the yaw by its rates (N - 1,) between the times (N,); NaN = not seen."""
    is_seen = np.isfinite(rate)
    if not is_seen.any():
        return np.zeros(len(times_s))
    number, steps_s = np.arange(len(rate)), np.diff(times_s)
    yaw_rad = np.interp(number, number[is_seen], rate[is_seen]) * steps_s
    yaw_rad[steps_s > _MAX_UNSEEN_S] = 0.0
    return np.concatenate([[0.0], np.cumsum(yaw_rad)])


def _small(image: Image) -> FloatArray:
    upper = grey(image[: round(_UPPER * image.shape[0])])
    height_px = max(8, round(upper.shape[0] * _WIDTH_PX / upper.shape[1]))
    small = cv2.resize(upper, (_WIDTH_PX, height_px), interpolation=cv2.INTER_AREA)
    return small.astype(np.float32)


def _turn(
    times_s: FloatArray, heading_rad: FloatArray, first: int, span_s: float, is_free: np.ndarray
) -> TurningSpan:
    """The span that begins with an image, with its range of headings; as long as it is free."""
    is_inside = (times_s >= times_s[first]) & (times_s <= times_s[first] + span_s)
    rows = np.flatnonzero(is_inside)
    if not is_free[rows].all():
        return TurningSpan(times_s[first], times_s[first], 0.0)
    turn_rad = float(np.ptp(heading_rad[rows]))
    return TurningSpan(float(times_s[rows[0]]), float(times_s[rows[-1]]), math.degrees(turn_rad))
