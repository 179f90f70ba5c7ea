"""History: the last detected boxes of every track, and the prediction of a missing box from their
median step.

The paper stores the boxes of each identity in a buffer, takes l, the median of the last k, and
predicts a missing box after two frames in a row by

    l(t) = l(t-1) + (l(t-1) - l(t-2))               "step-of-medians", which lags by half the buffer

(Guo Pengyu, binocular detection, tracking and ranging of vehicles, eq. 1-2). The default here uses
real times and the median of the last k steps, which is equally robust to one bad box but does not
lag:

    l(t) = l(t') + (t - t') median_i((l_i - l_(i-1)) / (t_i - t_(i-1)))      t': time of the last detection

and only where `PredictionGates` allow it; docs/concepts/accuracy.md has the effect of k, of the form and
of the gates. Two gates may surprise. An occluded box is predicted after fewer detections than a
visible one: occlusion explains why it is missing, while a visible one was most often a false alarm
or has left. Boxes near the image border are not predicted, which matters most: leaving the image is
the most frequent reason for a missing box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from track_range.detection.boxes import are_valid_boxes
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, row_numbers

# form of the prediction: the second or the first equation above
Form = Literal["median-of-steps", "step-of-medians"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictionGates:
    """Conditions for the prediction of a missing box, checked in each frame.

    The occlusion of a box is the largest fraction of its area inside one nearer box; a lower bottom
    edge means nearer.
    """

    form: Form = "median-of-steps"  # form of the prediction
    n_kept: int = 6  # boxes stored per track: k + 1, for k steps or two medians of k; at least 2
    max_missing_s: float = 0.25  # longest time since the last detection; 0 = no prediction
    # minimum number of successive frames with a detection, up to the last one; at least 2
    min_hit_streak: int = 5
    min_hit_streak_visible: int = 15  # the same for a box with an occlusion below `min_occlusion`
    min_occlusion: float = 0.3  # occlusion that explains a missing box, as a fraction of its area
    # largest median deviation of the steps over the missing time, in heights of the box
    max_deviation: float = 0.1
    min_margin: float = 0.05  # minimum distance from the image border, in heights of the box

    def __post_init__(self) -> None:
        if min(self.min_hit_streak, self.n_kept) < 2:
            raise ValueError(
                "min_hit_streak, n_kept: expected at least 2, got "
                f"{self.min_hit_streak}, {self.n_kept}"
            )
        if self.form not in get_args(Form):
            raise ValueError(f"form: expected {' or '.join(get_args(Form))}, got {self.form}")


@dataclass(frozen=True, slots=True)
class BoxHistory:
    """The last K detected boxes of N tracks, newest last; empty slots are NaN."""

    # (N, K, 5) left, top, right and bottom edge in px, and time in s: one array, since they change
    # together
    boxes: FloatArray
    hit_streak: IntArray  # (N,) number of successive frames with a detection, up to the newest box

    def __len__(self) -> int:
        return len(self.hit_streak)

    @property
    def xyxy_px(self) -> FloatArray:
        """(N, K, 4) boxes."""
        return self.boxes[:, :, :4]

    @property
    def time_s(self) -> FloatArray:
        """(N, K) times of the boxes."""
        return self.boxes[:, :, 4]

    @property
    def last_xyxy_px(self) -> FloatArray:
        """(N, 4) last detected box of each track."""
        return self.boxes[:, -1, :4]

    @property
    def last_s(self) -> FloatArray:
        """(N,) time of the last detection of each track."""
        return self.boxes[:, -1, 4]

    def select(self, rows: BoolArray | IntArray) -> BoxHistory:
        """The tracks that a mask or an index array selects, in its order."""
        rows = row_numbers(rows, len(self.boxes))
        return BoxHistory(self.boxes.take(rows, axis=0), self.hit_streak.take(rows))

    def concatenate(self, other: BoxHistory) -> BoxHistory:
        """The tracks of both histories, `other`'s last; both have the same number of slots."""
        return BoxHistory(
            np.concatenate([self.boxes, other.boxes]),
            np.concatenate([self.hit_streak, other.hit_streak]),
        )

    def append(
        self, rows: IntArray, xyxy_px: FloatArray, time_s: float, *, is_streak: BoolArray
    ) -> None:
        """Append the detected boxes (M, 4) of M different tracks, in place; the oldest boxes are
        dropped.

        `is_streak` (M,) is whether a track was also detected in the previous frame.
        """
        boxes = self.boxes.take(rows, axis=0)
        boxes[:, :-1] = boxes[:, 1:]
        boxes[:, -1, :4], boxes[:, -1, 4] = xyxy_px, time_s
        self.boxes[rows] = boxes
        self.hit_streak[rows] = 1 + self.hit_streak[rows] * is_streak


