"""Triangulation: Z = f B / d from the disparity d of a track's box.

    sigma_Z = Z^2 / (f B) sigma_d: the error grows with the square of the distance.
Guo, the binocular paper, eq. 5-6, which takes the disparity at the centre of the box.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.ranges import Ranges
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matches import BoxMatcher, Outcome
from track_range.tracking.tracks import Tracks

_PRIOR_LIFETIME_S = 1.0
"""Time without a match after which a track is searched over the full range of disparities again."""

_FULL_SEARCH_INTERVAL_S = 1.0
"""Time after which the full range is searched in any case, so that a track that followed an occluder recovers."""


@dataclass(frozen=True, slots=True)
class Triangulation:
    """Turns measured disparities into distances.

    Attributes:
        rig: the rectified pair.
        alignment: correction of its disparities.
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
    """Matches each observed box on its own, near the disparity that its track had last.

    A predicted box is not matched: what hides the object from the detector is in front of it.

    Attributes:
        outcomes: number of boxes so far by outcome: matched, or the reason why not.
    """

    def __init__(self, matcher: BoxMatcher) -> None:
        """Match with `matcher`."""
        self._matcher = matcher
        self._state = TrackState(np.full(3, np.nan))
        """By track: disparity last matched, when, and when the full range was last searched."""
        self.outcomes: Counter[Outcome] = Counter()

    def match(self, tracks: Tracks, frame: Frame) -> tuple[FloatArray, FloatArray]:
        """(N,) disparities and standard deviations, px; NaN where there is no match or no right image."""
        disparity_px, sigma_px = np.full((2, len(tracks)), np.nan)
        if frame.right is None:
            return disparity_px, sigma_px
        rows, time_s = np.flatnonzero(tracks.observed), frame.time_s
        before = self._state.get(tracks.track_id[rows])
        last_px, matched_s, searched_s = before
        is_recent = (time_s - matched_s <= _PRIOR_LIFETIME_S) & (time_s - searched_s <= _FULL_SEARCH_INTERVAL_S)
        prior_px = np.where(is_recent, last_px, np.nan)
        matches = self._matcher.match(frame.left, frame.right, tracks.xyxy_px[rows], prior_px)
        disparity_px[rows], sigma_px[rows] = matches.disparity_px, matches.sigma_px
        self.outcomes.update(Outcome(code) for code in matches.outcome.tolist())
        searched_s = np.where(is_recent, searched_s, time_s)
        after = np.stack([matches.disparity_px, np.full(len(rows), time_s), searched_s])
        self._state.put(
            tracks.track_id[rows],
            np.where(np.isfinite(matches.disparity_px), after, before),
            keep_known=time_s - self._state.known[1] <= _PRIOR_LIFETIME_S,
        )
        return disparity_px, sigma_px
