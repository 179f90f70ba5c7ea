r"""The loop: frames in, what is known about each frame out, with reading, inference and writing overlapped.

reading thread      detection thread           caller's thread                     (the writer's thread: results)
frame ------------> detect ------------------> track, measure, fuse, filter -----> FrameResult
              \---> dense disparity (a thread of its own) ---/
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field, replace
from threading import Lock

import numpy as np

from track_range.detection.detections import Detections
from track_range.detection.lanes.lines import LaneFinder, LaneLines
from track_range.foundation.arrays import FloatArray
from track_range.ranging.ego_speed import EgoSpeed
from track_range.ranging.filtering.collision_course import CollisionCourse
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.filtering.filtered_ranges import FilteredRanges
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.methods.dense_stereo import DenseRanger
from track_range.ranging.methods.ground_plane import GroundPlane
from track_range.ranging.methods.lane_width import LaneWidthRanger, doubted
from track_range.ranging.ranger import Ranger
from track_range.ranging.ranges import Ranges
from track_range.run.frame_result import FrameResult
from track_range.run.prefetch import prefetch
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracker import Tracker
from track_range.tracking.tracks import Tracks

STAGES = ("read", "lanes", "detect", "track", "mono", "ground", "lane", "stereo", "sgbm", "fuse", "write")

NOISE_SHARES: Mapping[str, float] = {"mono": 0.6, "stereo": 0.3, "fused": 0.35}
"""Methods with a distance filter, and the part of their sigma that is independent from frame to frame.

Where the filter starts; it learns the share from its innovations. Mono tells it box by box (`Ranges.sigma_kept_m`).
Not the shares of `ranging.readings`: those are fixed, and split each input's sigma into bias and noise for fusion;
these are start values for one filter per distance, `fused` among them, whose noise is that of the mixture.
"""

_READ_AHEAD = 4
_DETECT_AHEAD = 2
_LANES_EVERY_S = 0.09  # a lane hardly moves in between, and finders take time: of 30 frames/s, every third is looked at
_BY_THE_WALL = ("detect",)  # stages whose time is the wall's, since they have threads of their own


class StageClock:
    """Seconds of work in each stage, counted from whichever thread does it.

    Inference has threads of its own and is timed by the wall's clock; the other stages work in one thread, and their
    processor time is counted: waiting for a core, since they give way to inference, is no cost of theirs.
    """

    def __init__(self) -> None:
        """Start at zero."""
        self.busy_s = dict.fromkeys(STAGES, 0.0)
        self._lock = Lock()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the with-block to a stage."""
        now_s = time.perf_counter if name in _BY_THE_WALL else time.thread_time
        began_s = now_s()
        try:
            yield
        finally:
            with self._lock:
                self.busy_s[name] += now_s() - began_s


