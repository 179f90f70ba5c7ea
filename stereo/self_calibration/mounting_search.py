r"""MountingSearch: where a camera looks in its vehicle, from the motion of its images.

A vehicle drives along its axis, so that the direction of travel in the camera's axes shows the
mounting. The epipolar geometry between two frames (`fit_epipolar`) has several minima: it is fitted
from directions all around, and from the camera's axis. A direction beside the axis needs a clearly
lower cost, in which each point counts

    min((residual / sigma)^2, 9)

The points move as by one of both signs, which tells the front from the rear. Each pair of frames
has one vote: what moves through the view, like a lorry before a camera at rest, has the vote of some
seconds, not of all.
"""

import math

import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.robust_statistics import MAD_TO_SIGMA
from track_range.foundation.sparse_flow import BackgroundFlow
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import AHEAD_DEG, Mounting
from track_range.stereo.odometry.image_motion import EpipolarFit, fit_epipolar, tracked_rays

PAIR_S = 0.1  # time between the images, whatever the frame rate
MIN_ASIDE_S = 4.0  # shortest motion that shows a camera which looks aside
_NO_BOXES = np.zeros((0, 4))  # what moves by itself is outvoted
# angles of the directions from which the fit starts; the opposite ones are those of the other sign
_STARTS_DEG = (-75.0, -45.0, -15.0, 15.0, 45.0, 75.0)
# standard deviation of the direction about the axis, as of cameras that look ahead, and about the
# other starts: half of their spacing
_AXIS_RAD, _START_RAD = 0.1, 0.26
# cost per point by which a direction must be better than the axis: 0 to 0.35 of cameras that look
# ahead, 2 to 4 of others (simulated drives, seeds 700 to 703, and PandaSet)
_MIN_GAIN = 0.5
_MIN_POINTS, _MIN_STATIC, _MIN_MOVED_PX = 30, 0.4, 0.5  # of a pair that has a vote
_MIN_VOTES, _MIN_VOTES_ASIDE = 20, round(MIN_ASIDE_S / PAIR_S)
_AGREED_DEG, _MIN_AGREED = 15.0, 0.8  # largest difference of votes that agree, and their fraction
# standard deviation of the angle by what all pairs share: slip in turns, the principal point
_COMMON_DEG = 1.5


class MountingSearch:
    """Finds the direction of travel in the images of one camera without distortion, `PAIR_S`
    apart; the state belongs to the instance.
    """

    def __init__(self, camera: PinholeCamera, focal_sigma: float = 0.0) -> None:
        """`focal_sigma` is the relative standard deviation of the camera's focal length."""
        self._camera, self._focal_sigma = camera, focal_sigma
        self._flow = BackgroundFlow()
        self._votes: list[FloatArray] = []

    def add(self, image: Image, time_s: float) -> None:
        """Use the next image, (H, W, 3) BGR or (H, W) grey."""
        self._flow.add(image, _NO_BOXES, time_s)
        before, now, focal_px = tracked_rays(self._flow, self._camera)
        if len(before) < _MIN_POINTS:
            return
        best = self._fit(before, now, focal_px, 0.0, _AXIS_RAD)
        if best.cost > _MIN_GAIN:
            fits = [self._fit(before, now, focal_px, yaw, _START_RAD) for yaw in _STARTS_DEG]
            aside = min(fits, key=lambda fit: fit.cost)
            best = aside if best.cost - aside.cost > _MIN_GAIN else best
        if best.is_static.mean() > _MIN_STATIC and focal_px * best.moved > _MIN_MOVED_PX:
            self._votes.append(-best.direction)

    @property
    def mounting(self) -> Mounting | None:
        """The mounting whose roll and pitch are the smallest that fit; None = not shown so far, or
        not sure to look along the drive or aside.
        """
        if len(self._votes) < _MIN_VOTES:
            return None
        votes = np.array(self._votes)
        travel = np.median(votes, axis=0)
        travel /= np.linalg.norm(travel)
        off_deg = np.degrees(np.arccos(np.clip(votes @ travel, -1.0, 1.0)))
        if (off_deg < _AGREED_DEG).mean() < _MIN_AGREED:
            return None
        yaw, down = math.atan2(travel[0], travel[2]), math.asin(travel[1])
        motion_s = max(PAIR_S * len(votes), 1.0)  # errors are alike for a second
        scatter_deg = MAD_TO_SIGMA * float(np.median(off_deg)) / math.sqrt(motion_s)
        by_focal = self._focal_sigma * math.sin(2 * yaw) / 2  # tan(yaw) is inverse to it
        mounting = Mounting(
            yaw_deg=math.degrees(yaw),
            pitch_deg=math.degrees(-down * math.cos(yaw)),
            roll_deg=math.degrees(-down * math.sin(yaw)),
            sigma_deg=math.hypot(_COMMON_DEG, scatter_deg, math.degrees(by_focal)),
        )
        off_axis_deg = abs(mounting.yaw_deg) - 2 * mounting.sigma_deg
        is_aside = len(votes) >= _MIN_VOTES_ASIDE and off_axis_deg > AHEAD_DEG
        return mounting if mounting.is_ahead or is_aside else None

    def _fit(
        self, before: FloatArray, now: FloatArray, focal_px: float, yaw_deg: float, sigma: float
    ) -> EpipolarFit:
        axes = Mounting(yaw_deg=yaw_deg).travel_from_camera
        return fit_epipolar(
            before,
            now,
            direction=-axes[2],
            direction_variance=np.full(2, sigma**2),
            travel_from_camera=axes,
            focal_px=focal_px,
        )
