"""Stages of the pipeline: DetectionStage, EgoStage, RangingStage and FusionStage.

Detection has two steps, which threads may overlap.
"""

import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np

from track_range.detection.detections import Detections
from track_range.detection.lanes.lines import LaneFinder, LaneLines
from track_range.foundation.arrays import FloatArray, FloatArray32
from track_range.foundation.errors import named_errors
from track_range.foundation.files.input_files import counted
from track_range.pipeline.throughput import StageClock
from track_range.ranging.filtering.cut_boxes import CutBoxes
from track_range.ranging.filtering.distance_filter import DistanceFilters, FilteredRanges
from track_range.ranging.filtering.lateral_motion import LateralFilters, LateralMotion
from track_range.ranging.fusion.fusion import Fusion, ScaleSource
from track_range.ranging.method import MethodError, Ranger, checked_ranges
from track_range.ranging.ranges import Ranges
from track_range.ranging.registry import methods
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.ranging.size_models.size_model import have_hidden_sides
from track_range.ranging.world.ego_speed import EgoSpeed
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.camera_height import CameraHeight
from track_range.stereo.odometry.ego_motion import CameraStep, EgoMotion, Odometry
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.stereo.odometry.road_horizon import RoadView
from track_range.tracking.tracks import Tracks

_T = TypeVar("_T")
# between two detections of lane lines, which change slowly and are expensive to detect
_LANE_INTERVAL_S = 0.09
# lateral speed, and standard deviations of it, above which an object moves
_ACROSS_MPS, _ACROSS_SIGMA = 1.0, 3.0
# error of the lateral speed relative to w z in turns, from the error of the distance z
_TURN_ERROR = 0.2
# initial fraction of the fused sigma that is independent between frames
FUSED_NOISE_FRACTION = 0.35


def noise_shares() -> dict[str, float]:
    """Initial fraction of sigma that is independent between frames, for each distance that is
    filtered over time.

    The filters adapt it to their innovations. Fusion uses the declared error sources of the methods
    instead.
    """
    filtered = {method.name: method.noise_share for method in methods() if method.is_filtered}
    return {**filtered, "fused": FUSED_NOISE_FRACTION}


class Prepared(NamedTuple):
    """A frame with its lane lines, and the function that detects its boxes."""

    frame: Frame
    lanes: LaneLines | None
    detect: Callable[[], Detections]


class Detected(NamedTuple):
    """A frame with its lane lines and boxes; `candidates` are all boxes, None = not needed."""

    frame: Frame
    lanes: LaneLines | None
    detections: Detections
    candidates: Detections | None = None


@dataclass(slots=True, kw_only=True)
class DetectionStage:
    """First stage of the pipeline."""

    detect: Callable[[Frame], Detections]  # returns the boxes of a frame
    # does what `detect` does before the network runs, and returns a function that does the rest,
    # which another thread may call; None = `detect` does all
    prepare: Callable[[Frame], Callable[[], Detections]] | None = None
    # all boxes of the latest frame; None = not needed
    candidates: Callable[[Frame], Detections] | None = None
    lane_finder: LaneFinder | None = None  # lines of the ego lane, ten times per second; None = off
    _lanes: LaneLines | None = None
    _lanes_due_s: float = -math.inf

    def prepared(self, frame: Frame, clock: StageClock) -> Prepared:
        """The frame in the network's input, with its lane lines."""
        if self.lane_finder is not None and frame.time_s >= self._lanes_due_s:
            with clock.stage("lanes"):
                self._lanes = self.lane_finder.find(frame.left, frame.time_s)
            self._lanes_due_s = frame.time_s + _LANE_INTERVAL_S
        start_s = time.thread_time()
        detect = partial(self.detect, frame) if self.prepare is None else self.prepare(frame)
        clock.add("detect", time.thread_time() - start_s)
        return Prepared(frame, self._lanes, detect)

    def detected(self, prepared: Prepared, clock: StageClock) -> Detected:
        """The frame with its boxes."""
        frame, lanes, detect = prepared
        with clock.stage("detect"):
            detections = detect()
            return Detected(
                frame,
                lanes,
                detections,
                None if self.candidates is None else self.candidates(frame),
            )


class Ego(NamedTuple):
    """The camera's own motion as one frame shows it."""

    motion: EgoMotion  # speed and yaw rate, NaN = unknown
    road: RoadView | None = None  # the road in the frame, lengths in metres; None = unknown
    step: CameraStep | None = None  # motion of the camera since the previous frame; None = unknown
    # motion by stereo odometry, which may not be `motion`; None = it did not run
    by_pair: EgoMotion | None = None
    given: EgoMotion | None = None  # motion that was given; None = none was


