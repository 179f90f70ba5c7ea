"""AlarmStage: collision warnings and surrogate measures of safety."""

from dataclasses import dataclass, replace

import numpy as np

from track_range.detection.lanes.lines import LaneLines
from track_range.pipeline.filtering import Approach, Filtered
from track_range.ranging.cameras.doubt import Doubt
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.ranging.warning.safety import SafetyMeasures, SafetyMonitor, lane_edges_m
from track_range.ranging.warning.warnings import Warnings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks


@dataclass(frozen=True, slots=True)
class Alarms:
    """Warnings and measures of safety of the N tracks of a frame."""

    warnings: Warnings
    safety: SafetyMeasures
    # False = not estimated, and unknown
    has_warnings: bool = True
    has_safety: bool = True

    @classmethod
    def none(cls, n: int) -> "Alarms":
        """The alarms of n tracks in a run without warnings."""
        return cls(
            Warnings.unknown(n), SafetyMeasures.unknown(n), has_warnings=False, has_safety=False
        )


class AlarmStage:
    """Warns of collisions ahead; without `warning` there are no alarms, since the vehicle does not
    drive along the camera's axis.
    """

    def __init__(self, camera: PinholeCamera, warning: CollisionWarning | None) -> None:
        self._camera, self._warning = camera, warning
        self._safety = SafetyMonitor(None if warning is None else warning.settings)

    def update(
        self,
        tracks: Tracks,
        fused: Ranges,
        filtered: Filtered,
        approach: Approach,
        ego: EgoMotion,
        doubt: Doubt,
        lanes: LaneLines | None,
        time_s: float,
    ) -> Alarms:
        """The alarms at `time_s`; none is active while the scale is in doubt."""
        if self._warning is None:
            return Alarms.none(len(tracks))
        warnings = self._warning.update(
            tracks,
            filtered.fused,
            filtered.lateral,
            time_s,
            ego_mps=ego.speed_mps,
            ego_scale=ego.scale,
            yaw_rad_s=ego.yaw_rad_s,
            ranges=fused,
        )
        if doubt.scale is not None:
            warnings = replace(warnings, active=np.zeros_like(warnings.active))
        safety = self._safety.update(
            tracks,
            time_s,
            distance_m=filtered.fused.ranges.distance_m,
            closing_mps=approach.closing_mps,
            ttc_s=np.array([approach.ttc_s, approach.ttc_sigma_s]),
            ego_mps=ego.speed_mps,
            warnings=warnings,
            lane_edges_m=lane_edges_m(lanes, self._camera),
        )
        return Alarms(warnings, safety)
