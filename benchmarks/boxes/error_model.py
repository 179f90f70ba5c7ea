"""Errors of the packaged detector and of the stereo matcher, as random processes that are
correlated in time.

Boxes, scores and classes: fitted on rendered drives of the seeds 0 to 9, 11 and 15, one scenario
each (that of `benchmarks box_errors`, images 620 px wide, 10 frames/s), with the detector's second
edition. Stereo and appearance: on the seeds 0 to 9. Heights are in px of the network's input, which
is 512 px wide.

Correlation of a latent value with itself after the time t, for all processes:
    c(t) = constant + slow exp(-t / tau)        and 1 for t = 0
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from track_range.foundation.arrays import FloatArray

NETWORK_WIDTH_PX = 512  # width of the packaged network's input for images of KITTI's shape, px


@dataclass(frozen=True, slots=True)
class Memory:
    """Correlation in time of a standard normal process: a constant, a slow part, and the rest
    without memory.
    """

    constant: float  # fraction of the variance that is constant for an object
    slow: float  # fraction of the variance that decays with `tau_s`
    tau_s: float  # time constant, s

    def sample(
        self, rng: np.random.Generator, n_rows: int, n_frames: int, step_s: float
    ) -> FloatArray:
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
        return np.asarray(
            np.sqrt(self.constant) * shared + np.sqrt(self.slow) * state + np.sqrt(fast) * white
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FalseBoxes:
    """Boxes without an object: poles, trees and walls that the detector takes for road users for
    some frames.

    All are fixed in the world. On the fitted drives nine in ten are detected in one frame only.
    (Small boxes at the horizon, which look like them, belong to real vehicles at 90 to 150 m.)
    """

    starts_hz: float = 5.5  # mean number of new false boxes per second
    # (fraction, mean number of frames at 10 frames/s) of brief and longer ones
    mean_frames: tuple[tuple[float, float], ...] = ((0.91, 1.03), (0.09, 4.0))
    mean_score: float = 0.185  # mean score above the detector's threshold
    # (class id, fraction, median height in network px, log standard deviation, lateral offset of
    # the median from the image centre, lateral spread), lateral positions in image widths, on both
    # sides
    classes: tuple[tuple[int, float, float, float, float, float], ...] = (
        (0, 0.62, 22.5, 0.45, 0.28, 0.11),
        (2, 0.1, 6.0, 0.8, 0.05, 0.18),
        (5, 0.01, 78.0, 0.9, 0.2, 0.1),
        (6, 0.06, 19.0, 0.3, 0.38, 0.07),
        (7, 0.21, 9.0, 0.5, 0.17, 0.14),
    )
    # median and log standard deviation of the stereo distance, relative to the distance at which an
    # object of the class has the height of the box
    distance: tuple[float, float] = (1.05, 0.45)
    raised: float = 0.26  # height of the lower edge above the road, in heights of the camera


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondBoxes:
    """Second boxes of vehicles that have a box already: shifted, or of the vehicle together with
    its neighbour.
    """

    # rate, overlap_rate: probability per detected vehicle, alone and with another vehicle's box
    # overlapping
    rate: float = 0.03
    overlap_rate: float = 0.09
    # fraction of the box inside another vehicle's box from which it counts as overlapping
    min_overlap: float = 0.02
    # near_px, near_factor: height from which boxes are rarer, network px, and the factor
    near_px: float = 33.0
    near_factor: float = 0.3
    mean_score: float = 0.125  # mean score above the detector's threshold
    # (4,) standard deviations of centre x and centre y, relative to width and height, log width,
    # log height
    sigma: tuple[float, float, float, float] = (0.27, 0.13, 0.36, 0.22)
    distance_sigma: float = 0.1  # log standard deviation of the distance relative to the vehicle's
    # largest IoU with the vehicle's first box: that of the detector's non-maximum suppression
    max_iou: float = 0.5
    # presence, offset: correlation in time of the latent value that decides about the box, and of
    # its errors and score
    presence: Memory = field(default_factory=lambda: Memory(0.4, 0.4, 0.4))
    offset: Memory = field(default_factory=lambda: Memory(0.4, 0.35, 0.4))


@dataclass(frozen=True, slots=True, kw_only=True)
class AppearanceErrors:
    """Embeddings that have the cosine distances of the built-in appearance model between boxes of
    rendered drives.

    Measured medians: 0.187 between two vehicles (0.084 and 0.35 at 10 and 90 %), and of one vehicle
    0.018, 0.024, 0.035 and 0.051 after 0.1, 0.3, 1 and 3 s.
    """

    # number of components that differ between objects; it determines the spread of the distances
    n_values: int = 7
    object_sigma: float = 0.2  # standard deviation of a component between objects
    sigma: float = 0.094  # standard deviation of a component between boxes of one object
    memory: Memory = field(default_factory=lambda: Memory(0.0, 0.7, 1.7))  # of the latter


CAMERA_MOTION_SIGMA_PX = 0.1
"""Standard deviation of the estimated image motion of the background, px of images 620 px wide."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassErrors:
    """Errors of the boxes of one group of classes."""

    # probability of detection by height (rows, `HEIGHTS_PX`) and hidden fraction (columns,
    # `HIDDEN`)
    rate: tuple[tuple[float, ...], ...]
    # factor on the probability by the fraction of the box outside the image (`OUTSIDE`)
    outside_factor: tuple[float, ...]
    score: tuple[float, ...]  # median score by height
    # (4,) bias of centre x, centre y, log width, log height; centres relative to the height of the
    # box
    bias: tuple[float, ...]
    sigma: tuple[float, ...]  # (4,) standard deviation for large boxes
    # (4,) additional standard deviation, px, divided by the height of the box
    sigma_px: tuple[float, ...]


