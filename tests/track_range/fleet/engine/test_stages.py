"""A clip with a complete result of other options is computed from the first stage that changed."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace

import pyarrow as pa
import pytest
from pyarrow import parquet

from track_range.fleet.engine.clip_run import run_clip
from track_range.fleet.engine.plan import ClipProgress, ClipTask, fleet_plan
from track_range.fleet.engine.remaining import remaining
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.output.data_set import (
    ClipTable,
    detections_location,
    events_location,
    poses_location,
    read_clips,
    runs_location,
    tracks_location,
)
from track_range.fleet.settings import FleetSettings
from track_range.fleet.storage.location import Location

pytestmark = pytest.mark.slow

USUAL = {"sgbm": False}
# thresholds with which the small drive has events
FOLLOWING = {"close_headway_s": 30.0, "min_following_s": 0.1, "min_ego_mps": 0.1}


def plan_of(out, *, overwrite=False, reports=False, **options):
    settings = FleetSettings(recordings=("x",), out=str(out), overwrite=overwrite, reports=reports)
    return fleet_plan(settings, {**USUAL, **options})


@pytest.fixture(scope="module")
def clip(small_drive):
    """The small drive, with its calibration beside it."""
    return Clip("a", str(small_drive.left), str(small_drive.right))


def processed(plan, clip, **task):
    """The outcome of a clip; its record is as a driver would have it afterwards."""
    outcome = run_clip(ClipTask(clip, **task), plan, ClipProgress())
    assert not outcome.fatal
    assert outcome.row.get("error", "") == ""
    if outcome.changes is not None:
        table = ClipTable(plan.out)
        table.touch(clip.name, outcome.changes)
        table.compile()
    return outcome


def todo_of(plan, clip):
    tasks, n_complete, _ = remaining(
        [clip], ClipTable(plan.out), plan.keys, is_failed_repeated=False
    )
    return tasks[0] if tasks else n_complete


def continued(plan, clip):
    """The task that is left for a clip, after it was processed."""
    task = todo_of(plan, clip)
    processed(
        plan, clip, **{name: getattr(task, name) for name in ("stage", "made", "is_replaced")}
    )
    assert todo_of(plan, clip) == 1
    return task


def rows_of(location):
    return parquet.ParquetFile(location.path).read().replace_schema_metadata(None)


@pytest.fixture(scope="module")
def fresh(clip, tmp_path_factory):
    """Results of options in new folders, each computed once."""
    made = {}

    def results(**options):
        key = json.dumps(options, sort_keys=True)
        if key not in made:
            made[key] = plan_of(tmp_path_factory.mktemp("fresh"), **options)
            processed(made[key], clip)
        return made[key].out

    return results


@pytest.fixture
def out(fresh, tmp_path):
    """A copy of the usual results."""
    return shutil.copytree(fresh().path, tmp_path / "out")


def test_repeated_options_leave_nothing_to_do(out, clip):
    assert todo_of(plan_of(out), clip) == 1
    assert todo_of(plan_of(out, overlay=False, write=("parquet",)), clip) == 1
    (row,) = read_clips(Location.of(out)).to_pylist()
    assert row["outputs"] == []
    assert len({row["detections_key"], row["tracks_key"], row["events_key"]}) == 3


@pytest.mark.parametrize(
    ("options", "stage"),
    [
        ({"classes": ("car",)}, "detections"),
        ({"anonymize": True}, "detections"),
        ({"tracker": "sort"}, "tracks"),
        ({"warning_options": {"on_probability": 0.5}}, "tracks"),
        ({"ego_speed": "30"}, "tracks"),
        ({"event_options": FOLLOWING}, "events"),
        ({"overlay": True}, "outputs"),
        ({"write": ("csv",)}, "outputs"),
        ({"reports": True}, "outputs"),
        ({"tracker": "sort", "overlay": True}, "tracks"),
    ],
)
def test_the_first_stage_that_an_option_changes(out, clip, options, stage):
    task = todo_of(plan_of(out, **options), clip)
    assert (task.stage, task.is_replaced) == (stage, stage != "outputs")


def test_tracks_from_stored_boxes_are_those_of_a_new_run(out, clip, fresh):
    before = rows_of(detections_location(Location.of(out), "a"))
    plan = plan_of(out, ego_speed="30", overwrite=True)
    assert continued(plan, clip).stage == "tracks"
    expected = fresh(ego_speed="30")
    for location in (tracks_location, events_location, poses_location, detections_location):
        assert rows_of(location(plan.out, "a")).equals(rows_of(location(expected, "a")))
    assert rows_of(detections_location(plan.out, "a")).equals(before)
    assert not rows_of(tracks_location(plan.out, "a")).equals(
        rows_of(tracks_location(fresh(), "a"))
    )


def test_stored_boxes_take_the_place_of_the_detector(out, clip):
    """Without its boxes, the same clip has no tracks."""
    place = detections_location(Location.of(out), "a")
    table = parquet.ParquetFile(place.path).read()
    n = table.num_rows
    numbers = [i for i, name in enumerate(table.column_names) if name == "class_id"]
    assert pa.compute.max(table["class_id"]).as_py() >= 0
    parquet.write_table(table.set_column(numbers[0], "class_id", pa.array([-1] * n)), place.path)
    plan = plan_of(out, tracker="sort", overwrite=True)
    continued(plan, clip)
    assert rows_of(tracks_location(plan.out, "a")).num_rows == 0
    # of another detector, they do not count
    plan = plan_of(out, classes=("car", "truck"), overwrite=True)
    assert continued(plan, clip).stage == "detections"
    assert rows_of(tracks_location(plan.out, "a")).num_rows > 0


def test_damaged_boxes_are_found_again(out, clip, fresh):
    detections_location(Location.of(out), "a").write_bytes(b"PAR1")
    plan = plan_of(out, tracker="sort", overwrite=True)
    continued(plan, clip)
    expected = rows_of(tracks_location(fresh(tracker="sort"), "a"))
    assert rows_of(tracks_location(plan.out, "a")).equals(expected)


def test_events_from_stored_rows_are_those_of_a_new_run(out, clip, fresh):
    plan = plan_of(out, event_options=FOLLOWING, overwrite=True)
    before = tracks_location(plan.out, "a").path.stat().st_mtime_ns
    assert continued(plan, replace(clip, left=clip.left)).stage == "events"
    expected = rows_of(events_location(fresh(event_options=FOLLOWING), "a"))
    assert expected.num_rows > 0
    found = rows_of(events_location(plan.out, "a"))
    for name in expected.column_names:
        if pa.types.is_floating(expected.schema.field(name).type):
            values = zip(found[name].to_pylist(), expected[name].to_pylist(), strict=True)
            assert all(a == b or a == pytest.approx(b, rel=1e-6) for a, b in values), name
        else:
            assert found[name].equals(expected[name]), name
    assert tracks_location(plan.out, "a").path.stat().st_mtime_ns == before
    (row,) = read_clips(plan.out).to_pylist()
    assert (row["events"], row["status"]) == (expected.num_rows, "done")


def test_events_need_no_recording(out, clip):
    """But their recording must be the same, which its size and time tell."""
    plan = plan_of(out, event_options=FOLLOWING, overwrite=True)
    outcome = run_clip(
        ClipTask(replace(clip, left="/missing.mp4"), stage="events"), plan, ClipProgress()
    )
    assert outcome.changes["events"] > 0


def test_a_table_is_made_from_the_stored_rows(out, clip, fresh):
    plan = plan_of(out, write=("csv", "mot"))
    task = todo_of(plan, clip)
    outcome = processed(plan, replace(clip, left="/missing.mp4"), stage=task.stage)
    assert outcome.changes == {"outputs": ["csv", "mot"]}
    expected = runs_location(fresh(write=("csv", "mot")), "a").path
    made = runs_location(plan.out, "a").path
    assert {file.name for file in made.iterdir()} == {file.name for file in expected.iterdir()}
    for file in made.iterdir():
        with file.open() as ours, (expected / file.name).open() as theirs:
            assert list(csv.reader(ours)) == list(csv.reader(theirs)), file.name
    assert todo_of(plan, clip) == 1
    assert todo_of(plan_of(out), clip) == 1  # without them


def test_a_missing_overlay_is_made_alone(out, clip):
    plan = plan_of(out, overlay=True)
    before = tracks_location(plan.out, "a").path.stat().st_mtime_ns
    assert continued(plan, clip).stage == "outputs"
    assert [file.name for file in runs_location(plan.out, "a").path.glob("*.mp4")] == [
        "overlay.mp4"
    ]
    assert tracks_location(plan.out, "a").path.stat().st_mtime_ns == before
    other = plan_of(out, overlay=True, overlay_recorded=True)
    assert todo_of(other, clip).is_replaced  # overlay.mp4 would be another one


def test_events_know_their_clips_and_new_ones_remove_them(out, clip):
    options = {"overlay": True, "clips": True, "event_options": FOLLOWING}
    plan = plan_of(out, overwrite=True, **options)
    assert continued(plan, clip).stage == "events"
    (name,) = set(rows_of(events_location(plan.out, "a"))["clip_file"].to_pylist())
    assert name.startswith("runs/clip=a/clips/01-")
    assert (out / name).is_file()
    in_table = out / "runs/clip=a/events.csv"
    assert "clips/01-" in in_table.read_text()
    assert todo_of(plan_of(out, event_options=FOLLOWING), clip) == 1
    continued(plan_of(out, overwrite=True), clip)
    assert not (out / name).exists()
    assert (out / "runs/clip=a/overlay.mp4").is_file()
    (row,) = read_clips(plan.out).to_pylist()
    assert (row["outputs"], row["events"]) == (["overlay"], 0)


def test_clips_that_are_made_later_are_named_in_tables_of_earlier_files(out, clip):
    options = {"overlay": True, "event_options": FOLLOWING}
    continued(plan_of(out, overwrite=True, **options), clip)
    in_table = out / "runs/clip=a/events.csv"
    assert "clips/01-" not in in_table.read_text()
    assert continued(plan_of(out, clips=True, **options), clip).stage == "outputs"
    assert "clips/01-" in in_table.read_text()


def test_counts_are_kept(clip, tmp_path):
    left = replace(clip, right=None)
    plan = plan_of(tmp_path / "out", static_camera=True, count_line=("gate=50,120,560,120",))
    processed(plan, left)
    assert runs_location(plan.out, "a").child("crossings.csv").exists()
    assert todo_of(plan, left) == 1


def test_other_recordings_are_not_replaced_unasked(out, clip):
    plan = plan_of(out)
    outcome = run_clip(ClipTask(clip, known_hash="sha256:0", stage=""), plan, ClipProgress())
    assert (outcome.is_kept, outcome.changes) == (True, None)
    outcome = processed(plan_of(out, overwrite=True), clip, known_hash="sha256:0", stage="")
    assert outcome.row["status"] == "done"
