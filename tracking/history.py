"""History: the last boxes of every track, and the median label prediction of a box that is missing.

The paper keeps the labels of each identity in a buffer, takes l, the median of the last k, and predicts a missing one,
once the identity was seen in two frames in a row, by

    l(t) = l(t-1) + (l(t-1) - l(t-2))               "step-of-medians", which lags by half the buffer

(Guo Pengyu, binocular detection, tracking and ranging of vehicles, eq. 1-2). Here, with real times and the median taken
of the last k steps, which forgives one bad box just so but does not lag:

    l(t) = l(t') + (t - t') median_i((l_i - l_(i-1)) / (t_i - t_(i-1)))      t': when the track was last seen

and only where the gates of `FillGates` let it. What they are worth, by k, form and gate: benchmarks/README.md. Two of
them are not what one would expect. A box that a nearer one hides is predicted sooner than one in plain sight: the one
has a reason to be missing, the other most often was a false alarm, or has left. And the border keeps a distance, which
matters more than anything else: what leaves the image is the commonest reason why a box is missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from track_range.detection.boxes import are_sound
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

Form = Literal["median-of-steps", "step-of-medians"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FillGates:
    """When a missing box is predicted, each frame anew.

    A box is hidden as far as its area lies in one nearer box, which is one whose lower edge is lower in the image.

    Attributes:
        form: of the prediction.
        n_kept: boxes kept per track: k + 1, for k steps and two medians of k; at least 2.
        max_missing_s: seconds since the track was last seen; 0 turns prediction off.
        min_running: frames in a row in which the track was seen, up to the last time; at least 2.
        min_running_in_sight: the same where less than `min_cover` of the box is hidden, so that nothing explains why
            it is missing.
        min_cover: share of the box.
        max_spread: median deviation of the steps, carried over the missing time, in heights of the box.
        min_margin: distance from the image's border, in heights of the box: what is nearer is leaving.
    """

    form: Form = "median-of-steps"
    n_kept: int = 6
    max_missing_s: float = 0.25
    min_running: int = 5
    min_running_in_sight: int = 15
    min_cover: float = 0.3
    max_spread: float = 0.1
    min_margin: float = 0.05

    def __post_init__(self) -> None:
        if min(self.min_running, self.n_kept) < 2:
            raise ValueError(f"min_running and n_kept: at least 2 wanted, {self.min_running}, {self.n_kept} got")
        if self.form not in get_args(Form):
            raise ValueError(f"form: {' or '.join(get_args(Form))} wanted, {self.form} got")


@dataclass(frozen=True, slots=True)
class BoxHistory:
    """The last K boxes seen of N tracks, newest last; slots not filled yet are NaN.

    Attributes:
        xyxy_px: (N, K, 4).
        time_s: (N, K).
        n_running: (N,) frames in a row in which the track was seen, up to the newest box.
    """

    xyxy_px: FloatArray
    time_s: FloatArray
    n_running: IntArray

    def __len__(self) -> int:
        return len(self.n_running)

    @property
    def last_xyxy_px(self) -> FloatArray:
        """(N, 4) each track's box when it was last seen."""
        return self.xyxy_px[:, -1]

    @property
    def last_s(self) -> FloatArray:
        """(N,) when each track was last seen."""
        return self.time_s[:, -1]

    def select(self, keep: BoolArray | IntArray) -> BoxHistory:
        """The rows that a mask or an index array names, in its order."""
        return BoxHistory(self.xyxy_px[keep], self.time_s[keep], self.n_running[keep])

    def joined(self, other: BoxHistory) -> BoxHistory:
        """These rows, then the other's; both keep the same number of boxes."""
        return BoxHistory(
            np.concatenate([self.xyxy_px, other.xyxy_px]),
            np.concatenate([self.time_s, other.time_s]),
            np.concatenate([self.n_running, other.n_running]),
        )

    def see(self, rows: IntArray, xyxy_px: FloatArray, time_s: float, *, are_running: BoolArray) -> None:
        """Write the boxes (M, 4) of M tracks into their rows, in place of the oldest.

        Args:
            rows: (M,) no track twice.
            xyxy_px: as they were seen.
            time_s: when.
            are_running: (M,) which of them were seen in the frame before, too.
        """
        self.xyxy_px[rows, :-1], self.time_s[rows, :-1] = self.xyxy_px[rows, 1:], self.time_s[rows, 1:]
        self.xyxy_px[rows, -1], self.time_s[rows, -1] = xyxy_px, time_s
        self.n_running[rows] = np.where(are_running, self.n_running[rows] + 1, 1)


