"""What is known about the ego speed of a run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.pipeline.ego import EgoStage
from track_range.recording.recording import Recording
from track_range.recording.speed_source import SpeedSource
from track_range.results.table import RunRows
from track_range.run.reports.report import Reports


@dataclass(frozen=True, slots=True)
class SpeedOrigin(Reports):
    """The source of the ego speed, and the speeds at the frames."""

    speed: SpeedSource
    stage: EgoStage
    rows: RunRows

    def notes(self) -> Sequence[str]:
        """Notes on the files with the speed."""
        return self.speed.notes

    def summary(self) -> Mapping[str, Any]:
        """Section `ego_speed`."""
        return {
            "ego_speed": self.speed.summary(np.array(self.rows.ego_mps), self.stage.speed_source)
        }


@dataclass(frozen=True, slots=True)
class SpeedCoverage(Reports):
    """The part of the video in which the ego speed is known."""

    speed: SpeedSource
    stage: EgoStage
    rows: RunRows
    recording: Recording
    start_s: float  # of the run in the recording

    def notes(self) -> Sequence[str]:
        """Notes on a given speed, and on a speed from the images."""
        expected_s = self.start_s + (self.recording.n_frames or 0) / self.recording.fps
        given = self.speed.note(self.rows.last_s if len(self.rows) else expected_s)
        source = self.stage.speed_source
        # before the first frame, no image has shown a speed
        measured = [] if source is None or not len(self.rows) else [self._measured(source)]
        return (*([given] if given else []), *measured)

    def _measured(self, source: str) -> str:
        n_frames, n_known = len(self.rows), int(np.isfinite(self.rows.ego_mps).sum())
        if n_known == 0:
            return f"The ego speed is unknown: no frame shows it by {source}."
        part = f", but only in {n_known} of {n_frames} frames" if 2 * n_known < n_frames else ""
        return f"The ego speed comes from {source}{part}; --ego-speed off ignores it."
