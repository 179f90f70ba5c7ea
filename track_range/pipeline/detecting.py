"""DetectionStage: boxes and lane lines of a frame, in three steps that threads may overlap."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from track_range.detection.boxes import area_px2
from track_range.detection.detections import Detections
from track_range.detection.fixed_parts import FixedParts
from track_range.detection.lanes.lines import LaneFinder, LaneLines
from track_range.pipeline.clock import StageClock
from track_range.stereo.geometry.frames import Frame

# between two detections of lane lines, which change slowly and are expensive to detect
_LANE_INTERVAL_S = 0.09


class Prepared(NamedTuple):
    """A frame, and the function that detects its boxes."""

    frame: Frame
    detect: Callable[[], Detections]


class Detected(NamedTuple):
    """A frame with its lane lines and boxes; `candidates` are all boxes, None = not needed."""

    frame: Frame
    lanes: LaneLines | None
    detections: Detections
    candidates: Detections | None = None

    @property
    def hidden(self) -> float:
        """The part of the image inside the largest box."""
        largest_px2 = area_px2(self.detections.xyxy_px).max(initial=0.0)
        height, width = self.frame.left.shape[:2]
        return float(largest_px2 / (height * width))


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
    # what never moves in the images, whose boxes are left out; None = the boxes are as given
    fixed_parts: FixedParts | None = None
    _lanes: LaneLines | None = None
    _lanes_due_s: float = -math.inf

    def notes(self) -> tuple[str, ...]:
        """Messages for the user about boxes that are left out, and the lane lines."""
        parts = (self.fixed_parts, self.lane_finder)
        return tuple(note for part in parts if part is not None for note in part.notes)

    def summary(self) -> dict[str, Any]:
        """No entries of summary.json."""
        return {}

    def prepared(self, frame: Frame, clock: StageClock) -> Prepared:
        """The frame in the network's input."""
        start_s = time.thread_time()
        detect = partial(self.detect, frame) if self.prepare is None else self.prepare(frame)
        clock.add("detect", time.thread_time() - start_s)
        return Prepared(frame, detect)

    def detected(self, prepared: Prepared, clock: StageClock) -> Detected:
        """The frame with its boxes, without lane lines."""
        frame, detect = prepared
        with clock.stage("detect"):
            detections = detect()
            candidates = None if self.candidates is None else self.candidates(frame)
            if self.fixed_parts is not None:
                self.fixed_parts.add(frame.left, frame.time_s)
                detections = self.fixed_parts.moving(detections, frame.left)
        return Detected(frame, None, detections, candidates)

    def with_lanes(self, detected: Detected, clock: StageClock) -> Detected:
        """The frame with the lines of the ego lane on the road between the boxes."""
        frame = detected.frame
        if self.lane_finder is not None and frame.time_s >= self._lanes_due_s:
            with clock.stage("lanes"):
                boxes_px = detected.detections.xyxy_px
                self._lanes = self.lane_finder.find(frame.left, frame.time_s, boxes_px)
            self._lanes_due_s = frame.time_s + _LANE_INTERVAL_S
        return detected._replace(lanes=self._lanes)
