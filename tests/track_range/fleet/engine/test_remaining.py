"""Why clips with results are processed again, and that finished results are not replaced unasked."""

from dataclasses import replace

import pytest

from tests.track_range.fleet.fleet_results import done_record
from track_range.fleet.engine.fleet_run import run_fleet
from track_range.fleet.engine.plan import ClipTask, StageKeys, fleet_plan, named_options
from track_range.fleet.engine.remaining import (
    WouldReplaceError,
    present_fingerprint,
    remaining,
    work_text,
)
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.output.data_set import ClipTable, publish_record
from track_range.fleet.output.record import ClipRecord
from track_range.fleet.output.state import FleetState
from track_range.fleet.settings import FleetSettings
from track_range.fleet.storage.location import Location


@pytest.fixture
def clip(tmp_path):
    """A clip with a file."""
    video = tmp_path / "a.mp4"
    video.write_bytes(b"x")
    return Clip("a", str(video))


def plan_of(tmp_path, **options):
    return fleet_plan(FleetSettings(recordings=("x",), out=str(tmp_path / "out")), options)


def left(plan, *clips, repeated=False):
    """What is left of clips."""
    return remaining(clips, ClipTable(plan.out), plan.keys, is_failed_repeated=repeated)


def test_results_of_other_options(tmp_path):
    out = Location.of(tmp_path)
    publish_record(out, done_record("a").row())  # of an earlier version, with the hash sha256:1
    clips = [Clip(name, str(tmp_path / f"{name}.mp4")) for name in ("a", "b")]
    table = ClipTable(out)
    table.compile()
    keys = StageKeys(former="sha256:2")
    todo, *counts = remaining(clips, table, keys, is_failed_repeated=False)
    assert counts == [0, 0]
    assert work_text(todo, 0) == (
        "2 clips to process (1 with a result of other options, 1 all over again), 0 complete"
    )
    keys = StageKeys(former="sha256:1")
    todo, *counts = remaining(clips, table, keys, is_failed_repeated=False)
    assert [task.is_replaced for task in todo] == [False, False]


def test_touched_files():
    touched = ClipTask(Clip("a", "/a.mp4"), known_hash="sha256:3", stage="")
    assert "(1 complete if the content" in work_text([touched], 4)
    assert work_text([], 4) == "0 clips to process, 4 complete"


def test_files_of_a_complete_result(tmp_path, clip):
    plan = plan_of(tmp_path)
    record = replace(plan.record(clip, 1), status="done", content_hash="sha256:4")
    publish_record(plan.out, replace(record, inputs=present_fingerprint(clip)).row())
    assert left(plan, clip) == ([], 1, 0)
    publish_record(plan.out, record.row())
    assert left(plan, clip)[0] == [ClipTask(clip, known_hash="sha256:4", stage="")]


def test_failed_clips_are_repeated_with_other_options_of_tracks_or_events(tmp_path, clip):
    plan = plan_of(tmp_path)
    failed = replace(plan.record(clip, 1), error="no video", inputs=present_fingerprint(clip))
    publish_record(plan.out, failed.row())
    assert left(plan, clip) == ([], 0, 1)
    assert left(plan_of(tmp_path, overlay=True), clip) == ([], 0, 1)
    for again in (
        left(plan, clip, repeated=True),
        left(plan_of(tmp_path, tracker="sort"), clip),
        left(plan_of(tmp_path, event_options={"max_gap_s": 2.0}), clip),
    ):
        assert again == ([ClipTask(clip)], 0, 0)


@pytest.mark.parametrize(("options", "is_same"), [({}, True), ({"tracker": "sort"}, False)])
def test_results_of_earlier_versions(tmp_path, clip, options, is_same):
    """Their records have one hash of all options."""
    plan = plan_of(tmp_path)
    record = ClipRecord(
        clip="a",
        status="done",
        settings_hash=plan.keys.former,
        inputs=present_fingerprint(clip),
    )
    publish_record(plan.out, record.row())
    todo, n_complete, _ = left(plan_of(tmp_path, **options), clip)
    assert (len(todo), n_complete) == ((0, 1) if is_same else (1, 0))


def test_finished_results_are_not_replaced_unasked(tmp_path, clip):
    plan = plan_of(tmp_path)
    publish_record(plan.out, replace(plan.record(clip, 1), status="done").row())
    options = {"run": {"threads": 7, "clips": True}}  # which replace nothing
    FleetState(state="finished", options=options).write(plan.out)
    before = (tmp_path / "out/fleet.json").read_bytes()
    with pytest.raises(WouldReplaceError, match=r"\(--tracker\).*of 1 clip; .*--overwrite"):
        run_fleet(plan.settings, {"tracker": "sort"}, [clip])
    assert (tmp_path / "out/fleet.json").read_bytes() == before


def test_results_of_another_version_are_not_replaced_unasked(tmp_path, clip):
    plan = plan_of(tmp_path)
    record = replace(plan.record(clip, 1), status="done", tracks_key="of another version")
    publish_record(plan.out, record.row())
    FleetState(state="finished", options=named_options(plan)).write(plan.out)
    with pytest.raises(WouldReplaceError, match="another version of track-range"):
        run_fleet(plan.settings, plan.options, [clip])


def test_a_clip_table_of_an_earlier_version_lacks_columns(tmp_path, clip):
    """Those of the stages are added, so that its clips are complete."""
    plan = plan_of(tmp_path)
    row = ClipRecord(
        clip="a",
        status="done",
        settings_hash=plan.keys.former,
        inputs=present_fingerprint(clip),
    ).row()
    table = ClipTable(plan.out)
    table.add(row, is_in_journal=False)
    table.compile()
    file = plan.out.child("clips.parquet")
    from pyarrow import parquet

    earlier = parquet.read_table(file.path).drop_columns(
        ["detections_key", "tracks_key", "events_key", "outputs"]
    )
    parquet.write_table(earlier, file.path)
    assert left(plan, clip) == ([], 1, 0)
