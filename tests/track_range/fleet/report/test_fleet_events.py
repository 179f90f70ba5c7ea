"""Events in the data set and the report of a fleet."""

from __future__ import annotations

import json
import math

import pytest

from tests.support.results.events import event
from tests.track_range.fleet.fleet_results import (
    DAWN,
    DAWN_S,
    NOON,
    done_record,
    rows_table,
    track_rows,
    write_clip,
)
from track_range.fleet.output.data_set import (
    ClipTable,
    events_location,
    publish,
    publish_files,
    runs_location,
)
from track_range.fleet.report.fleet_figures import EventFigures, fleet_figures
from track_range.fleet.report.fleet_grids import fleet_sections
from track_range.fleet.report.fleet_page import fleet_page
from track_range.fleet.report.track_figures import N_RANKED
from track_range.fleet.storage.location import Location

QUIET = {"warning_s": math.nan, "probability": math.nan}


@pytest.fixture
def out(tmp_path):
    """Two clips with events, and one of an earlier version."""
    location, scratch = Location.of(tmp_path / "out"), tmp_path / "scratch"
    scratch.mkdir()
    table = rows_table(track_rows(1, "car", near_m=4.0, x_m=0.0, utc_s=None))
    of_dawn = [
        event(track_id=1, probability=0.6),
        event(kind="close_following", track_id=2, **QUIET),
    ]
    write_clip(
        location, done_record(DAWN, start_utc="2026-05-04T07:50:00Z"), table, scratch, of_dawn
    )
    write_clip(
        location,
        done_record(NOON),
        table,
        scratch,
        [event(kind="cut_in", track_id=9, probability=0.9)],
    )
    write_clip(location, done_record("old"), table, scratch)
    write_clip(location, done_record("nothing"), table, scratch, [])
    ClipTable(location).compile()
    return location


def figures_of(out):
    return json.loads(json.dumps(fleet_figures(out).figures, allow_nan=False))


def test_ranking_and_counts(out):
    figures = figures_of(out)
    assert [(row["clip"], row["kind"], row["number"]) for row in figures["events"]] == [
        (NOON, "cut_in", 1),
        (DAWN, "forward_collision", 1),
        (DAWN, "close_following", 2),
    ]
    assert {row["kind"]: row["events"] for row in figures["event_kinds"]} == {
        "forward_collision": 1,
        "close_following": 1,
        "cut_in": 1,
    }
    assert figures["event_kinds"][0]["per_hour"] == pytest.approx(0.75)
    assert figures["warnings"] == 2
    assert figures["events"][1]["utc_s"] == pytest.approx(DAWN_S + 2.25)
    assert figures["events"][0]["utc_s"] is None
    assert figures["problems"] == []


def test_events_replace_the_approaches(out, tmp_path):
    anchors = [section.anchor for section in fleet_sections(fleet_figures(out).figures)]
    assert "events" in anchors
    assert not {"closest", "collisions"} & set(anchors)
    without = Location.of(tmp_path / "without")
    table = rows_table(track_rows(1, "car", near_m=4.0, x_m=0.0, utc_s=None))
    write_clip(without, done_record("a"), table, tmp_path, [])
    sections = {
        section.anchor: section for section in fleet_sections(fleet_figures(without).figures)
    }
    assert sections["events"].grids == ()
    assert sections["closest"].grids


def test_links_lead_to_the_video_of_an_event(out, tmp_path):
    video = tmp_path / "overlay.mp4"
    video.write_text("content")
    publish(out, runs_location(out, DAWN).child("overlay.mp4"), video)
    publish(out, runs_location(out, NOON).child("overlay.mp4"), video)
    clip = tmp_path / "01-cut_in-9.mp4"
    clip.write_text("content")
    publish_files(out, runs_location(out, NOON).child("clips"), [clip])
    page = fleet_page(fleet_figures(out), out, out.child("fleet.html"))
    assert "clips/01-cut_in-9.mp4" in page
    assert "overlay.mp4#t=0.0" in page
    assert "Most severe events" in page


def test_clips_of_an_earlier_result_are_removed(out, tmp_path):
    folder = out.path / "runs" / "clip=noon" / "clips"
    for names in (("01-cut_in-9.mp4", "02-cut_in-9.mp4"), ("01-near_miss-1.mp4",), ()):
        files = [tmp_path / name for name in names]
        for file in files:
            file.write_text("content")
        publish_files(out, runs_location(out, NOON).child("clips"), files)
        assert sorted(path.name for path in folder.iterdir()) == sorted(names)


def test_missing_and_damaged_events(out):
    events_location(out, NOON).remove()
    events_location(out, DAWN).write_bytes(b"PAR1")
    figures = figures_of(out)
    assert figures["events"] == []
    assert len(figures["problems"]) == 2
    assert all("events.parquet" in problem for problem in figures["problems"])


def test_ranking_is_limited():
    total = EventFigures()
    for clip in ("b", "a"):
        total.add(EventFigures.of(clip, [event(track_id=i) for i in range(N_RANKED)]))
    assert [(item.clip, item.number) for item in total.worst[:2]] == [("a", 1), ("a", 2)]
    assert len(total.worst) == N_RANKED
    assert total.n_by_kind["forward_collision"] == 2 * N_RANKED
