"""`track-range fleet events`: events that meet a condition, and copies of their videos."""

import json
import math

import pytest

from tests.support.results.events import event
from tests.track_range.fleet.fleet_results import (
    DAWN,
    NOON,
    done_record,
    rows_table,
    track_rows,
    write_clip,
)
from track_range.fleet.errors import FleetError
from track_range.fleet.output.data_set import (
    ClipTable,
    events_location,
    publish_files,
    runs_location,
)
from track_range.fleet.report.fleet_events import fleet_events
from track_range.fleet.storage.location import Location


@pytest.fixture
def out(tmp_path):
    """Three events of two clips, one with a video."""
    location, scratch = Location.of(tmp_path / "out"), tmp_path / "scratch"
    scratch.mkdir()
    table = rows_table(track_rows(1, "car", near_m=4.0, x_m=0.0, utc_s=None))
    dawn = [
        event(kind="cut_in", min_ttc_s=1.0, clip_file=f"runs/{DAWN}/clips/01-cut_in-7.mp4"),
        event(kind="near_miss", warning_s=math.nan, min_ttc_s=math.nan),
    ]
    start = {"start_utc": "2026-05-04T07:50:00Z"}
    write_clip(location, done_record(DAWN, **start), table, scratch, dawn)
    noon = [event(kind="cut_in", min_ttc_s=3.0, track_id=9)]
    record = done_record(NOON, labels={"vehicle": "bus"})
    write_clip(location, record, table, scratch, noon)
    write_clip(location, done_record("nothing"), table, scratch, [])
    ClipTable(location).compile()
    video = scratch / "01-cut_in-7.mp4"
    video.write_bytes(b"video")
    publish_files(location, runs_location(location, DAWN).child("clips"), [video])
    return location


def names(listed):
    return [(row["clip"], row["number"], row["kind"]) for row in listed.rows]


def test_events_in_order_of_severity(out):
    listed = fleet_events(out)
    assert names(listed) == [(DAWN, 1, "cut_in"), (NOON, 1, "cut_in"), (DAWN, 2, "near_miss")]
    assert (listed.n_all, listed.problems) == (3, ())
    assert listed.rows[0]["clip_file"].endswith("01-cut_in-7.mp4")


@pytest.mark.parametrize(
    ("condition", "expected"),
    [
        ('kind == "cut-in" and min_ttc_s < 2', [(DAWN, 1, "cut_in")]),
        ('vehicle == "bus"', [(NOON, 1, "cut_in")]),
        (f'clip == "{NOON}" or warning_s is None', [(NOON, 1, "cut_in"), (DAWN, 2, "near_miss")]),
        ("min_ttc_s > 100", []),
    ],
)
def test_condition_on_events_and_labels(out, condition, expected):
    assert names(fleet_events(out, condition)) == expected


def test_missing_events_are_named_and_no_fleet_is_an_error(out, tmp_path):
    events_location(out, NOON).remove()
    listed = fleet_events(out, 'kind == "cut-in"')
    assert names(listed) == [(DAWN, 1, "cut_in")]
    assert [NOON in problem for problem in listed.problems] == [True]
    with pytest.raises(FleetError, match="no clips"):
        fleet_events(tmp_path)


def test_command_copies_videos_and_writes_all_columns(out, tmp_path, cli):
    options = ("--clips", tmp_path / "cut-ins", "--json", tmp_path / "a.json")
    status, printed, error = cli("fleet", "events", out, 'kind == "cut-in"', *options)
    assert (status, error) == (0, "")
    (video,) = (tmp_path / "cut-ins").iterdir()
    assert video.name == "van%201%2F2026%20%C3%A4%25-01-cut_in-7.mp4"
    assert video.read_bytes() == b"video"
    text = " ".join(printed.split())
    assert "2 of 3 events" in text
    assert "1 event without a video" in text
    content = json.loads((tmp_path / "a.json").read_text())
    assert [row["video"] for row in content["events"]] == [video.name, None]
    assert (content["events"][1]["vehicle"], content["events"][1]["min_ttc_s"]) == ("bus", 3.0)


def test_command_takes_the_folder_second_and_explains_conditions(out, cli):
    assert "1 of 3 events" in cli("fleet", "events", "min_ttc_s < 2", out)[1]
    assert "3 of 3 events" in cli("fleet", "events", out)[1]
    status, _, error = cli("fleet", "events", "min_ttc_s < 2")
    assert (status, "folder of the results" in error) == (2, True)
    status, _, error = cli("fleet", "events", out, "min_tcc_s < 2")
    assert (status, "did you mean min_ttc_s" in error) == (1, True)
