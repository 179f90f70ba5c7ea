"""StereoRanger: stereo distance of each box from its match in the right image.

SizeScaledRanger: stereo without calibration; the scale is learnt from the sizes of tracked objects.

    Z = K / d        K = f B, the product of focal length and baseline that a calibration would give
    K_i = Z_mono d   one measurement per track of a class of known size; K is their weighted median

A single object is a poor measurement, since sizes vary within a class; the median of many is a good
measurement. Distances are then consistent with each other and over time, and only their common
scale is uncertain. The error of the focal length is common to all methods and not part of these
sigmas.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.robust_statistics import MAD_TO_SIGMA, weighted_median
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
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
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
# standard deviation in px of the disparities of uncalibrated cameras, apart from the scale
_UNALIGNED_SIGMA_PX = 1.0
# relative, of the mean size of a class: countries, car models and detectors differ
_SIZES_SIGMA = 0.08
# relative, of K from single tracks, in addition to the sigma of their distances by size
_TRACK_SIGMA = 0.15
# effective number from which the observed scatter replaces `_TRACK_SIGMA`
_MIN_TRACKS_FOR_SCATTER = 6
# that K is learnt from; smaller ones depend more on the alignment than on the scale
_MIN_DISPARITY_PX = 3.0
# after which a track's weight is constant: its size error is always the same
_MAX_WEIGHTED_SAMPLES = 10
# per track and of tracks, to bound memory; more do not change the median
_MAX_SAMPLES, _MAX_TRACKS = 30, 500


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
        return self._matcher.outcomes

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the boxes that match; NaN where the match is rejected or there is no right
        image.
        """
        return self.measure_with(tracks, frame, {})

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """See `measure`; mono's distances help to separate an object from what occludes it."""
        return self.measure_at_scale(tracks, frame, others, DriveScale()).ranges

    def measure_at_scale(
        self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges], scale: DriveScale
    ) -> Measured:
        """See `measure_with`; the distances are evidence of the drive's scale, and do not depend on
        it.
        """
        by_size = None
        if "mono" in others:
            image_hw = (frame.left.shape[0], frame.left.shape[1])
            by_size = disparities_by_size(others["mono"], tracks.xyxy_px, self._rig, image_hw)
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


class FocalBaseline:
    """Estimator of K = f B in px m from the disparities and sizes of tracks."""

    def __init__(self) -> None:
        # by track: the samples of log K, their median, and its weight in the median over tracks
        self._samples: dict[int, list[float]] = {}
        self._median: dict[int, float] = {}
        self._weight: dict[int, float] = {}

    def learn(self, disparity_px: FloatArray, by_size: Ranges) -> None:
        """Add a frame: (N,) disparities, NaN = not matched, and distances of the same tracks by
        size.
        """
        with np.errstate(invalid="ignore"):
            usable_px = np.where(disparity_px >= _MIN_DISPARITY_PX, disparity_px, np.nan)
            log_k = np.log(usable_px * by_size.distance_m)
            size_sigma = by_size.sigma_m / by_size.distance_m
        variance = _TRACK_SIGMA**2 + size_sigma**2 + (_UNALIGNED_SIGMA_PX / usable_px) ** 2
        for i in np.flatnonzero(np.isfinite(log_k)).tolist():
            track_id = int(by_size.track_id[i])
            samples = self._samples.get(track_id, [])
            if len(samples) == _MAX_SAMPLES or (not samples and len(self._samples) == _MAX_TRACKS):
                continue
            self._samples[track_id] = [*samples, float(log_k[i])]
            self._median[track_id] = float(np.median(self._samples[track_id]))
            if len(samples) < _MAX_WEIGHTED_SAMPLES:
                self._weight[track_id] = self._weight.get(track_id, 0.0) + 1.0 / float(variance[i])

    @property
    def n_tracks(self) -> int:
        """Number of tracks with a sample."""
        return len(self._samples)

    def estimate(self) -> tuple[float, float]:
        """K in px m and its relative standard deviation; both NaN before the first sample."""
        if not self._samples:
            return float("nan"), float("nan")
        log_k = np.array(list(self._median.values()))
        weight = np.array(list(self._weight.values()))
        centre = weighted_median(log_k, weight)
        scatter = MAD_TO_SIGMA * weighted_median(np.abs(log_k - centre), weight)
        n_effective = float(weight.sum() ** 2 / (weight @ weight))
        scatter = scatter if n_effective >= _MIN_TRACKS_FOR_SCATTER else max(scatter, _TRACK_SIGMA)
        # The standard error of a median is 1.25 times that of a mean.
        return float(np.exp(centre)), float(
            np.hypot(_SIZES_SIGMA, 1.25 * scatter / np.sqrt(n_effective))
        )


class SizeScaledRanger(Ranger):
    """Ranges boxes of an uncalibrated pair, with a scale learnt from the sizes of tracked
    objects.
    """

    def __init__(self, matcher: BoxMatcher, *, focal_px: float, focal_sigma: float = 0.0) -> None:
        """Create a ranger without tracks; the focal length of distances by size and its sigma are
        for the summary.
        """
        self._matcher = TrackMatcher(matcher)
        self._focal_px, self._focal_sigma = focal_px, focal_sigma
        self.scale = FocalBaseline()

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the boxes that match, with the scale learnt so far; NaN for all before the
        first sample.
        """
        return self.measure_with(tracks, frame, {})

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances of the boxes that match, after mono's distances have updated the scale; NaN for
        other boxes.
        """
        disparity_px, sigma_px = self._matcher.match(tracks, frame)
        if "mono" in others:
            self.scale.learn(disparity_px, others["mono"])
        focal_baseline, relative_sigma = self.scale.estimate()
        with np.errstate(invalid="ignore"):
            disparity_px = np.where(disparity_px > 0, disparity_px, np.nan)
        distance_m = focal_baseline / disparity_px
        relative = np.hypot(relative_sigma, np.hypot(sigma_px, _UNALIGNED_SIGMA_PX) / disparity_px)
        return Ranges(tracks.track_id, distance_m, distance_m * relative)

    @property
    def notes(self) -> tuple[str, ...]:
        """The baseline implied by object sizes, with its uncertainty; empty before the first
        matched track.
        """
        learnt = self.summary().get("learnt_scale")
        if learnt is None:
            return ()
        return (
            f"Uncalibrated pair: with a focal length of {learnt['focal_px']:.0f} px, the sizes of "
            f"{learnt['n_tracks']} tracks imply a baseline of {learnt['baseline_m']:.2f} m; all "
            f"distances share a scale uncertainty of about {100 * learnt['relative_sigma']:.0f} %.",
        )

    def summary(self) -> dict[str, Any]:
        """The learnt scale: focal length, baseline, relative sigma of all distances, number of
        tracks.
        """
        if not self.scale.n_tracks:
            return {}
        focal_baseline, sigma = self.scale.estimate()
        learnt = {
            "focal_px": self._focal_px,
            "baseline_m": focal_baseline / self._focal_px,
            "relative_sigma": float(np.hypot(sigma, self._focal_sigma)),
            "n_tracks": self.scale.n_tracks,
        }
        return {"learnt_scale": learnt}


def _create(context: MethodContext) -> Ranger | None:
    rig = context.rig or context.assumed_rig
    if rig is None:
        return None
    if context.rig is None:
        matcher = PatchMatcher(PatchMatcherSettings.for_rig(rig))
        return SizeScaledRanger(
            matcher, focal_px=context.camera.fx_px, focal_sigma=context.focal_sigma
        )
    return StereoRanger(rig)


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
