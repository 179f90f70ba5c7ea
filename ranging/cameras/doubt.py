"""Doubt: which given values the drive contradicts, and the errors of distances and speeds that
follow.
"""

import math
from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace
from typing import Self

from track_range.ranging.cameras.causes import ScaleDoubt, causes_of
from track_range.ranging.cameras.unknowns import Unknown
from track_range.ranging.measurement.rig_scale import CALIBRATED, RigScale
from track_range.ranging.registry import methods
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion

_OF_ODOMETRY: frozenset[Unknown] = frozenset({Unknown.BASELINE, Unknown.FOCAL, Unknown.HEIGHT})


@dataclass(frozen=True, slots=True)
class Doubt:
    """What is in doubt after a frame; `Doubt()` is none."""

    scale: ScaleDoubt | None = None  # the contradiction; None = none was found
    # relative standard deviations that cover both scales, by cause
    sigma: Mapping[Unknown, float] = field(default_factory=dict)
    # relative standard deviations of errors that neither fusion nor filters reduce, by the name of
    # the distance: of the calibration, and of the doubt
    shared_sigma: Mapping[str, float] = field(default_factory=dict)
    trusts_speed: bool = True  # False = only the given speed is in doubt, and it is not used

    @classmethod
    def of(cls, scale: ScaleDoubt) -> Self:
        """The doubt by a contradiction, without the errors of distances."""
        return cls(scale, scale.sigma_by_cause, trusts_speed=scale.cause_names != [Unknown.SPEED])

    def sigma_of(self, causes: Set[Unknown]) -> float:
        """Relative standard deviation of what any of these causes changes."""
        return max((sigma for cause, sigma in self.sigma.items() if cause in causes), default=0.0)

    def widened(self, ego: Ego) -> EgoMotion:
        """The motion of the camera with the doubt: odometry has the scale of the cameras."""
        motion = ego.motion
        if self.scale is None or ego.given is not None:
            return motion
        in_doubt_mps = self.sigma_of(_OF_ODOMETRY) * motion.speed_mps
        return replace(motion, speed_sigma_mps=math.hypot(motion.speed_sigma_mps, in_doubt_mps))


class SharedErrors:
    """Errors that the frames of a drive share, by the error sources that the methods declare."""

    def __init__(self, calibration_sigma: float, *, has_rig: bool) -> None:
        """`calibration_sigma` is the relative error of all distances; `has_rig`: of a pair."""
        self._calibration_sigma = calibration_sigma
        self._causes = {
            method.name: causes_of(
                [source.name for source in method.error_sources], has_rig=has_rig
            )
            for method in methods()
        }
        scale_source = "baseline" if has_rig else "horizon"
        self._causes["fused"] = causes_of([scale_source], has_rig=has_rig)

    def doubt(self, scale: ScaleDoubt | None, rig: RigScale = CALIBRATED) -> Doubt:
        """The doubt by a contradiction, None = none was found, with the scale of a pair."""
        of_rig = self._calibration_sigma
        if rig != CALIBRATED and rig.is_known:
            of_rig = rig.sigma  # with the focal length
        known = {
            name: of_rig if Unknown.BASELINE in causes else self._calibration_sigma
            for name, causes in self._causes.items()
        }
        if scale is None:
            return Doubt(shared_sigma=known)
        doubt = Doubt.of(scale)
        unused = frozenset[Unknown]() if doubt.trusts_speed else frozenset[Unknown]({Unknown.SPEED})
        shared_sigma = {
            name: math.hypot(known[name], doubt.sigma_of(causes - unused))
            for name, causes in self._causes.items()
        }
        return replace(doubt, shared_sigma=shared_sigma)