@dataclass(slots=True, kw_only=True)
class Pipeline:
    """The stages of one run; what they remember belongs to the instance.

    Attributes:
        camera: the left camera that the frames seem to come from.
        detect: boxes of a frame.
        tracker: gives them identities.
        rangers: methods by name ("mono", "ground", "stereo"), measured side by side.
        lane_finder: finds the own lane's lines, for `lane`; None = not wanted.
        ground: whose horizon the lane's lines help to find; None = nobody's.
        lane: the method that lives on them; where there is a calibrated pair, stereo teaches it the lane's width.
        dense: dense matching in its own thread ("sgbm"); None = not wanted.
        ego_speed: how fast the camera moves; None = unknown.
        shared_sigma: relative error that all methods share, from a focal length that nobody has calibrated.
        is_live: frames come from a camera: none waits, so that results are as new as can be.
        notes: sentences for the user on the network that describes boxes for the tracker.
        clock: where the time goes.
    """

    camera: PinholeCamera
    detect: Callable[[Frame], Detections]
    tracker: Tracker
    rangers: Mapping[str, Ranger]
    lane_finder: LaneFinder | None = None
    ground: GroundPlane | None = None
    lane: LaneWidthRanger | None = None
    dense: DenseRanger | None = None
    ego_speed: EgoSpeed | None = None
    shared_sigma: float = 0.0
    is_live: bool = False
    notes: tuple[str, ...] = ()
    clock: StageClock = field(default_factory=StageClock)
    _fusion: Fusion = field(default_factory=Fusion)
    _filters: DistanceFilters = field(default_factory=lambda: DistanceFilters(NOISE_SHARES))
    _hinted: LaneLines | None = None
    _course: CollisionCourse = field(init=False)

    def __post_init__(self) -> None:
        self._course = CollisionCourse(self.camera)

    def run(self, frames: Iterable[Frame]) -> Generator[FrameResult, None, None]:
        """The results of each frame in order; closing the generator ends the threads."""
        read_ahead, detect_ahead = (1, 1) if self.is_live else (_READ_AHEAD, _DETECT_AHEAD)
        with ExitStack() as stack:
            stack.callback(self._end_dense)
            # All are closed, the last one first: no thread may still read when the videos are closed.
            read = stack.enter_context(closing(prefetch(frames, depth=read_ahead, gives_way=True)))
            with_lanes = self._with_lanes(read)
            if self.lane_finder is not None:
                with_lanes = stack.enter_context(closing(prefetch(with_lanes, depth=detect_ahead, gives_way=True)))
            detected = stack.enter_context(closing(prefetch(self._detected(with_lanes), depth=detect_ahead)))
            for frame, lanes, detections in detected:
                yield self._result(frame, lanes, detections)

    def _end_dense(self) -> None:
        if self.dense is not None:
            self.dense.close()
            self.clock.busy_s["sgbm"] = self.dense.background_s

    def _with_lanes(self, frames: Iterable[Frame]) -> Iterator[tuple[Frame, LaneLines | None]]:
        """Frames with the lane's lines, looked for ten times a second; between, those of the last look."""
        lanes, due_s = None, -math.inf
        for frame in frames:
            if self.lane_finder is not None and frame.time_s >= due_s:
                with self.clock.stage("lanes"):
                    lanes = self.lane_finder.find(frame.left, frame.time_s)
                due_s = frame.time_s + _LANES_EVERY_S
            yield frame, lanes

    def _detected(
        self, frames: Iterable[tuple[Frame, LaneLines | None]]
    ) -> Iterator[tuple[Frame, LaneLines | None, Detections]]:
        for frame, lanes in frames:
            if self.dense is not None:
                self.dense.start(frame)
            with self.clock.stage("detect"):
                detections = self.detect(frame)
            yield frame, lanes, detections

    def _result(self, frame: Frame, lanes: LaneLines | None, detections: Detections) -> FrameResult:
        with self.clock.stage("track"):
            tracks = self.tracker.update(detections, frame.time_s, frame.left)
        if lanes is not self._hinted:
            self._hint(lanes)
        ranges: dict[str, Ranges] = {}
        for name, ranger in self.rangers.items():
            with self.clock.stage(name):
                ranges[name] = ranger.measure(tracks, frame)
        if self.dense is not None:
            ranges["sgbm"] = self.dense.measure(tracks, frame)
        if self.lane is not None and lanes is not None:
            with self.clock.stage("lane"):
                ranges["lane"] = self._by_lane(self.lane, lanes, tracks, frame, ranges)
        with self.clock.stage("fuse"):
            return self._fused(frame, tracks, ranges, lanes)

    def _hint(self, lanes: LaneLines | None) -> None:
        """Tell the ground where the lines of a new look meet: once, so that it is forgotten as what tracks say is."""
        self._hinted = lanes
        if self.ground is not None and lanes is not None and (horizon := lanes.horizon_px()) is not None:
            self.ground.hint(*horizon)

    def _by_lane(
        self, lane: LaneWidthRanger, lanes: LaneLines, tracks: Tracks, frame: Frame, ranges: Mapping[str, Ranges]
    ) -> Ranges:
        lane.see(lanes, frame.index)
        found = doubted(lane.measure(tracks, frame), [ranges[name] for name in ("mono", "stereo") if name in ranges])
        if "stereo" in ranges and not self.shared_sigma:
            lane.learn(tracks, frame, ranges["stereo"])
        return found

    def _fused(self, frame: Frame, tracks: Tracks, ranges: dict[str, Ranges], lanes: LaneLines | None) -> FrameResult:
        fused = self._fusion.fuse(ranges, tracks.track_id, frame.time_s)
        ranges["fused"] = fused.ranges
        ego_mps = math.nan if self.ego_speed is None else self.ego_speed.at(frame.time_s)
        filtered = self._filters.update(ranges, frame.time_s, ways={"fused": fused.way}, ego_speed_mps=ego_mps)
        ranges |= {f"{name}_kf": each.ranges for name, each in filtered.items()}
        motion = self._with_shared_rate_error(filtered["fused"])
        return FrameResult(
            frame=frame,
            tracks=tracks,
            ranges=self._with_shared_error(ranges),
            closing_mps=-motion.rate_mps,
            closing_sigma_mps=motion.rate_sigma_mps,
            ttc_s=motion.ttc_s,
            ttc_sigma_s=motion.ttc_sigma_s,
            xyz_m=self._points_m(tracks, ranges["fused"].distance_m),
            disparity=None if self.dense is None else self.dense.disparity,
            lanes=lanes,
            misses=self._course.update(tracks, motion.ranges.distance_m, motion.ttc_s, frame.time_s),
        )

    def _with_shared_rate_error(self, motion: FilteredRanges) -> FilteredRanges:
        """A scale that is wrong makes speeds wrong by as much; times to collision do not mind."""
        wider = np.hypot(motion.rate_sigma_mps, self.shared_sigma * motion.rate_mps)
        return replace(motion, rate_sigma_mps=wider) if self.shared_sigma else motion

    def _with_shared_error(self, ranges: Mapping[str, Ranges]) -> Mapping[str, Ranges]:
        """With wider sigmas: neither fusing nor filtering makes an error smaller that all methods share."""
        if not self.shared_sigma:
            return ranges
        return {
            name: replace(found, sigma_m=np.hypot(found.sigma_m, self.shared_sigma * found.distance_m))
            for name, found in ranges.items()
        }

    def _points_m(self, tracks: Tracks, distance_m: FloatArray) -> FloatArray:
        """(N, 3) points at these depths on the rays through the boxes' centres."""
        centre_px = (tracks.xyxy_px[:, :2] + tracks.xyxy_px[:, 2:]) / 2
        return self.camera.rays(centre_px) * distance_m[:, None]
