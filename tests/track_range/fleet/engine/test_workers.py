"""Fleets with real workers that die, hang, take too much memory or find their results complete."""

from __future__ import annotations

import os
import shutil
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("ray")

from tests.support.networks.depth_networks import write_depth
from tests.track_range.fleet.killing import killed_workers
from tests.track_range.fleet.ray_clusters import OBJECT_STORE_BYTES
from tests.track_range.fleet.stub_clips import process_stub, stub_clips
from track_range.fleet.engine import driver, fleet_run, plan
from track_range.fleet.engine.fleet_run import run_fleet
from track_range.fleet.engine.remaining import present_fingerprint
from track_range.fleet.engine.worker import shared_files, with_shared_files
from track_range.fleet.errors import FleetError
from track_range.fleet.output.data_set import publish_record, read_clips
from track_range.fleet.output.state import locked_output, read_state
from track_range.fleet.settings import FleetSettings
from track_range.fleet.storage.location import Location
from track_range.foundation.files.folder_lock import FolderLockError

pytestmark = pytest.mark.slow


@pytest.fixture
def run(cluster, tmp_path):
    """`run(*names, **settings)` processes stub clips and gives the result and the rows by clip."""

    def process(*names, clips=None, of_runs=None, **settings):
        out = tmp_path / "out"
        chosen = clips or stub_clips(tmp_path / "clips", *names)
        options = {"workers": 2, "worker_memory": "1GB", **settings}
        fleet = FleetSettings(recordings=("x",), out=str(out), address=cluster.address, **options)
        result = run_fleet(fleet, of_runs or {}, chosen, process=process_stub)
        rows = {row["clip"]: row for row in read_clips(Location.of(out)).to_pylist()}
        return result, rows

    return process


def test_all_clips_are_processed(run, tmp_path):
    names = [f"clip {number}/ü=%".replace("/", "-") for number in range(7)]
    result, rows = run(*names)
    assert sorted(rows) == sorted(names)
    assert {row["status"] for row in rows.values()} == {"done"}
    assert result.counts.done == 7
    assert not list((tmp_path / "out" / "journal").iterdir())
    assert len(list((tmp_path / "out" / "tracks").rglob("*.parquet"))) == 7
    assert read_state(Location.of(tmp_path / "out")).state == "finished"


def test_crash_costs_one_repetition(run):
    _, rows = run("a", "crash-once", "b")
    assert {row["status"] for row in rows.values()} == {"done"}
    assert rows["crash-once"]["attempts"] == 2


def test_clip_that_always_crashes(run):
    result, rows = run("a", "crash", "b", "c")
    assert rows["crash"]["error_kind"] == "crash"
    assert rows["crash"]["attempts"] == 2
    assert [name for name, _ in result.failed] == ["crash"]
    assert result.counts.done == 3


def test_defect_of_the_program_is_a_row(run):
    _, rows = run("a", "raise")
    assert rows["raise"]["error_kind"] == "internal"
    assert "a defect" in rows["raise"]["error"]
    assert rows["a"]["status"] == "done"


def test_hanging_clip(run, monkeypatch):
    monkeypatch.setattr(driver, "BASE_S", 2.0)
    _, rows = run("a", "hang", "hang-once", timeout=1.0)
    assert rows["hang"]["error_kind"] == "timeout"
    assert rows["hang"]["attempts"] == 2
    assert rows["hang-once"]["status"] == "done"


def test_memory_limit(run):
    _, rows = run("a", "memory", "memory-once", worker_memory="600MB")
    assert rows["memory"]["error_kind"] == "memory"
    assert "--worker-memory" in rows["memory"]["error"]
    assert rows["memory-once"]["status"] == "done"


def test_unchanged_clips_are_skipped(run, tmp_path):
    _, before = run("a", "b")
    result, after = run("a", "b", "c")
    assert (result.counts.skipped, result.counts.done) == (2, 1)
    assert after["a"] == before["a"]


def test_changed_clip_is_redone_if_its_result_may_be_replaced(run, tmp_path):
    run("a", "b")
    (tmp_path / "clips" / "a.mp4").write_text("other")
    result, _ = run("a", "b")
    assert (result.counts.skipped, result.counts.done, result.kept) == (2, 0, ["a"])
    result, _ = run("a", "b", overwrite=True)
    assert (result.counts.skipped, result.counts.done, result.kept) == (1, 1, [])
    files = list((tmp_path / "out" / "tracks" / "clip=a").iterdir())
    assert len(files) == 1
    assert b"other" in files[0].read_bytes()


def test_a_result_stays_complete_if_a_further_file_cannot_be_made(run, tmp_path):
    (clip,) = stub_clips(tmp_path / "clips", "raise")
    usual = plan.fleet_plan(FleetSettings(recordings=("x",), out=str(tmp_path / "out")), {})
    record = replace(usual.record(clip, 1), status="done", inputs=present_fingerprint(clip))
    publish_record(usual.out, record.row())
    result, rows = run("raise", of_runs={"overlay": True})
    assert (rows["raise"]["status"], result.counts.failed) == ("done", 1)
    assert [name for name, _ in result.failed] == ["raise"]
    result, _ = run("raise")
    assert (result.counts.skipped, result.failed) == (1, [])


def test_touched_clip_is_not_redone(run, tmp_path):
    _, before = run("a", "b")
    os.utime(tmp_path / "clips" / "a.mp4", (1, 1))
    result, after = run("a", "b")
    assert (result.counts.skipped, result.counts.done) == (2, 0)
    assert after["a"]["finished_utc"] == before["a"]["finished_utc"]
    assert after["a"]["inputs"] != before["a"]["inputs"]


