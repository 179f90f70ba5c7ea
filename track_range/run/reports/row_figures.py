"""Figures of the rows of a run: by method, track, road user and event, and against labels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from track_range.ranging.truth.truth import Truth
from track_range.results.approaches import closest_approaches
from track_range.results.rows.rows import Rows
from track_range.results.summary import (
    MatchedTruth,
    events_section,
    matched_truth,
    truth_figures,
    with_truth,
)
from track_range.results.table import RunRows
from track_range.run.reports.report import Reports


@dataclass(frozen=True, slots=True)
class RowFigures(Reports):
    """Errors and coverage of the methods, tracking metrics, road users and events."""

    rows: RunRows
    recorded: Rows
    truth: Truth | None
    matched: MatchedTruth | None

    @classmethod
    def of(cls, rows: RunRows, recorded: Rows, truth: Truth | None) -> Self:
        """Figures of the rows of a finished run; `truth` None = only coverage."""
        return cls(rows, recorded, truth, None if truth is None else matched_truth(recorded, truth))

    @property
    def with_truth(self) -> Rows:
        """The rows with their ground truth, if there is one."""
        return self.recorded if self.matched is None else with_truth(self.recorded, self.matched)

    def notes(self) -> Sequence[str]:
        """Messages on targets that were matched to the rows."""
        return () if self.matched is None else self.matched.truth.notes

    def summary(self) -> Mapping[str, Any]:
        """Sections `methods`, `common`, `closing`, `tracks`, `truth`, `closest_approaches` and `events`."""
        rows, frames = self.rows, np.array(self.rows.frame_index, np.int64)
        return {
            **truth_figures(self.recorded, self.matched, rows.methods, frames),
            "closest_approaches": closest_approaches(self.recorded),
            "events": events_section(rows.events, rows.seconds),
        }