def begun(xyxy_px: FloatArray, time_s: float, *, n_kept: int) -> BoxHistory:
    """Histories of tracks first seen at `time_s` as (N, 4)."""
    n = len(xyxy_px)
    boxes, times = np.full((n, n_kept, 4), np.nan), np.full((n, n_kept), np.nan)
    boxes[:, -1], times[:, -1] = xyxy_px, time_s
    return BoxHistory(boxes, times, np.ones(n, np.int64))


def smoothed(history: BoxHistory) -> FloatArray:
    """The paper's label: (N, 4) median of each track's newest boxes, all that are kept but the oldest."""
    return _median_of_known(history.xyxy_px[:, 1:])


def median_prediction(
    history: BoxHistory, time_s: float, *, form: Form = "median-of-steps"
) -> tuple[FloatArray, FloatArray]:
    """Boxes (N, 4) at `time_s`, and (N,) how far the steps scatter over the missing time, in heights of the box.

    NaN for a track that was seen only once.
    """
    missing_s = time_s - history.last_s
    rates = np.diff(history.xyxy_px, axis=1) / np.diff(history.time_s, axis=1)[:, :, None]
    last = history.last_xyxy_px
    if form == "median-of-steps":
        start, rate = last, _median_of_known(rates)
    else:
        start = smoothed(history)
        times_s = history.time_s[:, :, None]
        step_s = _median_of_known(times_s[:, 1:]) - _median_of_known(times_s[:, :-1])
        rate = (start - _median_of_known(history.xyxy_px[:, :-1])) / step_s
    deviation = _median_of_known(np.abs(rates - rate[:, None])).max(axis=1, initial=0.0)
    return start + missing_s[:, None] * rate, missing_s * deviation / (last[:, 3] - last[:, 1])


def filled(
    history: BoxHistory,
    time_s: float,
    *,
    gates: FillGates,
    border_xyxy_px: FloatArray | None = None,
    others_xyxy_px: FloatArray | None = None,
) -> tuple[IntArray, FloatArray]:
    """Which of N missing tracks are predicted at `time_s`, as M row numbers, and their boxes (M, 4).

    Args:
        history: of the missing tracks.
        time_s: now.
        gates: what is let through.
        border_xyxy_px: (4,) the image's outer edges, or the extent of all boxes seen so far; None = not known,
            so that boxes that leave are predicted for a while.
        others_xyxy_px: (K, 4) boxes seen now, which may hide a missing one; None = none.
    """
    young = time_s - history.last_s <= gates.max_missing_s
    rows = np.flatnonzero(young & (history.n_running >= gates.min_running))
    if len(rows) == 0:
        return rows, np.zeros((0, 4))
    boxes, spread = median_prediction(history.select(rows), time_s, form=gates.form)
    good = (spread <= gates.max_spread) & are_sound(boxes)
    if border_xyxy_px is not None:
        margin_px = gates.min_margin * (boxes[:, 3:] - boxes[:, 1:2])
        good &= (boxes[:, :2] - margin_px > border_xyxy_px[:2]).all(axis=1)
        good &= (boxes[:, 2:] + margin_px < border_xyxy_px[2:]).all(axis=1)
    rows, boxes = rows[good], boxes[good]
    cover = np.zeros(len(rows)) if others_xyxy_px is None else hidden_share(boxes, others_xyxy_px)
    is_explained = (cover >= gates.min_cover) | (history.n_running[rows] >= gates.min_running_in_sight)
    return rows[is_explained], boxes[is_explained]


def hidden_share(xyxy_px: FloatArray, others_xyxy_px: FloatArray) -> FloatArray:
    """(N,) the largest share of each sound box (N, 4) that lies in one nearer box of (M, 4), itself left out."""
    left, top, right, bottom = np.ascontiguousarray(xyxy_px.T)[:, :, None]  # column by column: a fifth of the time
    other_left, other_top, other_right, other_bottom = np.ascontiguousarray(others_xyxy_px.T)
    width = np.minimum(right, other_right) - np.maximum(left, other_left)
    height = bottom - np.maximum(top, other_top)  # the lower edge of a nearer box lies below
    shared = np.where((other_bottom > bottom) & (height > 0), width * height, 0.0).max(axis=1, initial=0.0)
    return np.asarray(shared / ((right - left) * (bottom - top))[:, 0])


def _median_of_known(values: FloatArray) -> FloatArray:
    """(N, K, C) -> (N, C) median over K of what is not NaN; NaN where nothing is known."""
    ordered = np.sort(values, axis=1)  # NaN goes last; numpy's nanmedian loops over rows and warns
    n_known = np.isfinite(values).sum(axis=1, keepdims=True)
    low = np.take_along_axis(ordered, np.maximum(n_known - 1, 0) // 2, axis=1)
    high = np.take_along_axis(ordered, n_known // 2, axis=1)
    return np.asarray((low + high)[:, 0] / 2)