HEIGHTS_PX = (3.7, 5.0, 6.6, 8.3, 11.6, 16.5, 26.4, 50.0)
"""Heights of the tables, network px; values between them are interpolated over the logarithm of the
height."""

HIDDEN = (0.03, 0.25, 0.55, 0.9)  # hidden fractions of the tables
# fractions of a box outside the image of `ClassErrors.outside_factor`
OUTSIDE = (0.0, 0.3, 0.6, 1.0)
# change of the median score by hidden fraction (`HIDDEN`)
HIDDEN_SCORE = (0.0, -0.01, -0.17, -0.28)

HIDDEN_SIGMA = ((0.0, 0.07, 0.19, 0.16), (0.0, 0.1, 0.22, 0.21))
"""Additional standard deviation of centre x and log width of vehicles by hidden fraction
(`HIDDEN`): their boxes are those of the visible part, or include the occluder."""

PERSON = ClassErrors(
    rate=(
        (0.0, 0.0, 0.0, 0.0),
        (0.07, 0.0, 0.0, 0.0),
        (0.27, 0.05, 0.02, 0.01),
        (0.47, 0.12, 0.09, 0.02),
        (0.84, 0.4, 0.11, 0.0),
        (0.98, 0.82, 0.17, 0.01),
        (0.99, 0.85, 0.4, 0.02),
        (0.97, 0.85, 0.5, 0.12),
    ),
    outside_factor=(1.0, 0.95, 0.2, 0.0),
    score=(0.1, 0.12, 0.16, 0.37, 0.6, 0.78, 0.89, 0.82),
    bias=(-0.003, -0.005, 0.0, 0.03),
    sigma=(0.01, 0.02, 0.11, 0.05),
    sigma_px=(0.3, 0.75, 1.2, 1.3),
)
"""People and riders of bicycles and motorcycles."""

