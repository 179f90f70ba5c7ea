"""FilterStage: distances, closing speeds and lateral positions of the tracks, filtered over time."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.pipeline.ranging import FrameRanges
from track_range.ranging.cameras.doubt import Doubt
from track_range.ranging.filtering.cut_boxes import CutBoxes
from track_range.ranging.filtering.distance_filter import DistanceFilters, FilteredRanges
from track_range.ranging.filtering.lateral_motion import LateralFilters, LateralMotion
from track_range.ranging.filtering.observation import Observation
from track_range.ranging.fusion.fusion import Fused, ScaleSource
from track_range.ranging.measurement.focal_scale import EXACT, FocalScale
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.registry import methods
from track_range.ranging.size_models.size_model import BORDER_PX, have_hidden_sides
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting, looks_ahead
from track_range.stereo.odometry.ego_motion import MAX_EGO_SIGMA_MPS, EgoMotion
from track_range.tracking.tracks import Tracks

# lateral speed, and standard deviations of it, above which an object moves
_ACROSS_MPS, _ACROSS_SIGMA = 1.0, 3.0
# error of the lateral speed relative to w z in turns, and to that of the camera, from the error of
# the distance z
_SCALE_ERROR = 0.2
# of the road classes, objects whose height does not change
_IS_RIGID = np.isin(ROAD_CLASSES, ("car", "truck", "bus", "motorcycle"))
_ASSUMED = int(ScaleSource.ASSUMED)
FUSED_NOISE_FRACTION = (
    0.35  # initial fraction of the fused sigma that is independent between frames
)


def noise_shares(optional: Collection[str] = ()) -> dict[str, float]:
    """Initial fraction of sigma that is independent between frames, for each distance that is
    filtered over time; of optional methods only of those that are named.

    The filters adapt it to their innovations. Fusion uses the declared error sources of the methods
    instead.
    """
    listed = methods(optional)
    filtered = {method.name: method.noise_share for method in listed if method.is_filtered}
    return {**filtered, "fused": FUSED_NOISE_FRACTION}


@dataclass(frozen=True, slots=True)
class Filtered:
    """Motion of the tracks of a frame relative to the camera."""

    by_method: Mapping[str, FilteredRanges]  # of the filtered methods, and "fused"
    lateral: LateralMotion

    @property
    def fused(self) -> FilteredRanges:
        """The motion by the fused distances."""
        return self.by_method["fused"]

    def corrected(self, focal: FocalScale) -> "Filtered":
        """The motion with the true focal length, which affects only what is along the axis."""
        factor = focal.factor
        if factor == 1.0:
            return self
        scaled = {name: one.scaled(factor) for name, one in self.by_method.items()}
        return replace(self, by_method=scaled)


@dataclass(frozen=True, slots=True)
class Approach:
    """Closing speed and time to collision of N tracks, (N,) each, by the filtered fused distance;
    NaN = unknown.
    """

    closing_mps: FloatArray  # positive = approaching
    closing_sigma_mps: FloatArray
    ttc_s: FloatArray  # distance / closing speed; NaN = not approaching
    ttc_sigma_s: FloatArray
    # whether the left or right image border cuts the box, so that its edges are not the object's
    is_cut: BoolArray

    @classmethod
    def of(cls, filtered: Filtered, shared_sigma: float) -> "Approach":
        """The approach by filtered distances; an error of all distances is one of the speed, too,
        but not of the time to collision.
        """
        motion = filtered.fused
        rate_mps, sigma_mps = motion.rate_mps, motion.rate_sigma_mps
        sigma_mps = np.hypot(sigma_mps, shared_sigma * rate_mps)
        is_cut = filtered.lateral.is_cut
        return cls(-rate_mps, sigma_mps, motion.ttc_s, motion.ttc_sigma_s, is_cut)

    @classmethod
    def unknown(cls, n: int) -> "Approach":
        """The approach of n tracks whose motion is unknown."""
        closing_mps, sigma_mps, ttc_s, ttc_sigma_s = np.full((4, n), np.nan)
        return cls(closing_mps, sigma_mps, ttc_s, ttc_sigma_s, np.zeros(n, np.bool_))


class FilterStage:
    """Filters the distances of all tracks of a drive.

    `methods_of_run`: names of the methods; `has_visible_boxes`: see `MethodContext`. With a
    `mounting` that does not look along the drive, there is no time to collision.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        *,
        methods_of_run: Collection[str] = (),
        has_visible_boxes: bool = False,
        mounting: Mounting | None = None,
    ) -> None:
        self._camera, self._has_visible_boxes = camera, has_visible_boxes
        self._is_ahead = looks_ahead(mounting)
        self._distances = DistanceFilters(noise_shares(methods_of_run))
        self._by_size = [
            method.name for method in methods() if method.is_filtered and method.uses_size_model
        ]
        self._lateral = LateralFilters(camera, mounting)

    def update(
        self,
        tracks: Tracks,
        measured: FrameRanges,
        fused: Fused,
        ego: EgoMotion,
        time_s: float,
        *,
        unconfirmed: Tracks | None = None,
    ) -> Filtered:
        """The motion of the tracks at `time_s`, after the measurements of this frame.

        The boxes of the `unconfirmed` tracks count once these are confirmed; None = there are none.
        """
        if ego.speed_sigma_mps > MAX_EGO_SIGMA_MPS:
            ego = replace(ego, speed_mps=math.nan)
        filtered = self._distances.update(
            {**measured.ranges, "fused": fused.ranges},
            time_s,
            observation=Observation(
                conditions={"fused": fused.condition},
                cut=CutBoxes.of(tracks, self._camera),
                is_hidden=self._are_hidden(tracks, fused),
                growth=measured.growth,
                heights_px=self._heights_px(tracks, fused),
                class_id=tracks.class_id,
                may_be_static=self._may_be_static(tracks, fused.ranges, ego),
            ),
            ego=ego,
        )
        motion = filtered["fused"]
        is_ego_known = math.isfinite(ego.speed_mps)
        own_mps = motion.state.v + ego.speed_mps if is_ego_known else 0.0
        self._lateral.start(tracks, motion.state, time_s, own_mps=own_mps)
        lateral = self._lateral.update(
            tracks,
            motion.ranges.distance_m,
            time_s,
            distance_sigma_m=np.sqrt(motion.state.P_xx),
            yaw_rad_s=ego.yaw_rad_s,
            own_mps=own_mps,
            right_mps=ego.right_mps,
        )
        self._lateral.remember(
            Tracks.empty() if unconfirmed is None else unconfirmed,
            time_s,
            yaw_rad_s=ego.yaw_rad_s,
            right_mps=ego.right_mps,
        )
        if not self._is_ahead:
            filtered["fused"] = replace(motion, ttc_s=np.full(len(tracks), np.nan))
        return Filtered(filtered, lateral)

    def _may_be_static(self, tracks: Tracks, fused: Ranges, ego: EgoMotion) -> BoolArray:
        """(N,) False = the track certainly moves across the camera's axis."""
        last = self._lateral.last(tracks.track_id)
        right_mps = abs(ego.right_mps) if math.isfinite(ego.right_mps) else 0.0
        least_mps = _ACROSS_MPS + _SCALE_ERROR * right_mps
        across_mps = least_mps + _ACROSS_SIGMA * np.sqrt(last.P_vv)
        if math.isfinite(ego.yaw_rad_s):
            # 0 for an unknown distance
            across_mps += _SCALE_ERROR * np.fmax(abs(ego.yaw_rad_s) * fused.distance_m, 0.0)
        return np.asarray(~(np.abs(last.v) > across_mps))

    def _heights_px(self, tracks: Tracks, fused: Fused) -> dict[str, FloatArray]:
        """(N,) heights of the boxes of vehicles, by name of the distances that follow from an
        assumed size.
        """
        top_px, bottom_px = tracks.xyxy_px[:, 1], tracks.xyxy_px[:, 3]
        last_px = self._camera.height_px - 1 - BORDER_PX
        is_whole = tracks.observed & (top_px >= BORDER_PX) & (bottom_px <= last_px)
        counts = is_whole & _IS_RIGID[tracks.class_id]
        height_px = np.where(counts, bottom_px - top_px, np.nan)
        is_assumed = fused.scale_source == _ASSUMED
        by_size = dict.fromkeys(self._by_size, height_px)
        return {**by_size, "fused": np.where(is_assumed, height_px, np.nan)}

    def _are_hidden(self, tracks: Tracks, fused: Fused) -> BoolArray | None:
        """(N,) whether distances come from boxes with hidden sides; None = no box has any."""
        if not self._has_visible_boxes:
            return None
        hidden = have_hidden_sides(tracks.xyxy_px) & (fused.scale_source == _ASSUMED)
        return np.asarray(hidden)


def reported(
    measured: FrameRanges,
    fused: Fused,
    filtered: Filtered,
    doubt: Doubt,
    focal: FocalScale = EXACT,
) -> dict[str, Ranges]:
    """All distances of a frame by name, the filtered ones as NAME_kf, with the errors that neither
    fusion nor filters reduce; `focal` has corrected the filtered ones.
    """
    sigma, factor = doubt.shared_sigma, focal.factor
    by_method = {**measured.ranges, "fused": fused.ranges}
    ranges = {
        name: of_method.scaled(factor).widened(sigma[name]) for name, of_method in by_method.items()
    }
    for name, of_method in filtered.by_method.items():
        ranges[f"{name}_kf"] = of_method.ranges.widened(sigma[name])
    return ranges
