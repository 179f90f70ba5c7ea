"""Files of boxes or labels whose frame numbers may not fit the video."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import IntArray
from track_range.ranging.truth.truth import Truth
from track_range.results.rows.rows import Rows
from track_range.results.table import RunRows
from track_range.run.reports.report import Reports
from track_range.tracking.evaluation.frame_shift import frame_shift_note


@dataclass(frozen=True, slots=True)
class FrameNumbers(Reports):
    """Files of boxes or labels whose frame numbers may not fit the video."""

    rows: RunRows
    recorded: Rows
    detections: IntArray  # numbers of the frames of `--detections`
    truth: Truth | None
    is_whole: bool  # whether the video was processed to its end

    def notes(self) -> Sequence[str]:
        """Notes on frame numbers that do not fit."""
        processed = np.array(self.rows.frame_index, np.int64)
        if not len(processed):
            return ()
        first, last = processed.min(), processed.max()
        labelled = {"--detections": self.detections}
        labelled |= {} if self.truth is None else {"--truth": self.truth.frame}
        labelled = {option: frames for option, frames in labelled.items() if len(frames)}
        missed = [
            f"{option} has boxes for frames {frames.min()} to {frames.max()}, but none for the "
            f"frames of the video, {first} to {last}: check that the boxes belong to this video, "
            "and whether their frame numbers start at 0."
            for option, frames in labelled.items()
            if not np.isin(frames, processed).any()
        ]
        beyond = [
            f"{option} has boxes up to frame {frames.max()}, but the last frame of the video is "
            f"{last}; later boxes are ignored."
            for option, frames in labelled.items()
            if self.is_whole and frames.min() <= last < frames.max()
        ]
        return (*missed, *beyond, *self._shift())

    def _shift(self) -> Sequence[str]:
        """A note on labels that fit the rows of other frames."""
        if self.truth is None:
            return ()
        labels = self.truth.select(self.truth.class_id >= 0)
        frame, boxes_px = self.recorded["frame"], self.recorded.boxes_px
        return frame_shift_note("--truth", labels.frame, labels.xyxy_px, frame, boxes_px)
