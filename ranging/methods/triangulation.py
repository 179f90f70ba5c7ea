"""Triangulation: Z = f B / d from the disparity d of a track's box.

    sigma_Z = Z^2 / (f B) sigma_d: the error grows with the square of the distance.
(Guo, the binocular paper's eq. 5-6, which takes the disparity at the box's centre.)
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.ranges import Ranges
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matches import BoxMatcher, Outcome
from track_range.tracking.tracks import Tracks

_PRIOR_LIFETIME_S = 1.0  # after this long without a match a track is searched over the full range again
_FULL_RANGE_EVERY_S = 1.0  # and this often in any case, so that a track that followed an occluder is set free


@dataclass(frozen=True, slots=True)
class Triangulation:
    """From measured disparities to metres.

    Attributes:
        rig: the rectified pair.
        alignment: what is wrong with its disparities.
    """

    rig: StereoRig
    alignment: Alignment

    def ranges(self, tracks: Tracks, disparity_px: FloatArray, sigma_px: FloatArray) -> Ranges:
        """Distances of the tracks from their (N,) disparities and standard deviations; NaN where not positive."""
        x_px = (tracks.xyxy_px[:, 0] + tracks.xyxy_px[:, 2]) / 2
        disparity_px, sigma_px = self.alignment.corrected(disparity_px, sigma_px, x_px=x_px, camera=self.rig.left)
        distance_m = self.rig.distance_m(disparity_px)
        return Ranges(
            tracks.track_id, distance_m, distance_m**2 / (self.rig.left.fx_px * self.rig.baseline_m) * sigma_px
        )


class TrackMatcher:
    """Matches each observed box alone, about the disparity that its track had last.

    A predicted box is not measured: what hides an object from the detector stands where the box is.

    Attributes:
        outcomes: how many boxes were matched so far, and how many were not, by the reason.
    """

    def __init__(self, matcher: BoxMatcher) -> None:
        """Remember for `matcher` what its tracks had."""
        self._matcher = matcher
        self._memory = _Disparities.none()
        self.outcomes: Counter[Outcome] = Counter()

    def match(self, tracks: Tracks, frame: Frame) -> tuple[FloatArray, FloatArray]:
        """(N,) disparities and standard deviations, px; NaN where there is no match or no right eye."""
        disparity_px, sigma_px = np.full(len(tracks), np.nan), np.full(len(tracks), np.nan)
        if frame.right is None:
            return disparity_px, sigma_px
        seen = np.flatnonzero(tracks.observed)
        prior_px = self._memory.prior_px(tracks.track_id[seen], frame.time_s)
        found = self._matcher.match(frame.left, frame.right, tracks.xyxy_px[seen], prior_px)
        disparity_px[seen], sigma_px[seen] = found.disparity_px, found.sigma_px
        self.outcomes.update(Outcome(code) for code in found.outcome.tolist())
        self._memory = self._memory.with_matches(
            tracks.track_id[seen], found.disparity_px, is_full_range=np.isnan(prior_px), time_s=frame.time_s
        )
        return disparity_px, sigma_px


@dataclass(frozen=True, slots=True)
class _Disparities:
    """What was matched last: (N,) track, disparity, when, and when the full range was last searched for it."""

    track_id: IntArray
    disparity_px: FloatArray
    time_s: FloatArray
    searched_s: FloatArray

    @classmethod
    def none(cls) -> _Disparities:
        nothing = np.zeros(0)
        return cls(np.zeros(0, np.int64), nothing, nothing, nothing)

    def prior_px(self, track_id: IntArray, time_s: float) -> FloatArray:
        """(N,) disparity to search about; NaN for a new track, a stale match, or when the full range is due again."""
        prior_px = np.full(len(track_id), np.nan)
        _, here, there = np.intersect1d(track_id, self.track_id, assume_unique=True, return_indices=True)
        is_fresh = (time_s - self.time_s[there] <= _PRIOR_LIFETIME_S) & (
            time_s - self.searched_s[there] <= _FULL_RANGE_EVERY_S
        )
        prior_px[here] = np.where(is_fresh, self.disparity_px[there], np.nan)
        return prior_px

    def with_matches(
        self, track_id: IntArray, disparity_px: FloatArray, *, is_full_range: BoolArray, time_s: float
    ) -> _Disparities:
        """This memory with the new matches in place of the old ones of the same tracks, and without stale ones."""
        searched_s = np.full(len(track_id), time_s)
        _, here, there = np.intersect1d(track_id, self.track_id, assume_unique=True, return_indices=True)
        searched_s[here] = np.where(is_full_range[here], time_s, self.searched_s[there])
        new = np.isfinite(disparity_px)
        old = ~np.isin(self.track_id, track_id[new]) & (time_s - self.time_s <= _PRIOR_LIFETIME_S)
        return _Disparities(
            np.concatenate([self.track_id[old], track_id[new]]),
            np.concatenate([self.disparity_px[old], disparity_px[new]]),
            np.concatenate([self.time_s[old], np.full(int(new.sum()), time_s)]),
            np.concatenate([self.searched_s[old], searched_s[new]]),
        )
