"""SizeScaledRanger: stereo without calibration; the scale is learnt from the sizes of tracked objects.

    Z = K / d        K = f B, the product of focal length and baseline that a calibration would give
    K_i = Z_mono d   one measurement per track of a class of known size; K is their weighted median

A single object is a poor measurement, since sizes vary within a class; the median of many is a good one. Distances are
then consistent with each other and over time, and only their common scale is uncertain. The error of the focal length
is common to all methods and not part of these sigmas.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.robust_statistics import MAD_TO_SIGMA, weighted_median
from track_range.ranging.methods.triangulation import TrackMatcher
from track_range.ranging.ranger import Ranger
from track_range.ranging.ranges import Ranges
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.matching.patch_matches import BoxMatcher
from track_range.tracking.tracks import Tracks

_UNALIGNED_SIGMA_PX = 1.0  # standard deviation in px of the disparities of uncalibrated cameras, apart from the scale
_SIZES_SIGMA = 0.08  # relative, of the mean size of a class: countries, car models and detectors differ
_TRACK_SIGMA = 0.15  # relative, of K from single tracks, in addition to the sigma of their distances by size
_MIN_TRACKS_FOR_SCATTER = 6  # effective number from which the observed scatter replaces `_TRACK_SIGMA`
_MIN_DISPARITY_PX = 3.0  # that K is learnt from; smaller ones depend more on the alignment than on the scale
_MAX_WEIGHTED_SAMPLES = 10  # after which a track's weight is constant: its size error is always the same
_MAX_SAMPLES, _MAX_TRACKS = 30, 500  # per track and of tracks, to bound memory; more do not change the median


class _TrackScale:
    """Median of the samples of log K of one track, and its weight in the median over tracks."""

    def __init__(self) -> None:
        self._samples: list[float] = []
        self.median = float("nan")
        self.weight = 0.0

    def add(self, log_k: float, variance: float) -> None:
        if len(self._samples) == _MAX_SAMPLES:
            return
        self._samples.append(log_k)
        self.median = float(np.median(self._samples))
        if len(self._samples) <= _MAX_WEIGHTED_SAMPLES:
            self.weight += 1.0 / variance


class FocalBaseline:
    """Estimator of K = f B in px m from the disparities and sizes of tracks."""

    def __init__(self) -> None:
        self._tracks: dict[int, _TrackScale] = {}

    def learn(self, disparity_px: FloatArray, by_size: Ranges) -> None:
        """Add a frame: (N,) disparities, NaN = not matched, and distances of the same tracks by size."""
        with np.errstate(invalid="ignore"):
            usable_px = np.where(disparity_px >= _MIN_DISPARITY_PX, disparity_px, np.nan)
            log_k = np.log(usable_px * by_size.distance_m)
            size_sigma = by_size.sigma_m / by_size.distance_m
        variance = _TRACK_SIGMA**2 + size_sigma**2 + (_UNALIGNED_SIGMA_PX / usable_px) ** 2
        for i in np.flatnonzero(np.isfinite(log_k)).tolist():
            track_id = int(by_size.track_id[i])
            if track_id in self._tracks or len(self._tracks) < _MAX_TRACKS:
                self._tracks.setdefault(track_id, _TrackScale()).add(float(log_k[i]), float(variance[i]))

    @property
    def n_tracks(self) -> int:
        """Number of tracks with a sample."""
        return len(self._tracks)

    def estimate(self) -> tuple[float, float]:
        """K in px m and its relative standard deviation; both NaN before the first sample."""
        if not self._tracks:
            return float("nan"), float("nan")
        log_k = np.array([track.median for track in self._tracks.values()])
        weight = np.array([track.weight for track in self._tracks.values()])
        centre = weighted_median(log_k, weight)
        scatter = MAD_TO_SIGMA * weighted_median(np.abs(log_k - centre), weight)
        n_effective = float(weight.sum() ** 2 / (weight @ weight))
        scatter = scatter if n_effective >= _MIN_TRACKS_FOR_SCATTER else max(scatter, _TRACK_SIGMA)
        # The standard error of a median is 1.25 times that of a mean.
        return float(np.exp(centre)), float(np.hypot(_SIZES_SIGMA, 1.25 * scatter / np.sqrt(n_effective)))


class SizeScaledRanger(Ranger):
    """Ranges boxes of an uncalibrated pair, with a scale learnt from the sizes of tracked objects."""

    def __init__(self, matcher: BoxMatcher, *, focal_px: float, focal_sigma: float = 0.0) -> None:
        """Create a ranger without tracks; the focal length of distances by size and its sigma are for the summary."""
        self._matcher = TrackMatcher(matcher)
        self._focal_px, self._focal_sigma = focal_px, focal_sigma
        self.scale = FocalBaseline()

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the boxes that match, with the scale learnt so far; NaN for all before the first sample."""
        return self.measure_with(tracks, frame, {})

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances of the boxes that match, after mono's distances have updated the scale; NaN for the rest."""
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
        """The baseline implied by object sizes, with its uncertainty; empty before the first matched track."""
        learnt = self.summary().get("learnt_scale")
        if learnt is None:
            return ()
        return (
            f"Uncalibrated pair: with a focal length of {learnt['focal_px']:.0f} px, the sizes of "
            f"{learnt['n_tracks']} tracks imply a baseline of {learnt['baseline_m']:.2f} m; all distances share a "
            f"scale uncertainty of about {100 * learnt['relative_sigma']:.0f} %.",
        )

    def summary(self) -> dict[str, Any]:
        """The learnt scale: focal length, baseline, relative sigma of all distances, number of tracks."""
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
