"""Why clips with results are processed again."""

from tests.track_range.fleet.fleet_results import done_record
from track_range.fleet.engine.plan import ClipTask
from track_range.fleet.engine.remaining import remaining, work_text
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.output.data_set import ClipTable, publish_record
from track_range.fleet.storage.location import Location


def test_results_of_other_options(tmp_path):
    out = Location.of(tmp_path)
    publish_record(out, done_record("a").row())  # with the hash sha256:1
    clips = [Clip(name, str(tmp_path / f"{name}.mp4")) for name in ("a", "b")]
    table = ClipTable(out)
    table.compile()
    todo, *counts = remaining(clips, table, "sha256:2", is_failed_repeated=False)
    assert counts == [0, 0]
    assert work_text(todo, 0) == "2 clips to process (1 with a result of other options), 0 complete"
    todo, *counts = remaining(clips, table, "sha256:1", is_failed_repeated=False)
    assert [task.has_other_options for task in todo] == [False, False]


def test_touched_files():
    touched = ClipTask(Clip("a", "/a.mp4"), known_hash="sha256:3")
    assert "(1 complete if the content" in work_text([touched], 4)
    assert work_text([], 4) == "0 clips to process, 4 complete"
