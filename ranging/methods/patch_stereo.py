"""StereoRanger: stereo distance of each box from its match in the right image."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.method import ErrorSource, MethodContext, RangingMethod
from track_range.ranging.methods.size_scaled_stereo import SizeScaledRanger
from track_range.ranging.methods.triangulation import TrackMatcher, Triangulation, disparities_by_size
from track_range.ranging.ranger import Measured, Ranger
from track_range.ranging.ranges import Ranges
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.stereo.alignment.model import Alignment, AlignmentSource
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matcher import PatchMatcher, PatchMatcherSettings
from track_range.stereo.matching.patch_matches import REASONS, BoxMatcher, Outcome, PatchMatches
from track_range.tracking.tracks import Tracks

_DETAILS = ("surfaces", "probability")


_REFERENCE_SIGMA = 0.01  # relative error of all distances of a pair, as a reference for the scale of the drive


class StereoRanger(Ranger):
    """Ranges each observed box by matching it separately in the right image.

    Example:
        >>> import track_range as tr
        >>> recording = tr.open_recording("left.mp4", "right.mp4", rig="rig.yaml", align="off")
        >>> frame = next(recording.frames)
        >>> tracks = tr.Tracker().update(tr.Detector("road").detect(frame.left), frame.time_s, frame.left)
        >>> ranges = tr.StereoRanger(recording.rig).measure(tracks, frame)
        >>> len(ranges) == len(tracks)
        True
        >>> recording.close()
    """

    def __init__(
        self, rig: StereoRig, matcher: BoxMatcher | None = None, *, alignment: AlignmentSource | None = None
    ) -> None:
        """Create a ranger for a rectified rig.

        Args:
            rig: the rectified pair (`Recording.rig`, `Rectifier.rig`).
            matcher: matcher of boxes; None = the patch matcher with the settings for this rig.
            alignment: correction of the disparities; None = that of the rig, which `open_recording` has estimated.

        Raises:
            ValueError: the rig is not rectified.
        """
        if not rig.is_rectified:
            raise ValueError("rig: expected a rectified pair; use Rectifier(rig).rig, and its images")
        self._triangulate = Triangulation(rig, alignment or rig.alignment or Alignment())
        self._rig = rig
        self._n_surfaces: Counter[int] = Counter()
        self._matcher = TrackMatcher(matcher or PatchMatcher(PatchMatcherSettings.for_rig(rig)))

    @property
    def outcomes(self) -> Counter[Outcome]:
        """Number of boxes so far by outcome: matched, or the reason for the rejection."""
        return self._matcher.outcomes

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the boxes that match; NaN where the match is rejected or there is no right image."""
        return self.measure_with(tracks, frame, {})

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """As `measure`; mono's distances help to separate an object from what occludes it."""
        return self.measure_at_scale(tracks, frame, others, DriveScale()).ranges

    def measure_at_scale(
        self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges], scale: DriveScale
    ) -> Measured:
        """As `measure_with`; the distances are evidence of the drive's scale, and do not depend on it."""
        by_size = None
        if "mono" in others:
            image_hw = (frame.left.shape[0], frame.left.shape[1])
            by_size = disparities_by_size(others["mono"], tracks.xyxy_px, self._rig, image_hw)
        disparity_px, sigma_px = self._matcher.match(tracks, frame, by_size)
        details = self._surfaces(tracks) if frame.right is not None else None
        ranges = self._triangulate.ranges(tracks, disparity_px, sigma_px, time_s=frame.time_s, details=details)
        return Measured(ranges, ScaleEvidence(tracks.class_id, None, ranges, _REFERENCE_SIGMA))

    @property
    def matches(self) -> PatchMatches | None:
        """Matches of the observed boxes in the last frame, with the number of surfaces; None before the first."""
        return self._matcher.matches

    def _surfaces(self, tracks: Tracks) -> dict[str, FloatArray]:
        """Number of surfaces, and probability of the measured one, of the tracks that were matched in this frame."""
        details = np.full((len(_DETAILS), len(tracks)), np.nan)
        if (matches := self._matcher.matches) is not None:
            is_matched = np.isfinite(matches.disparity_px)
            surfaces = np.array([matches.n_surfaces, matches.probability])
            details[:, tracks.observed] = np.where(is_matched & (matches.n_surfaces > 0), surfaces, np.nan)
            self._n_surfaces.update(matches.n_surfaces[is_matched].tolist())
        return dict(zip(_DETAILS, details, strict=True))

    def summary(self) -> dict[str, Any]:
        """Number of boxes that were not matched, by reason, and of matched boxes by the number of their surfaces."""
        counts = self.outcomes.most_common()
        unmatched = {REASONS[outcome]: n for outcome, n in counts if outcome is not Outcome.MATCHED}
        surfaces = {str(n): count for n, count in sorted(self._n_surfaces.items()) if n}
        return {"stereo_unmatched": unmatched, "stereo_surfaces": surfaces}


def _create(context: MethodContext) -> Ranger | None:
    rig = context.rig or context.assumed_rig
    if rig is None:
        return None
    if context.rig is None:
        matcher = PatchMatcher(PatchMatcherSettings.for_rig(rig))
        return SizeScaledRanger(matcher, focal_px=context.camera.fx_px, focal_sigma=context.focal_sigma)
    return StereoRanger(rig, alignment=context.drifting_alignment or context.alignment)


STEREO = RangingMethod(
    name="stereo",
    title="stereo",
    letter="S",
    colour="#1aa36b",
    create=_create,
    needs=frozenset({"right_image"}),
    reads=("mono",),
    error_sources=(ErrorSource("baseline", systematic=0.91), ErrorSource("own", independent=0.09)),
    is_scale_reference=True,
    is_filtered=True,
    details=_DETAILS,
)