def initiate(xyxy_px: FloatArray, time_s: float, *, n_kept: int) -> BoxHistory:
    """Histories of N tracks first detected at `time_s` with the boxes (N, 4); `n_kept` is K."""
    boxes = np.full((len(xyxy_px), n_kept, 5), np.nan)
    boxes[:, -1, :4], boxes[:, -1, 4] = xyxy_px, time_s
    return BoxHistory(boxes, np.ones(len(xyxy_px), np.int64))


def smoothed(history: BoxHistory) -> FloatArray:
    """(N, 4) l in Guo's equations: median of the boxes of each track, without the oldest slot."""
    return _median(history.xyxy_px[:, 1:], _n_known(history.boxes[:, 1:, 0]))


def median_prediction(
    history: BoxHistory, time_s: float, *, form: Form = "median-of-steps"
) -> tuple[FloatArray, FloatArray]:
    """Boxes (N, 4) at `time_s`, and (N,) the median deviation of the steps times the missing time,
    in box heights.

    Both are NaN for tracks that were detected only once.
    """
    last, missing_s = history.last_xyxy_px, time_s - history.last_s
    steps = history.boxes[:, 1:] - history.boxes[:, :-1]
    rates, n_rates = steps[:, :, :4] / steps[:, :, 4:], _n_known(steps[:, :, 4])
    if form == "median-of-steps":
        start, rate = last, _median(rates, n_rates)
    else:
        now = _median(history.boxes[:, 1:], _n_known(history.time_s[:, 1:]))
        step = now - _median(history.boxes[:, :-1], n_rates)
        start, rate = now[:, :4], step[:, :4] / step[:, 4:]
    deviation = _median(np.abs(rates - rate[:, None]), n_rates).max(axis=1)
    return start + missing_s[:, None] * rate, missing_s * deviation / (last[:, 3] - last[:, 1])


def predict_missing(
    history: BoxHistory,
    time_s: float,
    *,
    gates: PredictionGates,
    border_xyxy_px: FloatArray | None = None,
    others_xyxy_px: FloatArray | None = None,
) -> tuple[IntArray, FloatArray]:
    """Row numbers (M,) of the N missing tracks that can be predicted at `time_s`, and their boxes
    (M, 4).

    The border (4,) has the outer edges of the image, or of all boxes so far; without it, boxes that
    leave the image are predicted for a while. `others_xyxy_px` (K, 4) are detected boxes of this
    frame, which may occlude a missing box.
    """
    is_recent = time_s - history.last_s <= gates.max_missing_s
    rows = (is_recent & (history.hit_streak >= gates.min_hit_streak)).nonzero()[0]
    if len(rows) == 0:
        return rows, np.zeros((0, 4))
    boxes, deviation = median_prediction(history.select(rows), time_s, form=gates.form)
    is_likely = (deviation <= gates.max_deviation) & are_valid_boxes(boxes)
    if border_xyxy_px is not None:
        margin_px = gates.min_margin * (boxes[:, 3:] - boxes[:, 1:2])
        is_inside = boxes[:, :2] - margin_px > border_xyxy_px[:2]
        is_inside &= boxes[:, 2:] + margin_px < border_xyxy_px[2:]
        is_likely &= is_inside.all(axis=1)
    is_new = history.hit_streak[rows] < gates.min_hit_streak_visible
    new = (is_likely & is_new).nonzero()[0]
    if len(new):
        occlusion = (
            np.zeros(len(new))
            if others_xyxy_px is None
            else occluded_fraction(boxes[new], others_xyxy_px)
        )
        is_likely[new] = occlusion >= gates.min_occlusion
    return rows[is_likely], boxes[is_likely]


def occluded_fraction(xyxy_px: FloatArray, others_xyxy_px: FloatArray) -> FloatArray:
    """(N,) largest fraction of the area of each valid box (N, 4) inside one nearer box of (M,
    4).
    """
    # contiguous columns: a fifth of the time
    left, top, right, bottom = np.ascontiguousarray(xyxy_px.T)[:, :, None]
    other_left, other_top, other_right, other_bottom = np.ascontiguousarray(others_xyxy_px.T)
    width = np.minimum(right, other_right) - np.maximum(left, other_left)
    height = bottom - np.maximum(top, other_top)  # the bottom edge of a nearer box is lower
    shared = np.where((other_bottom > bottom) & (height > 0), width * height, 0.0).max(
        axis=1, initial=0.0
    )
    return np.asarray(shared / ((right - left) * (bottom - top))[:, 0])


def _n_known(values: FloatArray) -> IntArray:
    """(N,) number of values (N, K) that are not NaN."""
    return np.asarray(np.isfinite(values).sum(axis=1))


def _median(values: FloatArray, n: IntArray) -> FloatArray:
    """(N, K, C) -> (N, C) median over K of the n (N,) values of each row that are not NaN; NaN
    where n is 0.
    """
    ordered = np.sort(values, axis=1)  # NaN sorts last; numpy's nanmedian loops over rows and warns
    row = np.arange(len(n))
    return np.asarray((ordered[row, np.maximum(n - 1, 0) // 2] + ordered[row, n // 2]) / 2)
