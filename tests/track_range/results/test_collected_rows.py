"""Rows and events collected from frame results alone: no recording, no folder."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from tests.support.results.events import SeenFinder
from tests.support.results.frame_results import result
from track_range.foundation.files.output_files import OutputError
from track_range.results.table import RunRows, RunTable


def at(index: int):
    frame = result(index)
    object.__setattr__(frame.frame, "time_s", index / 10)
    return frame


def test_rows_and_events() -> None:
    rows = RunRows(fps=10.0, finder=SeenFinder(2))
    assert (len(rows), rows.seconds, rows.events) == (0, 0.0, ())
    assert rows.add(at(5)) == ()
    assert [event.track_id for event in rows.add(at(7))] == [3, 7]
    assert (len(rows), rows.frame_index, rows.starts_s, rows.last_s) == (2, [5, 7], 0.5, 0.7)
    assert rows.seconds == pytest.approx(0.3)
    assert rows.methods == {"mono", "fused", "fused_kf"}
    assert rows.table.to_arrow()["frame"].to_pylist() == [5, 5, 7, 7]
    rows.finish()
    first = rows.events
    rows.finish()
    assert rows.events == first
    assert len(first) == 2


def test_events_in_progress_are_those_of_the_end() -> None:
    rows = RunRows(finder=SeenFinder(5))
    rows.add(at(0))
    assert rows.events == ()
    rows.finish()
    assert [event.track_id for event in rows.events] == [3, 7]
    assert rows.seconds == 0.0  # the duration of the only frame is unknown


def test_frame_that_cannot_be_stored_is_not_added(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    rows = RunRows(table=RunTable(rows_per_batch=4), finder=SeenFinder(2))
    rows.add(at(0))
    with pytest.raises(OutputError, match="rows of the run"):
        rows.add(at(1))
    assert (rows.frame_index, rows.events) == ([0], ())
    rows.finish()
    assert [event.end_s for event in rows.events] == [0.0, 0.0]
