"""SceneMotion: focal length and distortion of one camera from the images of a drive.

Corners are tracked, keyframes are divided into scenes of two seconds, and all scenes together give
the profile likelihood of the focal length (`focal_profile`). A turn moves far points by
f tan(angle), and the images of near points tell the turn from a sideways motion; on a straight road
the focal length and the depth of everything are interchangeable, and the likelihood is flat.

Rows that are read out one after another see a turning camera at different times. The readout is a
parameter of the bundle with a usual prior, which a turn or a bumpy road narrows to some ms, and
sigma contains it with the noise of the tracks and the errors that they have in common.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from track_range.foundation.arrays import FloatArray, Image
from track_range.stereo.geometry.focal_curve import FocalCurve
from track_range.stereo.self_calibration.common_errors import pattern_sigma
from track_range.stereo.self_calibration.corner_tracks import MAX_GAP_S, CornerTracks, KeyPoints
from track_range.stereo.self_calibration.focal_profile import (
    FOCAL_RANGE,
    FocalProfile,
    focal_profile,
    observed_points,
    started_scene,
)
from track_range.stereo.self_calibration.radial_lens import K1, LOG_FOCAL, READOUT, RadialLens
from track_range.stereo.self_calibration.scene_bundle import Observed, SceneBundle

N_KEYFRAMES = 12  # of a scene
_MIN_KEYFRAMES = 6
_MAX_PARTS = 5  # scenes that are used, those with the largest turns
# Errors of a whole image are common to all of its strips: factor of the sigma of common errors, and
# the smallest sigma, for which the errors of simulated drives (seeds 700 to 711) are within 1 and 2
# sigma as often as normal ones.
_COMMON_FACTOR, _LEAST_SIGMA = 2.0, 0.008
_LEAST_K1_SIGMA = 0.002
_N_GRID = 400  # focal lengths of the likelihood


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionEstimate:
    """The lens of one camera from the motion of the static scene, in pixels of the given images.

    The likelihood is the profile over everything but the focal length, widened to the errors that
    tracks have in common.
    """

    curve: FocalCurve
    focal_px: float  # mean of the likelihood over the logarithm
    sigma: float  # relative standard deviation of the focal length; above 0.3 it is unknown
    coefficients: tuple[float, ...]  # OpenCV's, of the distortion
    k1_sigma: float  # standard deviation of the first radial coefficient of their series
    readout_s: float  # time in which the rows of an image are read out
    turn_deg: float  # largest change of the heading in a scene
    span_s: tuple[float, float]  # first and last time of that scene
    n_points: int  # tracked static points


class SceneMotion:
    """Accumulates the images of one camera.

    Example:
        >>> motion = SceneMotion((1280, 720), start_px=1100.0)
        >>> motion.estimate() is None
        True
    """

    def __init__(self, size_px: tuple[int, int], *, start_px: float) -> None:
        """`size_px` is (width, height); `start_px` is a focal length from which the fit starts."""
        self._size_px, self._start_px = size_px, start_px
        self._tracks = CornerTracks(size_px)
        self._scale = 2.0**self._tracks.n_halved
        self._keyframes: list[KeyPoints] = []
        self._parts: list[_Part] = []

    def add(self, image: Image, time_s: float, xyxy_px: FloatArray) -> None:
        """Add the next image, (H, W) grey or (H, W, 3) BGR, with boxes (N, 4) of its road users."""
        key_points = self._tracks.add(image, time_s, xyxy_px)
        if key_points is not None:
            self.add_points(key_points)

    def add_points(self, key_points: KeyPoints) -> None:
        """Add the points of the next keyframe, as `add` adds images."""
        if self._keyframes and key_points.time_s - self._keyframes[-1].time_s > MAX_GAP_S:
            self._close()
            self._keyframes = []
        self._keyframes.append(key_points)
        if len(self._keyframes) == N_KEYFRAMES:
            self._close()
            self._keyframes = [key_points]

    def estimate(self) -> MotionEstimate | None:
        """The estimate from the images so far; None if nothing was tracked."""
        parts = _largest_turns([*self._parts, *_part_of(self._keyframes, self._small_px[1])])
        started = [part.started(self._start) for part in parts]
        scenes = [scene for scene in started if scene is not None]
        if not scenes:
            return None
        profile = focal_profile(scenes, self._start, self._small_px[0])
        return None if profile is None else self._estimate(profile)

    @property
    def _small_px(self) -> tuple[int, int]:
        """Width and height of the tracked images."""
        width_px, height_px = self._size_px
        return width_px >> self._tracks.n_halved, height_px >> self._tracks.n_halved

    @property
    def _start(self) -> RadialLens:
        return RadialLens.of_focal_length(self._start_px / self._scale, self._small_px)

    def _close(self) -> None:
        self._parts = _largest_turns([*self._parts, *_part_of(self._keyframes, self._small_px[1])])

    def _estimate(self, profile: FocalProfile) -> MotionEstimate:
        lowest, highest = np.log(np.array(FOCAL_RANGE) * self._small_px[0]).tolist()
        log_focal = np.linspace(lowest, highest, _N_GRID)
        log_likelihood = -interpolated(profile, log_focal) / (2 * _widening(profile))
        curve = FocalCurve(log_focal + math.log(self._scale), log_likelihood)
        mean = float(curve.density @ curve.log_focal)
        sigma = math.sqrt(float(curve.density @ (curve.log_focal - mean) ** 2))
        sigma_of = np.sqrt(np.diag(profile.covariance.common))
        widest = max(profile.fit.scenes, key=lambda scene: abs(scene.turn_deg))
        return MotionEstimate(
            curve=curve,
            focal_px=math.exp(mean),
            sigma=sigma,
            coefficients=profile.fit.lens.opencv_distortion(),
            k1_sigma=math.hypot(_COMMON_FACTOR * sigma_of[K1], _LEAST_K1_SIGMA),
            readout_s=float(profile.fit.lens.parameters[READOUT]),
            turn_deg=abs(widest.turn_deg),
            span_s=widest.span_s,
            n_points=sum(len(scene.ray) for scene in profile.fit.scenes),
        )


@dataclass(slots=True)
class _Part:
    """The observations of some seconds; the scene is started when it is first needed."""

    observed: Observed
    span_s: tuple[float, float]
    turn_px: float  # range of the sums of the median flow
    scene: SceneBundle | None = None
    is_started: bool = False

    def started(self, lens: RadialLens) -> SceneBundle | None:
        """The scene at the start of the fit; None if no motion fits its points."""
        if not self.is_started:
            self.scene = started_scene(self.observed, lens, self.span_s)
            self.is_started = True
        return self.scene


def _part_of(keyframes: Sequence[KeyPoints], height_px: int) -> list[_Part]:
    """The part of some keyframes, or none if there are too few."""
    if len(keyframes) < _MIN_KEYFRAMES:
        return []
    observed = observed_points(keyframes, height_px)
    if observed is None:
        return []
    flow_px = np.stack([observed.median_flow_px(frame) for frame in range(1, len(keyframes))])
    moved_px = np.concatenate([np.zeros((1, 2)), np.cumsum(flow_px, axis=0)])
    span_s = keyframes[0].time_s, keyframes[-1].time_s
    return [_Part(observed, span_s, float(np.ptp(moved_px, axis=0).max()))]


def _largest_turns(parts: Sequence[_Part]) -> list[_Part]:
    """The parts with the largest turns, in the order of time."""
    turned = sorted(parts, key=lambda part: part.turn_px)[-_MAX_PARTS:]
    return sorted(turned, key=lambda part: part.span_s)


def _widening(profile: FocalProfile) -> float:
    """Variance of the focal length with common errors of the points, over that without."""
    independent, common = (part[LOG_FOCAL, LOG_FOCAL] for part in profile.covariance)
    pattern = pattern_sigma(profile.fit.scenes, profile.fit.lens) ** 2
    variance = max(independent, _COMMON_FACTOR**2 * common) + pattern + _LEAST_SIGMA**2
    return float(variance / independent)


def interpolated(profile: FocalProfile, log_focal: FloatArray) -> FloatArray:
    """(G,) costs at other focal lengths: monotone between those of the profile, straight beyond."""
    x, cost = profile.log_focal, profile.cost
    inside = PchipInterpolator(x, cost)(np.clip(log_focal, x[0], x[-1]))
    low = (cost[0] - cost[1]) / (x[1] - x[0]) * np.maximum(x[0] - log_focal, 0.0)
    high = (cost[-1] - cost[-2]) / (x[-1] - x[-2]) * np.maximum(log_focal - x[-1], 0.0)
    return np.asarray(inside + np.maximum(low, 0.0) + np.maximum(high, 0.0))
