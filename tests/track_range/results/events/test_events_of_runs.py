"""Events of a run: while it goes on, at its end, stopped early, and after a kill."""

import json
import math

import pytest

import track_range as tr
from tests.support.results.events import SeenFinder, event
from tests.support.results.run_folder import N_FRAMES, write_run
from track_range.foundation.files.output_files import OutputError
from track_range.results.events import finder
from track_range.results.events.event import severity_key
from track_range.results.events.files import read_events, write_event_files
from track_range.results.folder import read_run_folder
from track_range.results.summary import events_section
from track_range.views.report.run_folders import report


def recorded(drive, **options):
    run = tr.Run.stereo(
        drive.left, drive.right, detections=drive.detections, overlay=False, align="off", **options
    )
    run.session.rows.finder = SeenFinder()
    return run


def test_events_grow_and_are_complete_at_the_end(small_drive, tmp_path):
    out = tmp_path / "out"
    run = recorded(small_drive, out=out)
    counts = []
    for _ in run:
        counts.append((len(run.events), len(read_events(out / "events.csv"))))
    assert counts[0] == (0, 0)
    assert 0 < counts[-2][0] == counts[-2][1]
    events = read_events(out / "events.csv")
    assert [one.track_id for one in events] == [one.track_id for one in run.events]
    assert [one.start_s for one in read_events(out / "events.parquet")] == [
        one.start_s for one in run.events
    ]
    section = json.loads((out / "summary.json").read_text())["events"]
    assert section == run.summary["events"]
    assert section["n"] == section["by_kind"]["forward_collision"] == len(events) > 0
    assert section["hours"] == pytest.approx(run.session.rows.seconds / 3600, abs=1e-6)
    assert section["worst"]["warning_s"] is None
    assert read_run_folder(out).events == events
    assert not read_run_folder(out).are_events_replayed


def test_stopped_run_has_open_events(small_drive, tmp_path):
    run = recorded(small_drive, out=tmp_path / "out")
    for frame in run:
        if frame.index == 1:
            break
    assert len(read_events(tmp_path / "out" / "events.csv")) == len(run.events) > 0


def test_run_without_events_has_both_files(small_drive, tmp_path):
    run = tr.Run.stereo(
        small_drive.left,
        small_drive.right,
        detections=small_drive.detections,
        overlay=False,
        align="off",
        duration=0.2,
    )
    run.write(tmp_path)
    header = (tmp_path / "events.csv").read_text()
    assert header.startswith("kind,start_s,peak_s,end_s,warning_s,frame,track_id,class,")
    assert read_events(tmp_path / "events.parquet") == run.events == ()
    assert run.summary["events"]["worst"] is None


def test_killed_run_gets_its_events_back(tmp_path, monkeypatch):
    monkeypatch.setattr(finder, "EventFinder", SeenFinder)
    run = write_run(tmp_path / "run")
    (run / "summary.json").unlink()
    (run / "events.csv").write_text("kind,start_s,end_s\n")
    read = read_run_folder(run)
    assert read.are_events_replayed
    assert [(one.track_id, one.start_s) for one in read.events] == [(1, 0.0)]
    assert read.summary["events"]["n"] == 1
    assert read.summary["events"]["hours"] == pytest.approx(N_FRAMES / 36000, abs=1e-6)
    written = report([run])
    assert any("events.parquet" in sentence for sentence in written.missing)
    assert read_events(run / "events.parquet") == read_events(run / "events.csv")
    assert len(read_events(run / "events.csv")) == 1


def test_damaged_events_are_found_again(tmp_path, monkeypatch):
    monkeypatch.setattr(finder, "EventFinder", SeenFinder)
    run = write_run(tmp_path / "run")
    (run / "events.csv").write_text("kind,start_s,end_s\ncrash,1,2\n")
    read = read_run_folder(run)
    assert len(read.events) == 1
    assert any("events.csv" in note and "kinds" in note for note in read.summary["notes"])
    with pytest.raises(OutputError, match=r"events\.csv: .*damaged"):
        report([run])
    assert "crash" in (run / "events.csv").read_text()


def test_run_of_an_earlier_version_has_no_events(tmp_path):
    read = read_run_folder(write_run(tmp_path / "run"))
    assert read.events == ()
    assert not read.are_events_replayed
    assert read.summary.get("events") is None
    assert read.missing == ()


def test_events_beyond_the_video_are_ignored(tmp_path):
    run = write_run(tmp_path / "run")
    write_event_files(run, [event(start_s=0.2, end_s=0.3), event(start_s=50.0, end_s=51.0)], {})
    read = read_run_folder(run)
    assert [one.start_s for one in read.events] == [0.2]
    assert any(note.startswith("1 of 2 events") for note in read.summary["notes"])


def test_worst_event():
    quiet = event(warning_s=math.nan, probability=0.99)
    likely, near = event(probability=0.9, min_ttc_s=2.0), event(probability=0.9, min_ttc_s=1.0)
    unknown = event(probability=math.nan)
    assert sorted([quiet, unknown, likely, near], key=severity_key) == [
        near,
        likely,
        unknown,
        quiet,
    ]
    section = events_section([quiet, near], 7200.0)
    assert section["worst"]["min_ttc_s"] == 1.0
    assert (section["hours"], section["by_kind"]["cut_in"]) == (2.0, 0)
    json.dumps(section, allow_nan=False)
