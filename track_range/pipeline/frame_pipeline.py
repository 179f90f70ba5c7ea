"""FramePipeline: from the boxes of a frame to its result; `step` lists the stages in their
order.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.background import Background, InThreads
from track_range.pipeline.alarming import AlarmStage
from track_range.pipeline.clock import StageClock
from track_range.pipeline.detecting import Detected, DetectionStage
from track_range.pipeline.doubting import DoubtStage
from track_range.pipeline.ego import EgoStage
from track_range.pipeline.filtering import Approach, FilterStage, reported
from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.ranging import FrameRanges, RangingStage, stretched
from track_range.pipeline.tracking import tracked, unconfirmed
from track_range.pipeline.world import WorldStage
from track_range.ranging.cameras.doubt import Doubt
from track_range.ranging.fusion.fusion import Fusion
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion
from track_range.stereo.odometry.image_times import ImageTimes
from track_range.tracking.registry import ObjectTracker
from track_range.tracking.tracks import Tracks


class _Seen(NamedTuple):
    """What the image of a frame shows, before it is fused and filtered."""

    tracks: Tracks
    unconfirmed: Tracks  # not ranged or reported, but their boxes show how they move
    ego: Ego
    measured: FrameRanges


@dataclass(slots=True, kw_only=True)
class FramePipeline:
    """The stages of a drive, and what they learnt so far."""

    detection: DetectionStage  # boxes and lane lines of a frame
    tracker: ObjectTracker  # assigns identities to boxes
    ego: EgoStage  # motion of the camera and the road
    ranging: RangingStage  # the ranging methods
    doubting: DoubtStage  # checks what was given
    fusion: Fusion = field(default_factory=Fusion)  # one distance from all methods
    filtering: FilterStage  # distances over time
    world: WorldStage  # positions and motion over ground
    alarming: AlarmStage  # warnings and measures of safety
    times: ImageTimes = field(default_factory=ImageTimes)  # which frames show a new moment
    # makes the stages of another scene, which continue nothing; None = all stages go on
    restarted: Callable[[], tuple[ObjectTracker, EgoStage, AlarmStage]] | None = None
    setup_notes: tuple[str, ...] = ()  # messages for the user about the chosen parts
    clock: StageClock = field(default_factory=StageClock)  # time spent in each stage
    background: Background = field(default_factory=InThreads)  # where long estimates are made
    # from the frames so far; used with the next one
    scale: DriveScale = field(init=False)
    doubt: Doubt = field(init=False)
    tracks: Tracks = field(default_factory=Tracks.empty, init=False)
    # added to the tracker's numbers, which count from 0 or 1, in this scene and in the next one
    _first_id: int = field(default=0, init=False)
    _next_id: int = field(default=0, init=False)
    # messages about earlier scenes
    _notes_before: tuple[str, ...] = field(default=(), init=False)

    def __post_init__(self) -> None:
        self.doubt, self.scale = self.doubting.initial, self.doubting.initial_scale

    def detected(self, frame: Frame) -> Detected:
        """The frame with its boxes and lane lines, in the calling thread."""
        prepared = self.detection.prepared(frame, self.clock)
        self.ranging.start(frame)
        detected = self.detection.detected(prepared, self.clock)
        return self.detection.with_lanes(detected, self.clock)

    def step(self, detected: Detected, known_ego: EgoMotion | None = None) -> FrameResult:
        """Result of one frame; frames must be passed in order.

        `known_ego` is a speed of the camera that is known for this frame; None = as the ego stage
        measures it.
        """
        frame, lanes = detected.frame, detected.lanes
        image = self.times.update(frame.left, frame.time_s, detected.hidden)
        time_s, stage = image.time_s, self.clock.stage
        if image.starts_scene and self.restarted is not None:
            self._start_scene(*self.restarted())
        if image.is_repeated:
            seen = self._predicted(frame, known_ego)
        else:
            if time_s != frame.time_s:
                detected = detected._replace(frame=replace(frame, time_s=time_s))
            seen = self._measured(detected, known_ego, has_sure_time=image.is_sure)
        tracks, ego, measured = seen.tracks, seen.ego, seen.measured
        doubt, scale = self.doubt, self.scale
        if not image.is_repeated:
            with stage("doubt"):
                doubt, scale = self.doubting.update(tracks, measured, ego, lanes, scale, frame)
            measured = measured.at_scale(scale)
        with stage("fuse"):
            fused = self.fusion.fuse(measured.to_fuse, tracks.track_id, time_s)
        with stage("filter"):
            filtered = self.filtering.update(
                tracks, measured, fused, ego.motion, time_s, unconfirmed=seen.unconfirmed
            )
            filtered = filtered.corrected(scale.focal)
            ranges = reported(measured, fused, filtered, doubt, scale.focal)
            approach = Approach.of(filtered, doubt.closing_sigma)
        with stage("world"):
            moved = doubt.widened(ego, scale.focal.corrected_motion(ego.motion))
            world = self.world.update(tracks, filtered, ranges, moved, time_s, scale.focal)
        with stage("alarm"):
            alarms = self.alarming.update(
                tracks, ranges["fused"], filtered, approach, moved, doubt, lanes, time_s
            )
        self.doubt, self.scale = doubt, scale
        return FrameResult(
            frame=frame,
            tracks=self.tracks,
            ranges=ranges,
            approach=approach,
            world=world,
            alarms=alarms,
            ego=moved,
            lanes=lanes or LaneLines(),
            doubt=doubt,
            dense=stretched(measured.dense, scale.focal),
            candidates=detected.candidates,
            shown_only=measured.shown_only,
        )

    def _measured(
        self, detected: Detected, known_ego: EgoMotion | None, *, has_sure_time: bool
    ) -> _Seen:
        """What a new image shows."""
        frame, lanes, detections = detected.frame, detected.lanes, detected.detections
        # before the tracker, which uses the corners of the background as often as the ego stage
        # needs new ones
        with self.clock.stage("ego"):
            ego = self.ego.update(
                frame,
                detections.xyxy_px,
                known_ego,
                trusts_given=self.doubt.trusts_speed,
                scale=self.scale,
                has_sure_time=has_sure_time,
                height_m=self.doubt.height_m,
            )
        with self.clock.stage("track"):
            self.tracks = tracks = self._numbered(tracked(self.tracker, detections, frame))
            others = self._numbered(unconfirmed(self.tracker))
        if ego.right_camera is not None:
            frame = ego.right_camera.corrected(frame)
        measured = self.ranging.measure(tracks, frame, lanes, ego, self.scale, self.clock)
        return _Seen(tracks, others, ego, measured)

    def _start_scene(self, tracker: ObjectTracker, ego: EgoStage, alarming: AlarmStage) -> None:
        """Go on with the stages of another scene; the numbers of a tracker that goes on do, too."""
        self._notes_before = (*self._notes_before, *self.ego.notes)
        if tracker is not self.tracker:
            self._first_id = self._next_id
        self.tracker, self.ego, self.alarming = tracker, ego, alarming

    def _numbered(self, tracks: Tracks) -> Tracks:
        """Tracks with other numbers than those of earlier scenes."""
        if len(tracks) and self._first_id:
            tracks = replace(tracks, track_id=tracks.track_id + self._first_id)
        self._next_id = max(self._next_id, int(tracks.track_id.max(initial=-1)) + 1)
        return tracks

    def _predicted(self, frame: Frame, known_ego: EgoMotion | None) -> _Seen:
        """The last tracks, without measurements: a repeated image shows nothing of its time."""
        tracks = replace(self.tracks, observed=np.zeros(len(self.tracks), np.bool_))
        with self.clock.stage("ego"):
            ego = self.ego.predicted(
                frame.time_s,
                known_ego,
                trusts_given=self.doubt.trusts_speed,
                focal=self.scale.focal,
            )
        return _Seen(tracks, Tracks.empty(), ego, self.ranging.skip(tracks, frame))

    def notes(self) -> tuple[str, ...]:
        """Messages for the user about the parts of the pipeline, besides those of the stages."""
        notes = (*self.setup_notes, *self.times.notes, *self._notes_before, *self.ego.notes)
        notes = (*notes, *self.background.notes)
        return tuple(dict.fromkeys(notes))

    def summary(self) -> dict[str, Any]:
        """The scale of the drive for summary.json; no entry without evidence."""
        return {"drive_bias": self.scale.summary()} if self.scale.n_tracks else {}

    def close(self) -> None:
        """End the threads and the process of the stages; no frame follows."""
        self.ranging.close(self.clock)
        self.background.close()
