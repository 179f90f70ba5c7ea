"""Offline refinement: tracks of a whole recording, corrected by what later frames show.

    tentative boxes           of a track that was confirmed later are its first boxes
    gaps                      are interpolated linearly between the boxes on either side, scores too (observed False)
    false tracks              are dropped: fewer than `min_boxes` boxes, or a mean score below the track-activation
                              threshold

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
class RefinementSettings:
    """What is interpolated and what is dropped.

    Attributes:
        max_gap_s: longest gap that is interpolated.
        min_boxes: fewest boxes of a track, unless there are fewer frames.
        min_score_share: least mean score of a track, as a share of its class's track-activation threshold.
    """

    max_gap_s: float = 1.0
    min_boxes: int = 3
    min_score_share: float = 1.0


ActivationThreshold = Callable[[IntArray], FloatArray]
"""Track-activation threshold (N,) of classes (N,): see `track_range.tracking.tracker.RefinableTracker`."""


class OfflineRefinement:
    """Gathers a tracker's output frame by frame, and refines it at the end."""

    def __init__(self) -> None:
        self._parts: list[tuple[int, Tracks, bool]] = []
        self._time_s: list[float] = []

    def add(self, time_s: float, tracks: Tracks, tentative: Tracks) -> None:
        """One frame's confirmed and tentative tracks."""
        frame = len(self._time_s)
        self._time_s.append(time_s)
        self._parts += [(frame, tracks.select(tracks.observed), True), (frame, tentative, False)]

    def refine(self, threshold: ActivationThreshold | None, settings: RefinementSettings | None = None) -> list[Tracks]:
        """The refined tracks of every frame, by id.

        Args:
            threshold: what the tracker has estimated; None = no track is dropped for its scores.
            settings: None = the defaults.
        """
        settings = settings or RefinementSettings()
        rows = _Rows.of(self._parts)
        time_s = np.array(self._time_s)
        rows = rows.select(rows.are_reliable(threshold, settings, n_frames=len(time_s)))
        return _by_frame(rows.with_gaps_interpolated(time_s, settings.max_gap_s), len(time_s))


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

    def are_reliable(
        self, threshold: ActivationThreshold | None, settings: RefinementSettings, *, n_frames: int
    ) -> BoolArray:
        """(N,) which rows belong to tracks with enough boxes and high enough scores."""
        _, track, n_boxes = np.unique(self.tracks.track_id, return_inverse=True, return_counts=True)
        is_reliable = np.asarray(n_boxes[track] >= min(settings.min_boxes, n_frames))
        if threshold is not None:
            mean_score = np.bincount(track, self.tracks.score, len(n_boxes)) / np.maximum(n_boxes, 1)
            is_reliable &= mean_score[track] >= settings.min_score_share * threshold(self.tracks.class_id)
        return is_reliable

    def with_gaps_interpolated(self, time_s: FloatArray, max_gap_s: float) -> _Rows:
        """With interpolated boxes in every frame of each gap of at most `max_gap_s`."""
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
