"""Ranger: base class of ranging methods; measures the distances of a frame's tracks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import FloatArray32
from track_range.ranging.ranges import Ranges
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import CameraStep
from track_range.stereo.odometry.road_horizon import RoadView
from track_range.tracking.tracks import Tracks


class Measured(NamedTuple):
    """Distances of one method in a frame, and their evidence of the scale of the drive; None = none."""

    ranges: Ranges
    evidence: ScaleEvidence | None = None


class Ranger(ABC):
    """Measures the distance of each track of a frame; an implementation may have state per track id.

    Only `measure` is required. The other members are hooks that a run calls or reads; their defaults do nothing.
    For each frame a run calls `start` (in another thread, up to a few frames ahead), `update_road` and `update_motion`
    if the images show the road and the motion of the camera, `update_lanes` if lanes were detected in the frame, and
    `measure_at_scale`, which by default calls `measure_with`; after the last frame it calls `close`.

    Attributes:
        background_s: seconds of work so far in the ranger's own threads; a run adds them to the time of its stage.
        disparity: (H, W) dense disparity in px of the frame measured last, in the left image, NaN = unknown, for the
            overlay; None = the method computes none.
    """

    background_s: float = 0.0
    disparity: FloatArray32 | None = None

    @abstractmethod
    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of N tracks in the same order, NaN = not measured."""

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """Distances of N tracks, given their ranges in the same frame by the methods measured before.

        `others` are ranges by method name, of the methods in `RangingMethod.reads` that are part of this run.
        """
        return self.measure(tracks, frame)

    def measure_at_scale(
        self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges], scale: DriveScale
    ) -> Measured:
        """As `measure_with`, given the scale of the drive before this frame; also returns the evidence of the frame.

        For methods that measure by size, and those that measure the scale.
        """
        return Measured(self.measure_with(tracks, frame, others))

    def start(self, frame: Frame) -> None:  # noqa: B027
        """Start work on a frame in the background, before its tracks are known; `measure` of the frame follows."""

    def update_lanes(self, lines: LaneLines) -> None:  # noqa: B027
        """Store newly detected lines of the ego lane; called a few times per second, valid until the next call."""

    def update_road(self, road: RoadView) -> None:  # noqa: B027
        """Store the road in the frame that is measured next, from image motion; lengths in metres."""

    def update_motion(self, step: CameraStep) -> None:  # noqa: B027
        """Store the motion of the camera to the frame that is measured next; not called where it is unknown."""

    def close(self) -> None:  # noqa: B027
        """Stop threads and release resources; no measurement follows."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user at the end of a run, one sentence each."""
        return ()

    def summary(self) -> dict[str, Any]:
        """Entries for the top level of summary.json: JSON values under unique keys."""
        return {}
