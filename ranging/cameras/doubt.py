"""Doubt: how wrong distances and speeds may be by the cameras, and which given values the drive
contradicts.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Self

from track_range.ranging.cameras.causes import ScaleDoubt
from track_range.ranging.cameras.learnt_focal import FocalEstimate
from track_range.ranging.cameras.posterior import CameraPosterior
from track_range.ranging.cameras.unknowns import OF_FOCAL, OF_PAIR, CameraPriors, Sum, Unknown
from track_range.ranging.measurement.focal_scale import FocalScale
from track_range.ranging.measurement.rig_scale import RigScale
from track_range.ranging.registry import methods
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion

_OF_SPEED: Sum = {Unknown.SPEED: 1.0}
_OF_ROAD: Sum = {Unknown.HEIGHT: -1.0, Unknown.FOCAL: 1.0}
_OF_TIMES: Sum = {Unknown.FRAME_RATE: 1.0}
_AS_GIVEN = DriveScale()

Errors = Mapping[str, tuple[Sum, ...]]
"""By the name of a distance, the sums of unknowns of which one is what it is too large by."""


@dataclass(frozen=True, slots=True)
class Doubt:
    """What is in doubt after a frame; `Doubt()` is nothing."""

    scale: ScaleDoubt | None = None  # the contradiction; None = none was found
    # relative standard deviations of errors that neither fusion nor filters reduce, by the name of
    # the distance
    shared_sigma: Mapping[str, float] = field(default_factory=dict)
    # the same of speeds of the camera: measured from the images, and as given
    odometry_sigma: float = 0.0
    given_sigma: float = 0.0
    closing_sigma: float = 0.0  # the same of closing speeds: of the fused distance and the times
    # height of the camera above the road and its standard deviation, as the drive shows it; None =
    # as assumed
    height_m: tuple[float, float] | None = None
    focal: FocalEstimate | None = None  # a focal length that was not given; None = it was

    @property
    def trusts_speed(self) -> bool:
        """Whether a given speed is used: False = only the given speed is in doubt."""
        return self.scale is None or self.scale.cause_names != [Unknown.SPEED]

    @classmethod
    def of(
        cls,
        cameras: CameraPosterior,
        errors: Errors,
        scale: ScaleDoubt | None = None,
        corrected: DriveScale = _AS_GIVEN,
    ) -> Self:
        """The doubt by what the drive shows of the cameras, for lengths that are `corrected` by the
        scales of a pair, of the road and of the focal length.
        """
        rig, focal = corrected.rig, corrected.focal
        unused = set[Unknown]()
        if scale is not None and scale.cause_names == [Unknown.SPEED]:
            unused = {Unknown.SPEED}

        @cache
        def sigma_of(coefficients: tuple[tuple[Unknown, float], ...]) -> float:
            of = dict(coefficients)
            if of == OF_PAIR:
                return _sigma_of_pair(cameras, rig, focal)
            corrected = of.get(Unknown.FOCAL, 0.0) * focal.log_factor
            return cameras.sigma_of({k: v for k, v in of.items() if k not in unused}, corrected)

        def largest(sums: Sequence[Sum]) -> float:
            return max((sigma_of(tuple(of.items())) for of in sums), default=0.0)

        of_odometry, by_odometry = _OF_ROAD, corrected.road
        if Unknown.BASELINE in cameras.unknowns:
            of_odometry, by_odometry = OF_PAIR, rig
        # what is corrected has the error of its correction
        odometry_sigma = 0.0 if by_odometry.sigma else largest([of_odometry])
        # speeds by images have the error of the times, too
        times_sigma = cameras.sigma_of(_OF_TIMES)
        return cls(
            scale,
            {name: largest(sums) for name, sums in errors.items()},
            math.hypot(odometry_sigma, times_sigma),
            cameras.sigma_of(_OF_SPEED),
            math.hypot(largest(errors.get("fused", ())), times_sigma),
        )

    def zoomed(self, focal_change: float) -> Self:
        """The doubt with a relative change of the focal length of both cameras that is not
        corrected.
        """
        if focal_change == 0.0:
            return self
        return replace(
            self,
            shared_sigma={
                name: math.hypot(sigma, focal_change) for name, sigma in self.shared_sigma.items()
            },
            odometry_sigma=math.hypot(self.odometry_sigma, focal_change),
        )

    def widened(self, ego: Ego, motion: EgoMotion) -> EgoMotion:
        """The `motion` of the camera, as it is corrected, with the errors of its scale."""
        is_given = ego.given is not None and ego.trusts_given
        sigma = self.given_sigma if is_given else self.odometry_sigma
        if not sigma:
            return motion
        speed_sigma_mps = math.hypot(motion.speed_sigma_mps, sigma * motion.speed_mps)
        right_sigma_mps = math.hypot(motion.right_sigma_mps, sigma * motion.right_mps)
        return replace(motion, speed_sigma_mps=speed_sigma_mps, right_sigma_mps=right_sigma_mps)


def _sigma_of_pair(cameras: CameraPosterior, rig: RigScale, focal: FocalScale) -> float:
    """Relative standard deviation that all lengths of a pair share, after their correction."""
    if not rig.is_known:
        return 0.0  # nothing is measured
    log_factor = rig.log_factor + focal.log_factor
    if rig.offset is None:
        return cameras.sigma_of(OF_PAIR, log_factor)
    # at the disparity at which the scale is known best; the rest is in each distance
    centre = rig.offset.centre
    corrected = log_factor + centre * rig.offset.px
    return cameras.sigma_of({**OF_PAIR, Unknown.OFFSET: centre}, corrected)


def errors_of(priors: CameraPriors) -> Errors:
    """The unknowns that the distances of every method, and the fused ones, are too large by."""
    has_rig = Unknown.BASELINE in priors
    sources = {
        method.name: [source.name for source in method.error_sources] for method in methods()
    }
    sources["fused"] = ["baseline" if has_rig else "horizon"]
    # of a camera that has no given height: of the speed, or of the sizes that show it
    of_height = (OF_PAIR,) if has_rig else (OF_FOCAL, _OF_SPEED)
    height = priors.get(Unknown.HEIGHT)
    if height is not None and height.kind == "given":
        of_height = (_OF_ROAD,)
    return {name: _errors_of(names, of_height) for name, names in sources.items()}


def _errors_of(error_sources: Sequence[str], of_height: tuple[Sum, ...]) -> tuple[Sum, ...]:
    """The unknowns that a distance is in proportion to, by the sources of its errors.

    A distance by size is in proportion to the size and the focal length, also where contact points
    and the horizon are a part of its evidence.
    """
    if "baseline" in error_sources:
        return (OF_PAIR,)
    if "size" not in error_sources and {"horizon", "lane_width"} & {*error_sources}:
        return of_height
    return (OF_FOCAL,)