VEHICLE = ClassErrors(
    rate=(
        (0.38, 0.27, 0.3, 0.02),
        (0.75, 0.6, 0.33, 0.07),
        (0.85, 0.77, 0.46, 0.23),
        (0.86, 0.76, 0.49, 0.24),
        (0.92, 0.84, 0.61, 0.22),
        (0.985, 0.98, 0.8, 0.3),
        (0.99, 0.99, 0.8, 0.2),
        (0.995, 0.99, 0.8, 0.28),
    ),
    outside_factor=(1.0, 0.99, 0.95, 0.7),
    score=(0.35, 0.6, 0.77, 0.9, 0.94, 0.96, 0.98, 0.98),
    bias=(0.002, -0.004, 0.002, 0.005),
    sigma=(0.016, 0.006, 0.02, 0.016),
    sigma_px=(0.42, 0.38, 0.8, 0.65),
)
"""Cars, vans, trucks and buses."""

SIGN = ClassErrors(
    rate=tuple(
        (rate, rate / 2, rate / 4, 0.0) for rate in (0.17, 0.47, 0.71, 0.79, 0.85, 0.88, 0.85, 0.85)
    ),
    outside_factor=(1.0, 0.9, 0.3, 0.0),
    score=(0.22, 0.27, 0.46, 0.46, 0.45, 0.63, 0.77, 0.77),
    bias=(0.01, 0.02, 0.03, 0.05),
    sigma=(0.02, 0.02, 0.05, 0.03),
    sigma_px=(0.35, 0.6, 0.75, 0.9),
)
"""Signs and lights."""

SMALLEST_HEIGHT_PX = 4.3
"""Height m of the boxes of the smallest detected vehicles, network px: those of height h have boxes
(h^4 + m^4)^(1/4) high."""

SCORE_SIGMA, MIN_SCORE, MAX_SCORE = 1.1, 0.1, 0.99
"""Standard deviation of the logit of scores around the median of their height, and their range (the
detector's threshold)."""

DETECTION_MEMORY = Memory(0.33, 0.6, 0.63)
"""Of the latent value that decides whether an object is detected, and with which score."""

EDGE_MEMORY = (
    Memory(0.2, 0.42, 0.5),
    Memory(0.52, 0.22, 0.4),
    Memory(0.4, 0.34, 0.8),
    Memory(0.52, 0.22, 0.5),
)
"""Of the errors of centre x, centre y, log width and log height."""

DETECTED_CLASS = {
    "Car": ((2, 1.0),),
    "Van": ((2, 0.89), (5, 0.09), (4, 0.02)),
    "Truck": ((5, 0.91), (2, 0.06), (4, 0.03)),
    "Bus": ((4, 0.95), (5, 0.05)),
    "Pedestrian": ((0, 0.98), (1, 0.02)),
    "Cyclist": ((0, 0.5), (1, 0.5)),
    "Motorcycle": ((3, 0.6), (0, 0.4)),
    "TrafficSign": ((7, 1.0),),
    "TrafficLight": ((6, 1.0),),
}
"""Detected class ids and their shares by KITTI type; a road user has one of them for about a
second."""

CLASS_MEMORY = Memory(0.5, 0.45, 1.0)  # of the choice of the class


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoErrors:
    """Errors of the stereo matcher's disparities, in px of images 620 px wide."""

    rate: float = 0.97  # probability of a match of a detected box
    far_sigma_px: float = 0.075  # median reported standard deviation of far objects, px
    # distance at which the reported standard deviation starts to grow with 1 / Z^2, m: near objects
    # extend over many disparities
    near_m: float = 22.0
    # standard deviation of the logarithm of the reported standard deviation
    sigma_spread: float = 0.35
    # bias, scale: bias and standard deviation of errors, in reported standard deviations
    bias: float = -0.23
    scale: float = 0.5
    # outlier_rate, outlier_scale: fraction and standard deviation of outliers, in reported standard
    # deviations
    outlier_rate: float = 0.02
    outlier_scale: float = 3.5
    memory: Memory = field(default_factory=lambda: Memory(0.39, 0.24, 0.6))  # of the errors
    # probability by hidden fraction (`HIDDEN`) that the distance is the occluder's
    occluder_rate: tuple[float, ...] = (0.0, 0.06, 0.3, 0.5)
    occluder_memory: Memory = field(default_factory=lambda: Memory(0.4, 0.4, 0.5))  # of that
