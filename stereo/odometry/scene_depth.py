r"""SceneDepth: depth of the static scene as a rough measure of the speed where the road is hidden.

    V = g Z        g: expansion of the images (`ImageMotion`), Z: depth of the static points

The logarithm of Z is a random walk, which a Kalman filter follows while the road shows the speed:
within a drive, it changes by 10 to 20 % in some seconds. A shift of the road that would need a very
different depth is that of something else, such as a vehicle ahead that has no box.

The depth may also change at once: behind the last lamps of a junction, only clouds and hills have
corners. The dynamic of a car tells both apart (`SpeedFilter.expects`): if no car reaches the speed
by the depth from the last speed, the depth has changed.
"""

import math

from track_range.stereo.odometry.image_motion import ImageMotion
from track_range.stereo.odometry.speed_filter import SpeedFilter

# of drives in cities and on motorways, and the standard deviation of its logarithm
_USUAL_M, _USUAL_SIGMA = 30.0, 0.5
# random walk of the logarithm, per root of a second, and noise of the expansion of one frame; on
# KITTI's gray51 0.25 and 0.08, on simulated drives, seeds 700-703, 0.08 and 0.06
_DRIFT, _NOISE = 0.15, 0.1
_MAX_SIGMA = 0.45  # of the logarithm of a depth that shows a speed
_MAX_NOISE = 0.25  # relative one of an expansion that shows a speed: far clouds hardly expand
_OUTLIER_SIGMA = 3.0  # beyond which a speed does not fit the depth
_UNKNOWN_SIGMA = 3.0  # of the logarithm of a depth that changed at once: clouds, a wall
_RECEDING_SIGMA = 2.0  # of an expansion that is certainly negative
_MIN_SPEEDS = 5  # number of speeds that a depth needs: a single one may be wrong


class SceneDepth:
    """Depth of the static scene of one stream, in the unit of length of the speeds; the state
    belongs to the instance.
    """

    def __init__(self) -> None:
        self._log_depth, self._variance = math.log(_USUAL_M), _USUAL_SIGMA**2
        self._n_speeds = 0

    def checked(
        self, motion: ImageMotion, by_road: tuple[float, float, float], before: SpeedFilter
    ) -> tuple[float, float, float]:
        """A speed by the road with its standard deviations, of the frame and lasting, if it fits
        the images of the next frame, or else the speed by the depth of the scene, if a car reaches
        it from the speeds `before`; NaN = neither.
        """
        by_depth = self.speed(motion)
        if by_road[0] > 0 and self.fits(motion, by_road[0]):
            return by_road
        middle_s = motion.time_s - motion.dt_s / 2
        # also for NaN
        if not by_depth[0] >= 0 or before.expects(middle_s, *by_depth):
            return by_depth
        self._variance, self._n_speeds = _UNKNOWN_SIGMA**2, 0
        if before.expects(middle_s, *by_road) and self.fits(motion, by_road[0]):
            return by_road
        return math.nan, math.nan, math.nan

    def speed(self, motion: ImageMotion) -> tuple[float, float, float]:
        """Speed by the motion of the next frame, its standard deviation in this frame, and the one
        that lasts; NaN = unknown.
        """
        drifted = min(self._variance + _DRIFT**2 * motion.dt_s, _USUAL_SIGMA**2)
        self._variance = max(self._variance, drifted)
        sigma = math.sqrt(self._variance)
        speed_mps = motion.expansion_hz * math.exp(self._log_depth)
        # False for NaN
        is_known = self._n_speeds >= _MIN_SPEEDS and sigma < _MAX_SIGMA
        if not (is_known and speed_mps > 0 and _noise(motion) < _MAX_NOISE):
            return math.nan, math.nan, math.nan
        return speed_mps, _noise(motion) * speed_mps, sigma * speed_mps

    def fits(self, motion: ImageMotion, speed_mps: float) -> bool:
        """Whether a speed by the road fits the expansion of the images; such a speed is learnt."""
        if not (motion.expansion_hz > 0 and speed_mps > 0):
            # a camera that moves backwards; False for NaN
            return not motion.expansion_hz < -_RECEDING_SIGMA * motion.expansion_sigma_hz
        innovation = math.log(speed_mps / motion.expansion_hz) - self._log_depth
        noise = _noise(motion) ** 2
        total = self._variance + noise
        if innovation**2 > _OUTLIER_SIGMA**2 * total:
            return False
        self._log_depth += self._variance / total * innovation
        self._variance *= noise / total
        self._n_speeds += 1
        return True


def _noise(motion: ImageMotion) -> float:
    """Relative standard deviation of the expansion of a frame."""
    return math.hypot(_NOISE, motion.expansion_sigma_hz / motion.expansion_hz)