def test_failed_clips_are_repeated_on_request(run):
    run("a", "raise")
    result, rows = run("a", "raise")
    assert result.counts.failed == 1
    assert [name for name, _ in result.failed] == ["raise"]
    before = rows["raise"]["finished_utc"]
    time.sleep(1.1)
    result, rows = run("a", "raise", retry_failed=True)
    assert rows["raise"]["finished_utc"] > before
    assert result.counts.skipped == 1


def test_killed_workers_leave_one_result_each(run, tmp_path, monkeypatch):
    monkeypatch.setattr(fleet_run, "HEARTBEAT_S", 0.2)  # fleet.json names the processes to kill
    with killed_workers(tmp_path / "out", 6) as killed:
        _, rows = run(*(f"slow-{number}" for number in range(20)))
    assert killed
    assert len(rows) == 20
    assert {row["status"] for row in rows.values()} == {"done"}
    assert sum(row["attempts"] for row in rows.values()) > 20
    files = {path.name for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert files == {"fleet.json", "clips.parquet", "tracks.parquet"}


def test_lost_node(run, cluster, tmp_path, monkeypatch):
    """A node is lost while all workers but one are on it; its clips are not counted as failed."""
    monkeypatch.setattr(fleet_run, "HEARTBEAT_S", 0.2)
    node = cluster.add_node(
        num_cpus=2, object_store_memory=OBJECT_STORE_BYTES, resources={"other": 1}
    )
    lost = []

    def lose():
        out = Location.of(tmp_path / "out")
        while not any(worker["clip"] for worker in getattr(read_state(out), "workers", ())):
            time.sleep(0.2)
        time.sleep(1.0)
        cluster.remove_node(node, allow_graceful=False)
        lost.append(len(read_clips(out)))

    thread = threading.Thread(target=lose)
    thread.start()
    result, rows = run(*(f"slow-{number}" for number in range(100)), workers=6)
    thread.join()
    assert lost[0] < 100
    assert result.counts.done == 100
    assert {row["status"] for row in rows.values()} == {"done"}


def test_unwritable_output_ends_the_run(run, tmp_path):
    run("a", "b")
    tracks = tmp_path / "out" / "tracks"
    shutil.rmtree(tracks / "clip=b")
    (tracks / "clip=c").write_text("a file where a folder has to be")
    with pytest.raises(FleetError, match="clip=c"):
        run("a", "c", "d")
    rows = read_clips(Location.of(tmp_path / "out")).to_pylist()
    assert {row["clip"]: row["status"] for row in rows if row["clip"] != "d"} == {
        "a": "done",
        "b": "done",
    }
    state = read_state(Location.of(tmp_path / "out"))
    assert state.state == "failed"
    assert "clip=c" in state.reason


def test_full_disk_of_a_worker_ends_the_run(run):
    with pytest.raises(FleetError, match="cannot be stored"):
        run("a", "full")


def test_killed_workers_leave_no_files(run, tmp_path, monkeypatch):
    monkeypatch.setattr(driver, "BASE_S", 2.0)
    cache = tmp_path / "cache"
    run("a", "crash", "hang-once", "b", cache_dir=cache, timeout=0.1)
    assert list(cache.iterdir()) == []


def test_stopped_run_leaves_no_files(run, tmp_path):
    cache = tmp_path / "cache"
    with pytest.raises(FleetError, match="cannot be stored"):
        run("hang", "full", cache_dir=cache)
    assert list(cache.iterdir()) == []


def test_shared_files_reach_other_machines(tmp_path):
    """The workers get the content, since the path of the driver may not exist where they are."""
    names = tmp_path / "names.txt"
    names.write_text("car\nbus\n")
    settings = FleetSettings(recordings=("x",), out=str(tmp_path))
    made = plan.FleetPlan(
        settings=settings, options={"names": str(names), "sgbm": False}, shared=("names",)
    )
    files = shared_files(made)
    copied = with_shared_files(made, files, tmp_path / "worker")
    assert Path(copied.options["names"]).read_text() == "car\nbus\n"
    assert Path(copied.options["names"]).name == "names.txt"
    assert copied.options["sgbm"] is False


def test_networks_reach_other_machines_with_their_settings(tmp_path):
    models = [write_depth(tmp_path / name, constant=9.0) for name in ("a.onnx", "b.onnx")]
    settings = FleetSettings(recordings=("x",), out=str(tmp_path))
    made = plan.fleet_plan(settings, {"depth_model": models})
    copied = with_shared_files(made, shared_files(made), tmp_path / "worker")
    copies = [Path(path) for path in copied.options["depth_model"]]
    assert [path.name for path in copies] == ["a.onnx", "b.onnx"]
    for copy, model in zip(copies, models, strict=True):
        assert copy.read_bytes() == model.read_bytes()
        assert copy.with_suffix(".yaml").read_text() == model.with_suffix(".yaml").read_text()


def test_second_driver_is_refused(run, tmp_path):
    with locked_output(Location.of(tmp_path / "out")), pytest.raises(FolderLockError):
        run("a")
    assert run("a")[0].counts.done == 1


def test_versions_must_be_equal(run, monkeypatch):
    monkeypatch.setattr(plan, "version", lambda name: "9.9")
    with pytest.raises(FleetError, match=r"9\.9"):
        run("a")


def test_worker_that_cannot_start(run, monkeypatch):
    monkeypatch.setattr(driver, "process_clip", unusable)
    with pytest.raises(FleetError, match=r"cannot start.*'av'"):
        run("a")


def unusable(*arguments):
    """As a worker without a package."""
    yield from ()
    raise ModuleNotFoundError("No module named 'av'")
