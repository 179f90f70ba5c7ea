"""StereoRanger: stereo distance of each box from its match in the right image."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.method import (
    ErrorSource,
    Measured,
    MethodContext,
    Ranger,
    RangingMethod,
)
from track_range.ranging.methods.triangulation import (
    TrackMatcher,
    Triangulation,
    disparities_by_size,
)
from track_range.ranging.size_models.drive_scale import NO_EVIDENCE, DriveScale, ScaleEvidence
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matcher import PatchMatcher, PatchMatcherSettings
from track_range.stereo.matching.patch_matches import REASONS, BoxMatcher, Outcome, PatchMatches
from track_range.tracking.tracks import Tracks

_DETAILS = {
    "surfaces": "number of surfaces that `stereo` found in the box: the object, occluders, "
    "background; empty = not matched",
    "probability": "probability that the surface that `stereo` measured is the object, 0 to 1",
}
# relative error of all distances of a pair, as a reference for the scale of the drive
_REFERENCE_SIGMA = 0.01


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
        self,
        rig: StereoRig,
        matcher: BoxMatcher | None = None,
        *,
        alignment: Alignment | None = None,
    ) -> None:
        """Create a ranger for a rectified rig.

        Args:
            rig: the rectified pair (`Recording.rig`, `Rectifier.rig`).
            matcher: matcher of boxes; None = the patch matcher with the settings for this rig.
            alignment: correction of the disparities; None = the alignment of each frame, which
                frames of `open_recording` hold, or that of the rig.

        Raises ValueError: the rig is not rectified.
        """
        if not rig.is_rectified:
            raise ValueError(
                "rig: expected a rectified pair; use Rectifier(rig).rig, and its images"
            )
        self._rig, self._given = rig, alignment
        self._triangulate = Triangulation(rig)
        self._n_surfaces: Counter[int] = Counter()
        self._matcher = TrackMatcher(matcher or PatchMatcher(PatchMatcherSettings.for_rig(rig)))

    @property
    def outcomes(self) -> Counter[Outcome]:
        """Number of boxes so far by outcome: matched, or the reason for the rejection."""
        counts = self._matcher.outcomes.items()
        return Counter({Outcome(number): count for number, count in counts})

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the boxes that match; NaN where the match is rejected or there is no right
        image.
        """
        return self.measure_with(tracks, frame, {})

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """See `measure`; mono's distances help to separate an object from what occludes it."""
        return self.measure_at_scale(tracks, frame, others, NO_EVIDENCE).ranges

    def measure_at_scale(
        self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges], scale: DriveScale
    ) -> Measured:
        """See `measure_with`; the distances have the scale of the rig, and are evidence of the
        drive's scale.
        """
        by_size = None
        if "mono" in others and scale.rig.is_known:
            image_hw = (frame.left.shape[0], frame.left.shape[1])
            expected = scale.rig.measured(others["mono"])
            by_size = disparities_by_size(expected, tracks.xyxy_px, self._rig, image_hw)
        disparity_px, sigma_px = self._matcher.match(tracks, frame, by_size)
        details = self._surfaces(tracks) if frame.right is not None else None
        alignment = self._given or self._rig.alignment_of(frame)
        ranges = self._triangulate.ranges(
            tracks, disparity_px, sigma_px, alignment, details=details
        )
        return Measured(ranges, ScaleEvidence(tracks.class_id, None, ranges, _REFERENCE_SIGMA))

    @property
    def matches(self) -> PatchMatches | None:
        """Matches of the observed boxes in the last frame, with the number of surfaces; None before
        the first frame.
        """
        return self._matcher.matches

    def _surfaces(self, tracks: Tracks) -> dict[str, FloatArray]:
        """Number of surfaces, and probability of the measured surface, of the tracks matched in
        this frame.
        """
        details = np.full((len(_DETAILS), len(tracks)), np.nan)
        if (matches := self._matcher.matches) is not None:
            is_matched = np.isfinite(matches.disparity_px)
            surfaces = np.array([matches.n_surfaces, matches.probability])
            details[:, tracks.observed] = np.where(
                is_matched & (matches.n_surfaces > 0), surfaces, np.nan
            )
            self._n_surfaces.update(matches.n_surfaces[is_matched].tolist())
        return dict(zip(_DETAILS, details, strict=True))

    def summary(self) -> dict[str, Any]:
        """Number of boxes that were not matched, by reason, and of matched boxes by the number of
        their surfaces.
        """
        counts = self.outcomes.most_common()
        unmatched = {REASONS[outcome]: n for outcome, n in counts if outcome is not Outcome.MATCHED}
        surfaces = {str(n): count for n, count in sorted(self._n_surfaces.items()) if n}
        return {"stereo_unmatched": unmatched, "stereo_surfaces": surfaces}


def _create(context: MethodContext) -> Ranger | None:
    return None if context.rig is None else StereoRanger(context.rig)


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