@dataclass(slots=True, kw_only=True)
class EgoStage:
    """Measures `Ego` frame by frame."""

    speed: EgoSpeed | None = None  # speed of the camera from telemetry or a setting; None = unknown
    # measures the motion of the camera, used where no speed is given; None = off
    odometry: Odometry | None = None
    # horizon of the road and yaw rate of the camera; None = off
    road_motion: GroundOdometry | None = None
    # from a known speed; None = it is known, or no speed is
    camera_height: CameraHeight | None = None
    image_motion: ImageMotionEstimator | None = None  # yaw rate without `road_motion`; None = off
    trusts_speed: bool = True  # whether a given speed is used

    def update(
        self, frame: Frame, xyxy_px: FloatArray, clock: StageClock, known: EgoMotion | None = None
    ) -> Ego:
        """The motion to the next frame, in order; the boxes (N, 4) belong to road users, which are
        not static.

        `known` is a speed of the camera that is known for this frame only; None = as the stage
        measures it.
        """
        if known is None and self.speed is not None:
            known = EgoMotion(self.speed.at(frame.time_s), self.speed.sigma_at(frame.time_s))
        uses_images = not (
            self.road_motion is None and self.odometry is None and self.image_motion is None
        )
        measured: EgoMotion | None = None
        with clock.stage("motion") if uses_images else nullcontext():
            if self.road_motion is not None:
                self.road_motion.update(frame, xyxy_px)
            if self.odometry is not None:
                measured = self.odometry.update(frame, xyxy_px)
            yaw_rad_s = math.nan if measured is not None else self._yaw_rad_s(frame, xyxy_px)
        by_pair = None if self.odometry is self.road_motion else measured
        motion = measured or EgoMotion(yaw_rad_s=yaw_rad_s)
        if known is not None and self.trusts_speed:
            motion = replace(known, yaw_rad_s=motion.yaw_rad_s, is_still=motion.is_still)
        road = self.road_motion
        if road is None or not road.has_horizon:
            return Ego(motion, by_pair=by_pair, given=known)
        view = road.view
        if self.camera_height is not None and (known is None or self.trusts_speed):
            self.camera_height.update(frame.time_s, motion, road.ego)
            if (height_m := self.camera_height.height_m) is not None:
                view = replace(view.scaled(height_m[0] / road.height_m), height_m=height_m)
        return Ego(motion, view, road.step(motion), by_pair, known)

    def _yaw_rad_s(self, frame: Frame, xyxy_px: FloatArray) -> float:
        """Yaw rate of the camera, NaN = unknown."""
        if self.road_motion is not None:
            return self.road_motion.motion.yaw_rad_s
        if self.image_motion is not None:
            return self.image_motion.update(frame.left, frame.time_s, xyxy_px).yaw_rad_s
        return math.nan


