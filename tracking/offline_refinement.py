"""Offline refinement: tracks of a whole recording, corrected with the information of later frames.

    tentative boxes    of tracks confirmed later are added as their first boxes
    gaps               are filled by linear interpolation of boxes and scores (observed False)
    false tracks       are dropped: fewer than `min_boxes` boxes, or a mean score below the track-activation threshold

Identities do not change.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.tracking.tracks import Tracks


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinementSettings:
    """Limits of interpolation and of dropping tracks."""

    max_gap_s: float = 1.0  # longest gap that is interpolated
    # minimum number of boxes of a track; fewer are enough in a recording with fewer frames
    min_boxes: int = 3
    min_score_fraction: float = 1.0  # minimum mean score of a track / its activation threshold


# of (N,) classes, see `registry.RefinableTracker`
ActivationThreshold = Callable[[IntArray], FloatArray]


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

    def refine(
        self, threshold: ActivationThreshold | None, settings: RefinementSettings | None = None
    ) -> list[Tracks]:
        """The refined tracks of every frame, by id; without a threshold, no track is dropped for
        its scores.
        """
        settings, time_s = settings or RefinementSettings(), np.array(self._time_s)

        # Boxes of all tracks that were confirmed at some time, sorted by track, then by frame.
        frame = np.concatenate(
            [np.zeros(0, np.int64), *(np.full(len(tracks), k) for k, tracks, _ in self._parts)]
        )
        tracks = _concatenated([tracks for _, tracks, _ in self._parts])
        confirmed_id = _concatenated(
            [tracks for _, tracks, is_confirmed in self._parts if is_confirmed]
        ).track_id
        order = np.lexsort((frame, tracks.track_id))
        order = order[np.isin(tracks.track_id[order], confirmed_id)]
        frame, tracks = frame[order], tracks.select(order)
        if len(frame):  # every box gets the last class of its track
            last = np.searchsorted(tracks.track_id, tracks.track_id, side="right") - 1
            tracks = replace(tracks, class_id=tracks.class_id[last])

        # Tracks with enough boxes and a sufficient mean score.
        _, track, n_boxes = np.unique(tracks.track_id, return_inverse=True, return_counts=True)
        is_reliable = np.asarray(n_boxes[track] >= min(settings.min_boxes, len(time_s)))
        if threshold is not None:
            mean_score = np.bincount(track, tracks.score, len(n_boxes)) / np.maximum(n_boxes, 1)
            is_reliable &= mean_score[track] >= settings.min_score_fraction * threshold(
                tracks.class_id
            )
        frame, tracks = frame[is_reliable], tracks.select(is_reliable)

        if len(frame) > 1:
            added_frame, added = _interpolated(frame, tracks, time_s, settings.max_gap_s)
            frame, tracks = np.concatenate([frame, added_frame]), _concatenated([tracks, added])
        order = np.lexsort((tracks.track_id, frame))
        ends = np.searchsorted(frame[order], np.arange(len(time_s) + 1))
        return [tracks.select(order[begin:end]) for begin, end in itertools.pairwise(ends)]


def _interpolated(
    frame: IntArray, tracks: Tracks, time_s: FloatArray, max_gap_s: float
) -> tuple[IntArray, Tracks]:
    """Frames and interpolated boxes of each gap of at most `max_gap_s`, of boxes sorted by track,
    then by frame.
    """
    n_missing = np.where(tracks.track_id[1:] == tracks.track_id[:-1], np.diff(frame) - 1, 0)
    n_missing[np.diff(time_s[frame]) > max_gap_s] = 0
    start = np.repeat(np.arange(len(n_missing)), n_missing)
    nth = np.arange(len(start)) - np.repeat(np.cumsum(n_missing) - n_missing, n_missing) + 1
    added_frame = frame[start] + nth
    start_s, end_s = time_s[frame[start]], time_s[frame[start + 1]]
    fraction = (time_s[added_frame] - start_s) / (end_s - start_s)
    boxes = tracks.xyxy_px[start] + fraction[:, None] * (
        tracks.xyxy_px[start + 1] - tracks.xyxy_px[start]
    )
    score = tracks.score[start] + fraction * (tracks.score[start + 1] - tracks.score[start])
    observed = np.zeros(len(start), np.bool_)
    return added_frame, Tracks(
        tracks.track_id[start], boxes, tracks.class_id[start], score, observed
    )


def _concatenated(parts: Sequence[Tracks]) -> Tracks:
    parts = [Tracks.empty(), *parts]
    columns = ([getattr(tracks, name) for tracks in parts] for name in Tracks.__slots__)
    return Tracks(*map(np.concatenate, columns))
