"""Triangulation: distance Z from the disparity d of a track's box.

    Z = f B / d        sigma_Z = Z^2 / (f B) sigma_d

with focal length f in px and baseline B in m; the error grows with the square of the distance. (Guo
Pengyu, eq. 5-6, with the disparity at the centre of the box.)
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matches import (
    BoxMatcher,
    ExpectedDisparity,
    PatchMatches,
)
from track_range.tracking.tracks import Tracks

# after the last match, during which a track's disparity restricts the search
_PRIOR_LIFETIME_S = 1.0
# after which the full range is searched, so that a track can leave an occluder
_FULL_SEARCH_INTERVAL_S = 1.0
# distance in px from the image border within which a box may show only a part of the object
_BORDER_PX = 2.0
_CUT_LOG_SIGMA = 0.4  # additional standard deviation of the log disparity by size of such a box


@dataclass(frozen=True, slots=True)
class Triangulation:
    """Conversion of disparities to distances."""

    rig: StereoRig

    def ranges(
        self,
        tracks: Tracks,
        disparity_px: FloatArray,
        sigma_px: FloatArray,
        alignment: Alignment,
        *,
        details: Mapping[str, FloatArray] | None = None,
    ) -> Ranges:
        """Distances of N tracks from (N,) disparities, which `alignment` corrects, and their standard
        deviations; NaN unless d > 0.
        """
        x_px = (tracks.xyxy_px[:, 0] + tracks.xyxy_px[:, 2]) / 2
        d, sigma_d = alignment.corrected(disparity_px, sigma_px, x_px=x_px, camera=self.rig.left)
        Z = self.rig.distance_m(d)
        sigma_Z = Z**2 / (self.rig.left.fx_px * self.rig.baseline_m) * sigma_d
        return Ranges(tracks.track_id, Z, sigma_Z, details=details or {})


def disparities_by_size(
    by_size: Ranges, xyxy_px: FloatArray, rig: StereoRig, image_hw: tuple[int, int]
) -> ExpectedDisparity:
    """Disparities of boxes (N, 4) expected from their distances by size, in images of (height,
    width) `image_hw`.
    """
    height, width = image_hw
    first_px = np.array([1.0 + _BORDER_PX] * 2 + [-np.inf] * 2)
    last_px = np.array([np.inf, np.inf, width - 2.0 - _BORDER_PX, height - 2.0 - _BORDER_PX])
    is_cut = ((xyxy_px < first_px) | (xyxy_px > last_px)).any(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        disparity_px = rig.left.fx_px * rig.baseline_m / by_size.distance_m
        log_sigma = by_size.sigma_m / by_size.distance_m
    return ExpectedDisparity(
        disparity_px, np.hypot(log_sigma, np.where(is_cut, _CUT_LOG_SIGMA, 0.0))
    )


class TrackMatcher:
    """Matches each observed box separately, with the last disparity of its track as the prior.

    Predicted boxes are not matched: they show what occludes the object.
    """

    def __init__(self, matcher: BoxMatcher) -> None:
        # of the observed boxes in the last frame with a right image; None = none yet
        self.matches: PatchMatches | None = None
        self._matcher = matcher
        self._state = TrackState(np.full(3, np.nan))
        """By track: last matched disparity, its time, time of the last search over the full
        range."""
        # number of boxes so far by value of `Outcome`: matched, or the reason for the rejection
        self.outcomes: Counter[int] = Counter()

    def match(
        self, tracks: Tracks, frame: Frame, by_size: ExpectedDisparity | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """(N,) disparities and their standard deviations in px; NaN = no match, or no right image.

        `by_size` are disparities expected from the sizes of the N tracks; None = unknown.
        """
        disparity_px, sigma_px = np.full((2, len(tracks)), np.nan)
        if frame.right is None:
            return disparity_px, sigma_px
        rows, time_s = np.flatnonzero(tracks.observed), frame.time_s
        previous = self._state.get(tracks.track_id[rows])
        last_px, matched_s, searched_s = previous
        is_recent = (time_s - matched_s <= _PRIOR_LIFETIME_S) & (
            time_s - searched_s <= _FULL_SEARCH_INTERVAL_S
        )
        prior_px = np.where(is_recent, last_px, np.nan)
        boxes, expected = tracks.xyxy_px[rows], None if by_size is None else by_size.select(rows)
        self.matches = matches = self._matcher.match(
            frame.left, frame.right, boxes, prior_px, expected
        )
        disparity_px[rows], sigma_px[rows] = matches.disparity_px, matches.sigma_px
        self.outcomes.update(matches.outcome.tolist())
        searched_s = np.where(is_recent, searched_s, time_s)
        updated = np.array([matches.disparity_px, np.full(len(rows), time_s), searched_s])
        self._state.put(
            tracks.track_id[rows],
            np.where(np.isfinite(matches.disparity_px), updated, previous),
            keep_known=time_s - self._state.known[1] <= _PRIOR_LIFETIME_S,
        )
        return disparity_px, sigma_px
