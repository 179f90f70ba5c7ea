"""Look-ahead: what a whole recording tells of its tracks that a live stream could not know yet.

    a track's first boxes     belong to it, once it was confirmed later
    a gap                     lies on the line between the boxes on either side, scores too (observed False)
    a track of few or
    of weak boxes             was a false alarm: fewer than `min_boxes`, or a mean score below what is strong

Identities stay those of the tracker, which saw the frames in their order.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.tracking.tracks import Tracks


@dataclass(frozen=True, slots=True, kw_only=True)
class LookaheadSettings:
    """What is filled in and what is left out.

    Attributes:
        max_gap_s: longer gaps stay open.
        min_boxes: a track needs, unless there are fewer frames.
        min_score_share: of the strong score of its class, which the mean of its scores needs.
    """

    max_gap_s: float = 1.0
    min_boxes: int = 3
    min_score_share: float = 1.0


class Recording:
    """Gathers a tracker's output frame by frame, and completes it at the end."""

    def __init__(self) -> None:
        self._parts: list[tuple[int, Tracks, bool]] = []
        self._time_s: list[float] = []

    def add(self, time_s: float, tracks: Tracks, tentative: Tracks) -> None:
        """One frame's confirmed and tentative tracks."""
        frame = len(self._time_s)
        self._time_s.append(time_s)
        self._parts += [(frame, tracks.select(tracks.observed), True), (frame, tentative, False)]

    def completed(
        self, strong_score: Callable[[IntArray], FloatArray], settings: LookaheadSettings | None = None
    ) -> list[Tracks]:
        """The tracks of every frame.

        Args:
            strong_score: of classes (N,): from which score on boxes are objects, as the tracker has learnt it.
            settings: None = the defaults.
        """
        settings = settings or LookaheadSettings()
        rows = _Rows.of(self._parts)
        time_s = np.array(self._time_s)
        rows = rows.select(rows.are_worth(strong_score, settings, n_frames=len(time_s)))
        return _by_frame(rows.with_gaps_filled(time_s, settings.max_gap_s), len(time_s))


@dataclass(frozen=True, slots=True)
class _Rows:
    """Boxes of all frames, by track and then by frame."""

    frame: IntArray
    tracks: Tracks

    @classmethod
    def of(cls, parts: Sequence[tuple[int, Tracks, bool]]) -> _Rows:
        """All boxes of tracks that were confirmed at some time, each with its track's last label."""
        frame = np.concatenate([np.zeros(0, np.int64), *(np.full(len(each), i) for i, each, _ in parts)])
        everyone = _joined([each for _, each, _ in parts])
        sure = np.concatenate([np.zeros(0, np.bool_), *(np.full(len(each), is_sure) for _, each, is_sure in parts)])
        order = np.lexsort((frame, everyone.track_id))
        order = order[np.isin(everyone.track_id[order], everyone.track_id[sure])]
        rows = cls(frame[order], everyone.select(order))
        track_id = rows.tracks.track_id
        last = np.searchsorted(track_id, track_id, side="right") - 1
        label = rows.tracks.class_id[last] if len(last) else rows.tracks.class_id
        return cls(rows.frame, Tracks(track_id, rows.tracks.xyxy_px, label, rows.tracks.score, rows.tracks.observed))

    def select(self, keep: BoolArray) -> _Rows:
        return _Rows(self.frame[keep], self.tracks.select(keep))

    def are_worth(
        self, strong_score: Callable[[IntArray], FloatArray], settings: LookaheadSettings, *, n_frames: int
    ) -> BoolArray:
        """(N,) which rows belong to tracks of enough boxes and scores."""
        _, place, n = np.unique(self.tracks.track_id, return_inverse=True, return_counts=True)
        mean = np.bincount(place, self.tracks.score, len(n)) / np.maximum(n, 1)
        enough = mean[place] >= settings.min_score_share * strong_score(self.tracks.class_id)
        return np.asarray(enough & (n[place] >= min(settings.min_boxes, n_frames)))

    def with_gaps_filled(self, time_s: FloatArray, max_gap_s: float) -> _Rows:
        """With boxes on the line between a gap's ends, in every frame of it."""
        if len(self.frame) < 2:
            return self
        tracks = self.tracks
        same = tracks.track_id[1:] == tracks.track_id[:-1]
        n_missing = np.where(same, np.diff(self.frame) - 1, 0)
        n_missing[np.diff(time_s[self.frame]) > max_gap_s] = 0
        start = np.repeat(np.arange(len(n_missing)), n_missing)
        nth = np.arange(len(start)) - np.repeat(np.cumsum(n_missing) - n_missing, n_missing) + 1
        frame = self.frame[start] + nth
        begins_s, ends_s = time_s[self.frame[start]], time_s[self.frame[start + 1]]
        share = (time_s[frame] - begins_s) / (ends_s - begins_s)
        boxes = tracks.xyxy_px[start] + share[:, None] * (tracks.xyxy_px[start + 1] - tracks.xyxy_px[start])
        score = tracks.score[start] + share * (tracks.score[start + 1] - tracks.score[start])
        unseen = np.zeros(len(start), np.bool_)
        filled = Tracks(tracks.track_id[start], boxes, tracks.class_id[start], score, unseen)
        return _Rows(np.concatenate([self.frame, frame]), _joined([tracks, filled]))


def _joined(parts: Sequence[Tracks]) -> Tracks:
    parts = [Tracks.empty(), *parts]
    return Tracks(
        np.concatenate([each.track_id for each in parts]),
        np.concatenate([each.xyxy_px for each in parts]),
        np.concatenate([each.class_id for each in parts]),
        np.concatenate([each.score for each in parts]),
        np.concatenate([each.observed for each in parts]),
    )


def _by_frame(rows: _Rows, n_frames: int) -> list[Tracks]:
    """The rows of each frame, by id."""
    order = np.lexsort((rows.tracks.track_id, rows.frame))
    tracks = rows.tracks.select(order)
    ends = np.searchsorted(rows.frame[order], np.arange(n_frames + 1))
    return [tracks.select(np.arange(begin, end)) for begin, end in itertools.pairwise(ends)]
