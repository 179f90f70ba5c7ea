"""Ranges: distances of one frame's tracks by one method, with standard deviations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray, check_shape
from track_range.ranging.measurement.growth import Growth


@dataclass(frozen=True, slots=True)
class Ranges:
    """One method's distances for the tracks of one frame.

    Example:
        >>> import numpy as np, track_range as tr
        >>> tr.Ranges(np.array([7, 8]), np.array([22.4, np.nan]), np.array([0.7, np.nan]))
        Ranges(1 of 2 measured, 22.4 to 22.4 m)

    Attributes:
        track_id: (N,) int64, the tracks in the order of the frame's Tracks.
        distance_m: (N,) z of the object's visible surface on the ray through the box's centre, in
            the left camera's frame; NaN = not measured.
        sigma_m: (N,) standard deviation of distance_m; NaN where distance_m is.
        sigma_systematic_m: (N,) systematic part of sigma_m, constant over a track; None = unknown.
        details: (N,) further values by the names in `RangingMethod.details`; NaN = none.
        growth: (N,) growth of the tracks in the images, for the filters of all methods; None = not
            measured.
        is_fallback: whether fusion leaves the distances out where the other method measured
            (`RangingMethod.fallback_for`, without which it has no effect); False = in this frame
            they are independent of the other method, and are fused too.
    """

    track_id: IntArray
    distance_m: FloatArray
    sigma_m: FloatArray
    sigma_systematic_m: FloatArray | None = None
    details: Mapping[str, FloatArray] = field(default_factory=dict)
    growth: Growth | None = None
    is_fallback: bool = True

    def __post_init__(self) -> None:
        n = len(self.track_id)
        check_shape("track_id", self.track_id, (n,))
        check_shape("distance_m", self.distance_m, (n,))
        check_shape("sigma_m", self.sigma_m, (n,))
        if self.sigma_systematic_m is not None:
            check_shape("sigma_systematic_m", self.sigma_systematic_m, (n,))
        for name, values in self.details.items():
            check_shape(f"details[{name!r}]", values, (n,))

    def __len__(self) -> int:
        return len(self.track_id)

    def __repr__(self) -> str:
        known_m = self.distance_m[np.isfinite(self.distance_m)]
        span = f", {known_m.min():.1f} to {known_m.max():.1f} m" if len(known_m) else ""
        return f"Ranges({len(known_m)} of {len(self)} measured{span})"

    def with_distances(
        self, distance_m: FloatArray, sigma_m: FloatArray, systematic_m: FloatArray | None
    ) -> Ranges:
        """The ranges with other distances and standard deviations."""
        return Ranges(
            self.track_id,
            distance_m,
            sigma_m,
            systematic_m,
            self.details,
            self.growth,
            self.is_fallback,
        )

    def widened(self, relative_sigma: float) -> Ranges:
        """The ranges with a further error, independent of theirs, of `relative_sigma` times the
        distance.
        """
        if not relative_sigma:
            return self
        sigma_m = np.hypot(self.sigma_m, relative_sigma * self.distance_m)
        return self.with_distances(self.distance_m, sigma_m, self.sigma_systematic_m)

    def scaled(self, factor: float) -> Ranges:
        """The ranges with distances and standard deviations times a factor."""
        if factor == 1.0:
            return self
        systematic_m = self.sigma_systematic_m
        if systematic_m is not None:
            systematic_m = systematic_m * factor
        return self.with_distances(self.distance_m * factor, self.sigma_m * factor, systematic_m)

    @classmethod
    def unmeasured(cls, track_id: IntArray) -> Ranges:
        """Ranges of (N,) unmeasured tracks: NaN for all."""
        nan = np.full(len(track_id), np.nan)
        return cls(track_id, nan, nan.copy())
