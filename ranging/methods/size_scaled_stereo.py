"""SizeScaledRanger: stereo without a calibration; what one px of disparity is worth is learnt from the sizes of things.

    Z = K / d,   K = f B, the product of focal length and baseline that a calibration would tell
    every track with a class whose size is known says   K = Z_mono d,   and the median over the tracks is taken

One object's size says little (people differ, cars too), many together say the mean: after that stereo is as even
between near and far, and from frame to frame, as ever; only the common scale stays in doubt. What the focal length adds
to the doubt is common to mono as well, and not in these sigmas.
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

_UNALIGNED_SIGMA_PX = 1.0
"""Disparity error of eyes that nobody has calibrated, as far as a scale does not take it up."""

_SIZES_SIGMA = 0.08
"""Relative error of the mean of a class: other countries, other makes, other detectors."""

_TRACK_SIGMA = 0.15
"""Relative scatter of single tracks about the truth, beyond what their size's own sigma says."""

_MIN_TRACKS_TOLD = 6
"""So many tracks tell their own scatter."""

_MIN_DISPARITY_PX = 3.0
"""Smaller ones tell more of the eyes' alignment than of the scale."""

_ENOUGH_SAMPLES = 10
"""A track seen more often than this counts no more for it: its size stays the same."""

_MAX_SAMPLES, _MAX_TRACKS = 30, 500
"""More of a track, and more tracks, are not listened to: they would change nothing."""


class _Told:
    """What one track has told: log K, again and again, and how much that weighs."""

    def __init__(self) -> None:
        self._samples: list[float] = []
        self.median = float("nan")
        self.weight = 0.0

    def hear(self, log_k: float, variance: float) -> None:
        if len(self._samples) == _MAX_SAMPLES:
            return
        self._samples.append(log_k)
        self.median = float(np.median(self._samples))
        if len(self._samples) <= _ENOUGH_SAMPLES:
            self.weight += 1.0 / variance


class FocalBaseline:
    """K = f B in px m, learnt track by track."""

    def __init__(self) -> None:
        self._told: dict[int, _Told] = {}

    def learn(self, disparity_px: FloatArray, by_size: Ranges) -> None:
        """Take in a frame: (N,) disparities, NaN = not matched, and what size says of the same tracks."""
        with np.errstate(invalid="ignore"):
            clear_px = np.where(disparity_px >= _MIN_DISPARITY_PX, disparity_px, np.nan)
            log_k = np.log(clear_px * by_size.distance_m)
            of_size = by_size.sigma_m / by_size.distance_m
        variance = _TRACK_SIGMA**2 + of_size**2 + (_UNALIGNED_SIGMA_PX / clear_px) ** 2
        for i in np.flatnonzero(np.isfinite(log_k)).tolist():
            track_id = int(by_size.track_id[i])
            if track_id in self._told or len(self._told) < _MAX_TRACKS:
                self._told.setdefault(track_id, _Told()).hear(float(log_k[i]), float(variance[i]))

    @property
    def n_tracks(self) -> int:
        """Tracks that have told something."""
        return len(self._told)

    def estimate(self) -> tuple[float, float]:
        """K in px m and its relative standard deviation; NaN both before any track has told anything."""
        if not self._told:
            return float("nan"), float("nan")
        log_k = np.array([told.median for told in self._told.values()])
        weight = np.array([told.weight for told in self._told.values()])
        middle = weighted_median(log_k, weight)
        scatter = MAD_TO_SIGMA * weighted_median(np.abs(log_k - middle), weight)
        n_effective = float(weight.sum() ** 2 / (weight @ weight))
        scatter = scatter if n_effective >= _MIN_TRACKS_TOLD else max(scatter, _TRACK_SIGMA)
        # 1.25: a median scatters a quarter more than a mean.
        return float(np.exp(middle)), float(np.hypot(_SIZES_SIGMA, 1.25 * scatter / np.sqrt(n_effective)))


class SizeScaledRanger(Ranger):
    """Ranges boxes of an uncalibrated pair; the first ones of a video by few sizes, later ones by more.

    Attributes:
        scale: what has been learnt so far.
    """

    def __init__(self, matcher: BoxMatcher, *, focal_px: float, focal_sigma: float = 0.0) -> None:
        """Scale the disparities of `matcher`.

        Args:
            matcher: of boxes.
            focal_px: focal length with which the sizes were turned into distances,
            focal_sigma: and its relative standard deviation; both are for the summary alone.
        """
        self._matcher = TrackMatcher(matcher)
        self._focal_px, self._focal_sigma = focal_px, focal_sigma
        self.scale = FocalBaseline()

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of the boxes that match, by the scale as known so far; NaN for all while it is unknown."""
        return self.measure_with(tracks, frame, {})

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances of the boxes that match, after mono's distances have taught the scale; NaN for the rest."""
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
        """The baseline that the sizes imply, and how sure that is; nothing as long as no track has been matched."""
        learnt = self.summary().get("learnt_scale")
        if learnt is None:
            return ()
        return (
            f"Uncalibrated: with a focal length of {learnt['focal_px']:.0f} px the sizes of {learnt['n_tracks']} "
            f"tracks say a baseline of {learnt['baseline_m']:.2f} m; all distances are good to about "
            f"{100 * learnt['relative_sigma']:.0f} %.",
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