@dataclass(slots=True)
class RangingStage:
    """The ranging methods by name, in the order of execution
    (`ranging.registry.create_rangers`).
    """

    rangers: Mapping[str, Ranger]
    _reads: Mapping[str, tuple[str, ...]] = field(
        default_factory=lambda: {method.name: method.reads for method in methods()}
    )
    _lanes: LaneLines | None = None
    # values by method and invalid column
    _n_invalid: Counter[tuple[str, str]] = field(default_factory=Counter)
    # messages of methods that failed at the end
    _failures: dict[str, None] = field(default_factory=dict)

    def start(self, frame: Frame) -> None:
        """Start the methods that work in the background, before the tracks are known."""
        for name, ranger in self.rangers.items():
            with _named(name, ranger, f", frame {frame.index}"):
                ranger.start(frame)

    def measure(
        self,
        tracks: Tracks,
        frame: Frame,
        lanes: LaneLines | None,
        ego: Ego,
        scale: DriveScale,
        clock: StageClock,
    ) -> tuple[dict[str, Ranges], list[ScaleEvidence]]:
        """Distances of the tracks by method, and the evidence of the methods about the scale of the
        drive.

        Raises MethodError if a ranger of another package failed, or did not return ranges of these
        tracks.
        """
        ranges: dict[str, Ranges] = {}
        evidence: list[ScaleEvidence] = []
        for name, ranger in self.rangers.items():
            others = {
                other: ranges[other] for other in self._reads.get(name, ()) if other in ranges
            }
            with clock.stage(name), _named(name, ranger, f", frame {frame.index}"):
                if ego.road is not None:
                    ranger.update_road(ego.road)
                if ego.step is not None:
                    ranger.update_motion(ego.step)
                if lanes is not None and lanes is not self._lanes:
                    ranger.update_lanes(lanes)
                measured = ranger.measure_at_scale(tracks, frame, others, scale)
                ranges[name] = checked_ranges(name, measured.ranges, tracks, self._n_invalid)
            if measured.evidence is not None:
                evidence.append(measured.evidence)
        self._lanes = lanes
        return ranges, evidence

    @property
    def disparity(self) -> FloatArray32 | None:
        """(H, W) disparities of the last frame; None = dense stereo did not run."""
        return next(
            (ranger.disparity for ranger in self.rangers.values() if ranger.disparity is not None),
            None,
        )

    def notes(self) -> tuple[str, ...]:
        """Notes for the user: of the methods at their end, and on invalid values and methods."""
        notes = [
            note
            for of_method in self._answers(lambda ranger: tuple(ranger.notes))
            for note in of_method
        ]
        for name in self.rangers:
            counts = {
                column: n for (method, column), n in self._n_invalid.items() if method == name and n
            }
            if counts:
                reasons = ", ".join(f"{column} in {n}" for column, n in counts.items())
                skipped = (
                    f"skipped {counted(sum(counts.values()), 'value')}, since only positive and "
                    "finite values are valid"
                )
                notes.append(f"Ranging method {name!r}: {skipped} ({reasons}).")
        return (*notes, *self._failures)

    def summary(self) -> dict[str, Any]:
        """Entries of the methods for summary.json."""
        answers = self._answers(lambda ranger: ranger.summary())
        return {key: value for entries in answers for key, value in entries.items()}

    def _answers(self, ask: Callable[[Ranger], _T]) -> list[_T]:
        """The answers of the methods at the end, without the methods that fail then: the distances
        are complete.
        """
        answers = []
        for name, ranger in self.rangers.items():
            try:
                with _named(name, ranger, ", end of the run"):
                    answers.append(ask(ranger))
            except MethodError as error:
                self._failures.setdefault(str(error))
        return answers

    def close(self, clock: StageClock) -> None:
        """End the methods' threads, and add their time to the clock."""
        for name, ranger in self.rangers.items():
            with _named(name, ranger, ", end of the run"):
                ranger.close()
            clock.add(name, ranger.background_s)


def _named(name: str, ranger: Ranger, where: str) -> AbstractContextManager[None]:
    return named_errors(type(ranger).__module__, f"ranging method {name!r}{where}", MethodError)


class FusionStage:
    """Fuses the distances of the methods, and filters distances and lateral positions over time.

    `has_visible_boxes`: see `MethodContext`.
    """

    def __init__(self, camera: PinholeCamera, *, has_visible_boxes: bool = False) -> None:
        self._has_visible_boxes = has_visible_boxes
        self._camera, self._fusion, self._lateral = camera, Fusion(), LateralFilters(camera)
        self._filters = DistanceFilters(noise_shares())

    def update(
        self, frame: Frame, tracks: Tracks, ranges: dict[str, Ranges], ego: EgoMotion
    ) -> tuple[FilteredRanges, LateralMotion]:
        """Filtered fused distances and lateral motion of the tracks; adds fused and filtered
        distances to `ranges`.
        """
        fused = self._fusion.fuse(ranges, tracks.track_id, frame.time_s)
        ranges["fused"] = fused.ranges
        last = self._lateral.last(tracks.track_id)
        across_mps = _ACROSS_MPS + _ACROSS_SIGMA * np.sqrt(last.P_vv)
        across_mps += _TURN_ERROR * np.nan_to_num(abs(ego.yaw_rad_s) * fused.ranges.distance_m)
        filtered = self._filters.update(
            ranges,
            frame.time_s,
            conditions={"fused": fused.condition},
            ego_speed_mps=ego.speed_mps,
            ego_sigma_mps=ego.speed_sigma_mps,
            yaw_rad_s=ego.yaw_rad_s,
            growth=next(
                (measured.growth for measured in ranges.values() if measured.growth is not None),
                None,
            ),
            class_id=tracks.class_id,
            may_be_static=~(np.abs(last.v) > across_mps),
            cut=CutBoxes.of(tracks, self._camera),
            is_hidden=have_hidden_sides(tracks.xyxy_px)
            & (fused.scale_source == ScaleSource.ASSUMED)
            if self._has_visible_boxes
            else None,
        )
        ranges |= {f"{name}_kf": state.ranges for name, state in filtered.items()}
        motion = filtered["fused"]
        lateral = self._lateral.update(
            tracks,
            motion.ranges.distance_m,
            frame.time_s,
            distance_sigma_m=np.sqrt(motion.state.P_xx),
            yaw_rad_s=ego.yaw_rad_s,
            own_mps=motion.state.v + ego.speed_mps if math.isfinite(ego.speed_mps) else 0.0,
        )
        return motion, lateral
