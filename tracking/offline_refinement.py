"""Offline refinement: tracks of a whole recording, corrected with the information of later frames.

    tentative boxes    of tracks confirmed later are added as their first boxes
    gaps               are filled by linear interpolation of boxes and scores (observed False)
    false tracks       are dropped: fewer than `min_boxes` boxes, or a mean score below the track-activation threshold

Identities do not change.
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
    """Limits of interpolation and of dropping tracks."""

    max_gap_s: float = 1.0  # longest gap that is interpolated
    min_boxes: int = 3  # minimum number of boxes of a track; fewer are enough in a recording with fewer frames
    min_score_fraction: float = 1.0  # minimum mean score of a track / its activation threshold


ActivationThreshold = Callable[[IntArray], FloatArray]
"""Track-activation thresholds (N,) of classes (N,), see `track_range.tracking.tracker.RefinableTracker`."""


class OfflineRefinement:
    """Collects the output of a tracker frame by frame and refines it at the end."""

    def __init__(self) -> None:
        self._parts: list[tuple[int, Tracks, bool]] = []
        self._time_s: list[float] = []

    def add(self, time_s: float, tracks: Tracks, tentative: Tracks) -> None:
        """Add the confirmed and tentative tracks of the next frame."""
        frame = len(self._time_s)
        self._time_s.append(time_s)
        self._parts += [(frame, tracks.select(tracks.observed), True), (frame, tentative, False)]

    def refine(self, threshold: ActivationThreshold | None, settings: RefinementSettings | None = None) -> list[Tracks]:
        """The refined tracks of every frame, by id; without a threshold, no track is dropped for its scores."""
        settings = settings or RefinementSettings()
        rows = _Rows.of(self._parts)
        time_s = np.array(self._time_s)
        rows = rows.select(rows.are_reliable(threshold, settings, n_frames=len(time_s)))
        return _by_frame(rows.with_gaps_interpolated(time_s, settings.max_gap_s), len(time_s))


@dataclass(frozen=True, slots=True)
class _Rows:
    """Boxes of all frames, sorted by track, then by frame."""

    frame: IntArray  # (N,) frame numbers from 0
    tracks: Tracks  # N boxes with their identities

    @classmethod
    def of(cls, parts: Sequence[tuple[int, Tracks, bool]]) -> _Rows:
        """All boxes of tracks that were confirmed at some time, from (frame, tracks, whether they are confirmed).

        Every box gets the last class of its track.
        """
        frame = np.concatenate([np.zeros(0, np.int64), *(np.full(len(tracks), i) for i, tracks, _ in parts)])
        tracks = _concatenated([tracks for _, tracks, _ in parts])
        is_confirmed = np.concatenate(
            [np.zeros(0, np.bool_), *(np.full(len(tracks), is_confirmed) for _, tracks, is_confirmed in parts)]
        )
        order = np.lexsort((frame, tracks.track_id))
        order = order[np.isin(tracks.track_id[order], tracks.track_id[is_confirmed])]
        rows = cls(frame[order], tracks.select(order))
        track_id = rows.tracks.track_id
        last = np.searchsorted(track_id, track_id, side="right") - 1
        class_id = rows.tracks.class_id[last] if len(last) else rows.tracks.class_id
        return cls(rows.frame, Tracks(track_id, rows.tracks.xyxy_px, class_id, rows.tracks.score, rows.tracks.observed))

    def select(self, rows: BoolArray) -> _Rows:
        return _Rows(self.frame[rows], self.tracks.select(rows))

    def are_reliable(
        self, threshold: ActivationThreshold | None, settings: RefinementSettings, *, n_frames: int
    ) -> BoolArray:
        """(N,) whether a box belongs to a track with enough boxes and a sufficient mean score."""
        _, track, n_boxes = np.unique(self.tracks.track_id, return_inverse=True, return_counts=True)
        is_reliable = np.asarray(n_boxes[track] >= min(settings.min_boxes, n_frames))
        if threshold is not None:
            mean_score = np.bincount(track, self.tracks.score, len(n_boxes)) / np.maximum(n_boxes, 1)
            is_reliable &= mean_score[track] >= settings.min_score_fraction * threshold(self.tracks.class_id)
        return is_reliable

    def with_gaps_interpolated(self, time_s: FloatArray, max_gap_s: float) -> _Rows:
        """The boxes, and interpolated ones in every frame of each gap of at most `max_gap_s`."""
        if len(self.frame) < 2:
            return self
        tracks = self.tracks
        is_same_track = tracks.track_id[1:] == tracks.track_id[:-1]
        n_missing = np.where(is_same_track, np.diff(self.frame) - 1, 0)
        n_missing[np.diff(time_s[self.frame]) > max_gap_s] = 0
        start = np.repeat(np.arange(len(n_missing)), n_missing)
        nth = np.arange(len(start)) - np.repeat(np.cumsum(n_missing) - n_missing, n_missing) + 1
        frame = self.frame[start] + nth
        start_s, end_s = time_s[self.frame[start]], time_s[self.frame[start + 1]]
        fraction = (time_s[frame] - start_s) / (end_s - start_s)
        boxes = tracks.xyxy_px[start] + fraction[:, None] * (tracks.xyxy_px[start + 1] - tracks.xyxy_px[start])
        score = tracks.score[start] + fraction * (tracks.score[start + 1] - tracks.score[start])
        observed = np.zeros(len(start), np.bool_)
        interpolated = Tracks(tracks.track_id[start], boxes, tracks.class_id[start], score, observed)
        return _Rows(np.concatenate([self.frame, frame]), _concatenated([tracks, interpolated]))


def _concatenated(parts: Sequence[Tracks]) -> Tracks:
    parts = [Tracks.empty(), *parts]
    return Tracks(
        np.concatenate([tracks.track_id for tracks in parts]),
        np.concatenate([tracks.xyxy_px for tracks in parts]),
        np.concatenate([tracks.class_id for tracks in parts]),
        np.concatenate([tracks.score for tracks in parts]),
        np.concatenate([tracks.observed for tracks in parts]),
    )


def _by_frame(rows: _Rows, n_frames: int) -> list[Tracks]:
    """The tracks of each frame, by id."""
    order = np.lexsort((rows.tracks.track_id, rows.frame))
    tracks = rows.tracks.select(order)
    ends = np.searchsorted(rows.frame[order], np.arange(n_frames + 1))
    return [tracks.select(np.arange(begin, end)) for begin, end in itertools.pairwise(ends)]
