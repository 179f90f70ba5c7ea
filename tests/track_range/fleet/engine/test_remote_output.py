"""Fleets with their results in an object store."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

pytest.importorskip("ray")

from tests.track_range.fleet.stub_clips import process_stub, stub_clips
from track_range.fleet.engine.fleet_run import run_fleet
from track_range.fleet.errors import FleetError
from track_range.fleet.output.data_set import read_clips
from track_range.fleet.output.state import FleetState, read_state, status_lines
from track_range.fleet.settings import FleetSettings
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location

pytestmark = pytest.mark.slow


@pytest.fixture
def out(bucket, s3_endpoint):
    """Address of a folder in a new bucket, with the server in the address, since workers do not
    have it otherwise."""
    return f"{bucket.address}/fleet?endpoint_override={s3_endpoint.partition('://')[2]}&scheme=http"


@pytest.fixture
def run(cluster, tmp_path, out):
    """`run(*names)` processes stub clips."""

    def process(*names, to=out, **settings):
        options = {"workers": 2, "worker_memory": "1GB", **settings}
        fleet = FleetSettings(recordings=("x",), out=to, address=cluster.address, **options)
        return run_fleet(fleet, {}, stub_clips(tmp_path / "clips", *names), process=process_stub)

    return process


def test_results_in_a_bucket(run, out):
    assert run("a", "b c", "crash", "crash-once").counts.done == 3
    location = Location.of(out)
    files = {entry.name for entry in location.list(recursive=True) if not entry.stat.is_folder}
    assert files == {
        *("fleet.json", "clips.parquet"),
        *(f"tracks/clip={name}/tracks.parquet" for name in ("a", "b%20c", "crash-once")),
    }
    rows = read_clips(location).to_pylist()
    assert {row["clip"]: row["status"] for row in rows} == {
        **dict.fromkeys(("a", "b c", "crash-once"), "done"),
        "crash": "failed",
    }
    again = run("a", "b c", "crash", "crash-once", "new")
    assert (again.counts.skipped, again.counts.failed, again.counts.done) == (3, 1, 1)
    assert any("4 of 5 clips done" in line for line in status_lines(location))


def test_second_driver_is_refused_by_heartbeat(run, out):
    running = FleetState(state="running", host="another", pid=1)
    running.write(Location.of(out))
    with pytest.raises(FleetError, match="another"):
        run("a")
    replace(running, heartbeat_s=time.time() - 100).write(Location.of(out))
    assert run("a").counts.done == 1
    assert read_state(Location.of(out)).state == "finished"


def test_missing_bucket_ends_the_run(run, out):
    with pytest.raises(StorageError, match="no-such-bucket"):
        run("a", to=f"s3://no-such-bucket/x?{out.partition('?')[2]}")
