"""A fleet of the rows of a manifest with a stub instead of the processing, for the cost of the
control path.

`python -m benchmarks.fleet.stub MANIFEST OUT` prints the time and the memory of this process as
JSON.
"""

from __future__ import annotations

import json
import os
import sys
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from track_range.fleet.engine import worker
from track_range.fleet.engine.fleet_run import run_fleet
from track_range.fleet.engine.plan import ClipOutcome, ClipProgress, ClipTask, FleetPlan
from track_range.fleet.engine.remaining import content_hash, present_fingerprint
from track_range.fleet.inputs.listing import clips_of
from track_range.fleet.output.data_set import publish_record, read_clips
from track_range.fleet.settings import FleetSettings
from track_range.fleet.storage.location import Location

_METHODS = ("mono", "ground", "lane", "stereo", "fused", "mono_kf", "stereo_kf", "fused_kf")
_STAGES = ("read", "detect", "track", "mono", "stereo", "fuse", "write")


def publish_stub(task: ClipTask, plan: FleetPlan, _progress: ClipProgress) -> ClipOutcome:
    """Publish a record of the usual size, without tracks."""
    record = replace(
        plan.record(task.clip, task.attempt),
        status="done",
        inputs=present_fingerprint(task.clip),
        content_hash=content_hash(task.clip, {"left": task.clip.name}),
        frames=600,
        rows=3000,
        tracks=40,
        seconds=60.0,
        wall_s=40.0,
        overhead_s=0.1,
        calibration="rig",
        node="node",
        peak_memory_mb=500.0,
        finished_utc=datetime.now(UTC).isoformat(),
        stages_ms=dict.fromkeys(_STAGES, 1.5),
        coverage=dict.fromkeys(_METHODS, 0.9),
    )
    publish_record(plan.out, record.row())
    return ClipOutcome(record.row())


def main() -> None:
    manifest, out = sys.argv[1:]
    start_s = time.perf_counter()
    clips = clips_of((manifest,), None, None)
    listed_s = time.perf_counter() - start_s
    # the start of new processes is a part of the overhead of real clips, not of the driver
    worker.CLIPS_PER_PROCESS = len(clips)
    settings = FleetSettings(
        recordings=(manifest,), out=out, workers=os.cpu_count() or 1, worker_memory="1GB"
    )
    result = run_fleet(settings, {}, clips, process=publish_stub)
    peak_mb = _peak_mb()  # before the results are read for the times below
    counts = result.counts
    figures = {
        "clips": counts.total,
        "done": counts.done,
        "skipped": counts.skipped,
        "listed_s": listed_s,
        "wall_s": time.perf_counter() - start_s,
        "driver_cpu_s": time.process_time(),
        "work_s": _work_s(Location.of(out)),
        "driver_peak_mb": peak_mb,
    }
    print(json.dumps(figures))


def _work_s(out: Location) -> float:
    """Time from the first end of a clip to the last, s."""
    ends_s = [
        datetime.fromisoformat(text).timestamp()
        for text in read_clips(out)["finished_utc"].to_pylist()
    ]
    return max(ends_s) - min(ends_s)


def _peak_mb() -> float:
    """Largest resident memory of this process, MB; that of getrusage includes the parent
    process.
    """
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1e3


if __name__ == "__main__":
    main()
