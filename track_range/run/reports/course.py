"""How a run went: its duration, and what ended it early."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from track_range.foundation.errors import RunStoppedError, UserError
from track_range.foundation.files.input_files import counted
from track_range.pipeline.clock import StageClock
from track_range.recording.recording import Recording
from track_range.results.summary import stage_times_ms
from track_range.results.table import RunRows
from track_range.run.reports.report import Reports


@dataclass(slots=True)
class Course(Reports):
    """Time that a run took.

    The time of a run is that for opening the videos and processing all frames, without loading the
    network and without the estimation of the alignment.
    """

    rows: RunRows
    recording: Recording
    clock: StageClock
    wall_s: float  # at first that of the opening
    names_causes: bool  # of an early end; they may name folders
    stopped_by: BaseException | None = None  # error that ended the run early

    def end(self, processing_s: float, stopped_by: BaseException | None) -> None:
        """End the processing after `processing_s`, early if an error stopped it."""
        self.wall_s += processing_s
        self.stopped_by = stopped_by

    def notes(self) -> Sequence[str]:
        """A note on an early end."""
        error = self.stopped_by
        if error is None:
            return ()
        stopped = f"The run was stopped early, after {counted(len(self.rows), 'frame')}"
        is_asked = isinstance(error, RunStoppedError | GeneratorExit | KeyboardInterrupt)
        if is_asked or not self.names_causes:
            return (f"{stopped}.",)
        cause = str(error) if isinstance(error, UserError) else f"{type(error).__name__}: {error}"
        return (f"{stopped}: {cause}",)

    def summary(self) -> Mapping[str, Any]:
        """Run times."""
        n_frames, wall_s = len(self.rows), self.wall_s
        busy_s = {**self.clock.busy_s, "read": self.recording.busy_s}
        return {
            "wall_s": round(wall_s, 3),
            "frames_per_s": round(n_frames / wall_s, 3) if wall_s > 0 else None,
            "stages_ms": stage_times_ms(busy_s, n_frames),
        }
