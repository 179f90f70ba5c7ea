"""RangingStage: distances of a frame's tracks by every method, and their evidence of the drive's scale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import FloatArray32
from track_range.pipeline.ego_stage import Ego
from track_range.pipeline.stage_clock import StageClock
from track_range.ranging.method import checked_ranges
from track_range.ranging.ranger import Ranger
from track_range.ranging.ranges import Ranges
from track_range.ranging.registry import methods
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks


@dataclass(slots=True)
class RangingStage:
    """The ranging methods by name, in the order of execution (`ranging.registry.create_rangers`)."""

    rangers: Mapping[str, Ranger]
    _reads: Mapping[str, tuple[str, ...]] = field(
        default_factory=lambda: {method.name: method.reads for method in methods()}
    )
    _lanes: LaneLines | None = None

    def start(self, frame: Frame) -> None:
        """Start the methods that work in the background, before the tracks are known."""
        for ranger in self.rangers.values():
            ranger.start(frame)

    def measure(
        self, tracks: Tracks, frame: Frame, lanes: LaneLines | None, ego: Ego, scale: DriveScale, clock: StageClock
    ) -> tuple[dict[str, Ranges], list[ScaleEvidence]]:
        """Distances of the tracks by method, and the evidence of the methods about the scale of the drive.

        Raises:
            MethodError: a ranger of another package did not return ranges of these tracks.
        """
        ranges: dict[str, Ranges] = {}
        evidence: list[ScaleEvidence] = []
        for name, ranger in self.rangers.items():
            others = {other: ranges[other] for other in self._reads.get(name, ()) if other in ranges}
            with clock.stage(name):
                if ego.road is not None:
                    ranger.update_road(ego.road)
                if ego.step is not None:
                    ranger.update_motion(ego.step)
                if lanes is not None and lanes is not self._lanes:
                    ranger.update_lanes(lanes)
                measured = ranger.measure_at_scale(tracks, frame, others, scale)
                ranges[name] = checked_ranges(name, measured.ranges, tracks)
            if measured.evidence is not None:
                evidence.append(measured.evidence)
        self._lanes = lanes
        return ranges, evidence

    @property
    def disparity(self) -> FloatArray32 | None:
        """(H, W) disparities of the last frame; None = dense stereo did not run."""
        return next((ranger.disparity for ranger in self.rangers.values() if ranger.disparity is not None), None)

    def notes(self) -> tuple[str, ...]:
        """Notes of the methods for the user, at the end."""
        return tuple(note for ranger in self.rangers.values() for note in ranger.notes)

    def summary(self) -> dict[str, Any]:
        """Entries of the methods for summary.json."""
        return {key: value for ranger in self.rangers.values() for key, value in ranger.summary().items()}

    def close(self, clock: StageClock) -> None:
        """End the methods' threads, and add their time to the clock."""
        for name, ranger in self.rangers.items():
            ranger.close()
            clock.add(name, ranger.background_s)
