"""EgoSpeed: forward speed over the time of the video, of the vehicle if the camera's mounting is
known, else of the camera along its optical axis.

The speed is interpolated linearly between samples and is NaN outside them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import FloatArray

# largest plausible speed (432 km/h); a faster one is most likely in another unit
MAX_SPEED_MPS = 120.0
MAX_GAP_S = 3.0  # longest interval between two samples that is interpolated
# s before the first and after the last sample for which it holds: videos start on another frame
_EDGE_S = 0.25
# A car brakes by up to 10 m/s^2; a speed that falls to rest faster, beyond the noise of both
# samples, or leaves rest so, is that of a receiver that lost its satellites.
_MAX_ACCELERATION_MPS2, _MAX_NOISE_MPS, _REST_MPS = 10.0, 1.0, 1.0
# standard deviation of the speeds of tables, which state none: that of GPS receivers
TABLE_SIGMA_MPS = 0.2


@dataclass(frozen=True, slots=True)
class EgoSpeed:
    """Samples of the speed."""

    # (N,) increasing, seconds from the video's first frame; a single -inf = constant speed
    time_s: FloatArray
    speed_mps: FloatArray  # (N,) forwards, negative = backwards
    source: str  # where the samples come from, for notes
    speed_sigma_mps: float = TABLE_SIGMA_MPS  # standard deviation of the samples
    time_sigma_s: float = 0.0  # standard deviation of the time offset that all samples share
    # (N, 2) latitude and longitude, to check the speeds; None = unknown
    positions_deg: FloatArray | None = None
    # (N,) speed of the vehicle over ground, if `speed_mps` is along the camera's axis; None =
    # unknown
    over_ground_mps: FloatArray | None = None

    def of_vehicle(self) -> EgoSpeed:
        """The speed of the vehicle, for a camera whose mounting is known."""
        if self.over_ground_mps is None:
            return self
        return replace(self, speed_mps=self.over_ground_mps)

    def without_lost_fixes(self) -> tuple[EgoSpeed, FloatArray]:
        """The speeds without those at rest before or after a jump that no car makes, and the times
        (K,) of those; speeds between two samples far apart are unknown.
        """
        step_mps = np.abs(np.diff(self.speed_mps))
        possible_mps = _MAX_ACCELERATION_MPS2 * np.diff(self.time_s) + _MAX_NOISE_MPS
        part = np.concatenate([[0], np.cumsum(step_mps > possible_mps)])  # between two jumps
        fastest_mps = np.zeros(part[-1] + 1)
        np.maximum.at(fastest_mps, part, np.abs(self.speed_mps))
        is_lost = (fastest_mps < _REST_MPS)[part] & (part[-1] > 0)
        if not is_lost.any():
            return self, np.zeros(0)
        kept = replace(
            self,
            time_s=self.time_s[~is_lost],
            speed_mps=self.speed_mps[~is_lost],
            positions_deg=None if self.positions_deg is None else self.positions_deg[~is_lost],
            over_ground_mps=(
                None if self.over_ground_mps is None else self.over_ground_mps[~is_lost]
            ),
        )
        return kept, self.time_s[is_lost]

    def at(self, time_s: float) -> float:
        """Speed at `time_s` in m/s, NaN = unknown."""
        if np.isneginf(self.time_s[0]):
            return float(self.speed_mps[0])
        if not self.time_s[0] - _EDGE_S <= time_s <= self.time_s[-1] + _EDGE_S:
            return math.nan
        after = int(np.searchsorted(self.time_s, time_s))
        is_between = 0 < after < len(self.time_s)
        if is_between and self.time_s[after] - self.time_s[after - 1] > MAX_GAP_S:
            return math.nan
        return float(np.interp(time_s, self.time_s, self.speed_mps))

    def near(self, time_s: FloatArray) -> FloatArray:
        """(N,) speeds at times (N,) in m/s; outside the samples, and in gaps, those beside."""
        if len(self.time_s) == 1:
            return np.full(len(time_s), self.speed_mps[0])
        after = np.searchsorted(self.time_s, time_s).clip(1, len(self.time_s) - 1)
        start_s, end_s = self.time_s[after - 1], self.time_s[after]
        is_gap = end_s - start_s > MAX_GAP_S
        beside_s = np.where(time_s - start_s < end_s - time_s, start_s, end_s)
        return np.interp(np.where(is_gap, beside_s, time_s), self.time_s, self.speed_mps)

    def sigma_at(self, time_s: float) -> float:
        """Standard deviation of `at(time_s)` in m/s, NaN where the speed is unknown.

        sigma^2 = sigma_v^2 + (a sigma_t)^2, with the acceleration a between the neighbouring
        samples.
        """
        if math.isnan(self.at(time_s)):
            return math.nan
        if len(self.time_s) == 1 or not self.time_sigma_s:
            return self.speed_sigma_mps
        after = int(np.clip(np.searchsorted(self.time_s, time_s), 1, len(self.time_s) - 1))
        step_mps, step_s = (float(x[after] - x[after - 1]) for x in (self.speed_mps, self.time_s))
        return math.hypot(self.speed_sigma_mps, step_mps / step_s * self.time_sigma_s)

    def note(self, last_s: float, subject: str = "") -> str | None:
        """Note for the user on a video with its last frame at `last_s`; None if the samples cover
        all of the video.
        """
        first_known_s, last_known_s = float(self.time_s[0]), float(self.time_s[-1])
        if np.isneginf(first_known_s) or (
            first_known_s - _EDGE_S <= 0 and last_s <= last_known_s + _EDGE_S
        ):
            return None
        return (
            f"{subject or 'The ego speed from ' + self.source} covers "
            f"{first_known_s:.1f}-{last_known_s:.1f} s of the video; elsewhere closing speeds are "
            "estimated from distances alone."
        )
