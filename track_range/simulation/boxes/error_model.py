"""Errors of the packaged detector and of the stereo matcher, as random processes that are correlated in time.

Fitted on rendered drives of the seeds 0 to 9, one scenario each (`benchmarks box_errors`, images 620 px wide, 10
frames/s), and checked on the seeds 20 to 29. Heights are in px of the network's input, which is 512 px wide.

Correlation of a latent value with itself after the time t, for all processes:
    c(t) = constant + slow exp(-t / tau)        and 1 for t = 0
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from track_range.foundation.arrays import FloatArray

NETWORK_WIDTH_PX = 512
"""Width of the packaged network's input for images of KITTI's shape, px."""


@dataclass(frozen=True, slots=True)
class Memory:
    """Correlation in time of a standard normal process: a constant, a slow part, and the rest without memory.

    Attributes:
        constant: fraction of the variance that is constant for an object.
        slow: fraction of the variance that decays with `tau_s`.
        tau_s: time constant, s.
    """

    constant: float
    slow: float
    tau_s: float

    def sample(self, rng: np.random.Generator, n_rows: int, n_frames: int, step_s: float) -> FloatArray:
        """(n_rows, n_frames) independent processes."""
        decay = float(np.exp(-step_s / self.tau_s))
        noise = rng.normal(size=(n_rows, n_frames))
        state = np.empty((n_rows, n_frames))
        value = rng.normal(size=n_rows)
        gain = np.sqrt(1 - decay**2)
        for frame in range(n_frames):
            value = decay * value + gain * noise[:, frame]
            state[:, frame] = value
        fast = max(1 - self.constant - self.slow, 0.0)
        white = rng.normal(size=(n_rows, n_frames))
        shared = rng.normal(size=(n_rows, 1))
        return np.asarray(np.sqrt(self.constant) * shared + np.sqrt(self.slow) * state + np.sqrt(fast) * white)


@dataclass(frozen=True, slots=True, kw_only=True)
class FalseBoxes:
    """Boxes without an object: static or moving phantoms with a distance, seen for a random time.

    Attributes:
        starts_hz: mean number of new phantoms per second.
        mean_frames: (share, mean number of frames at 10 frames/s) of brief, medium and long phantoms.
        mean_score: mean score above the detector's threshold of each of these.
        classes: (class id, share, median height in network px, log standard deviation, lateral centre, lateral spread)
            with the lateral position as fraction of the image width; a negative centre means both sides.
        moving_share: fraction that moves along the road, at up to the ego speed.
    """

    starts_hz: float = 9.5
    mean_frames: tuple[tuple[float, float], ...] = ((0.7, 1.15), (0.24, 4.0), (0.06, 22.0))
    mean_score: tuple[float, ...] = (0.03, 0.08, 0.15)
    classes: tuple[tuple[int, float, float, float, float, float], ...] = (
        (0, 0.36, 31.0, 0.33, -0.33, 0.09),
        (2, 0.55, 11.6, 0.5, 0.45, 0.11),
        (5, 0.07, 15.0, 0.4, 0.51, 0.04),
        (6, 0.02, 32.0, 0.3, -0.35, 0.1),
    )
    moving_share: float = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassErrors:
    """Errors of the boxes of one group of classes.

    Attributes:
        rate: probability of detection by height (rows, `HEIGHTS_PX`) and hidden fraction (columns, `HIDDEN`).
        outside_factor: factor on the probability by the fraction of the box outside the image (`OUTSIDE`).
        score: median score by height.
        bias: (4,) bias of centre x, centre y, log width, log height; centres relative to the height of the box.
        sigma: (4,) standard deviation for large boxes.
        sigma_px: (4,) additional standard deviation, px, divided by the height of the box.
    """

    rate: tuple[tuple[float, ...], ...]
    outside_factor: tuple[float, ...]
    score: tuple[float, ...]
    bias: tuple[float, ...]
    sigma: tuple[float, ...]
    sigma_px: tuple[float, ...]


HEIGHTS_PX = (6.6, 8.3, 11.6, 16.5, 26.4, 50.0)
"""Heights of the tables, network px; values between them are interpolated over the logarithm of the height."""

HIDDEN = (0.03, 0.25, 0.55, 0.9)
"""Hidden fractions of the tables."""

OUTSIDE = (0.0, 0.3, 0.6, 1.0)
"""Fractions of a box outside the image of `ClassErrors.outside_factor`."""

HIDDEN_SCORE = (0.0, -0.17, -0.2, -0.25)
"""Change of the median score by hidden fraction (`HIDDEN`)."""

PERSON = ClassErrors(
    rate=(
        (0.0, 0.0, 0.0, 0.0),
        (0.02, 0.0, 0.0, 0.0),
        (0.1, 0.02, 0.0, 0.0),
        (0.52, 0.2, 0.1, 0.0),
        (0.84, 0.6, 0.4, 0.1),
        (0.93, 0.8, 0.5, 0.2),
    ),
    outside_factor=(1.0, 0.95, 0.15, 0.0),
    score=(0.11, 0.12, 0.14, 0.2, 0.43, 0.56),
    bias=(-0.005, -0.015, -0.04, 0.06),
    sigma=(0.015, 0.035, 0.13, 0.1),
    sigma_px=(0.8, 0.8, 3.5, 1.4),
)
"""People and riders of bicycles and motorcycles."""

VEHICLE = ClassErrors(
    rate=(
        (0.65, 0.4, 0.2, 0.1),
        (0.82, 0.55, 0.3, 0.15),
        (0.91, 0.84, 0.65, 0.13),
        (0.95, 0.94, 0.85, 0.28),
        (0.975, 0.95, 0.88, 0.25),
        (0.98, 0.95, 0.88, 0.5),
    ),
    outside_factor=(1.0, 1.0, 0.9, 0.35),
    score=(0.3, 0.4, 0.6, 0.73, 0.75, 0.7),
    bias=(0.015, 0.0, -0.01, -0.02),
    sigma=(0.02, 0.01, 0.055, 0.03),
    sigma_px=(0.9, 0.95, 1.6, 1.5),
)
"""Cars, vans, trucks and buses."""

SIGN = ClassErrors(
    rate=tuple((rate, rate / 2, rate / 4, 0.0) for rate in (0.05, 0.11, 0.4, 0.7, 0.85, 0.9)),
    outside_factor=(1.0, 0.9, 0.3, 0.0),
    score=(0.12, 0.15, 0.2, 0.33, 0.4, 0.6),
    bias=(0.03, 0.05, 0.0, 0.09),
    sigma=(0.03, 0.05, 0.1, 0.1),
    sigma_px=(0.5, 0.8, 1.0, 1.0),
)
"""Signs and lights."""

SCORE_SIGMA, MIN_SCORE, MAX_SCORE = 0.16, 0.1, 0.92
"""Standard deviation of scores around the median of their height, and their range (the detector's threshold)."""

DETECTION_MEMORY = Memory(0.33, 0.6, 0.63)
"""Of the latent value that decides whether an object is detected, and with which score."""

EDGE_MEMORY = (Memory(0.05, 0.65, 0.5), Memory(0.15, 0.68, 0.55), Memory(0.25, 0.62, 0.5), Memory(0.12, 0.68, 0.5))
"""Of the errors of centre x, centre y, log width and log height."""

DETECTED_CLASS = {
    "Car": ((2, 1.0),),
    "Van": ((2, 0.9), (5, 0.1)),
    "Truck": ((5, 0.65), (2, 0.27), (4, 0.08)),
    "Bus": ((4, 0.6), (5, 0.25), (2, 0.15)),
    "Pedestrian": ((0, 1.0),),
    "Cyclist": ((0, 0.6), (1, 0.4)),
    "Motorcycle": ((3, 0.6), (0, 0.4)),
    "TrafficSign": ((7, 1.0),),
    "TrafficLight": ((6, 1.0),),
}
"""Detected class ids and their shares by KITTI type; a road user has one of them for about a second."""

CLASS_MEMORY = Memory(0.5, 0.45, 1.0)
"""Of the choice of the class."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoErrors:
    """Errors of the stereo matcher's disparities, in px of images 620 px wide.

    Attributes:
        rate: probability of a match of a detected box.
        far_sigma_px: median reported standard deviation of far objects, px.
        near_m: distance at which the reported standard deviation starts to grow with 1 / Z^2, m: near objects extend
            over many disparities.
        sigma_spread: standard deviation of the logarithm of the reported standard deviation.
        bias, scale: bias and standard deviation of errors, in reported standard deviations.
        outlier_rate, outlier_scale: fraction and standard deviation of outliers, in reported standard deviations.
        memory: of the errors.
    """

    rate: float = 0.97
    far_sigma_px: float = 0.075
    near_m: float = 22.0
    sigma_spread: float = 0.35
    bias: float = -0.23
    scale: float = 0.63
    outlier_rate: float = 0.04
    outlier_scale: float = 3.5
    memory: Memory = field(default_factory=lambda: Memory(0.22, 0.45, 0.5))
