"""Clips without videos, and a processing of them in real workers that fails according to their
names."""

from __future__ import annotations

import os
import resource
import signal
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pyarrow as pa

from track_range.fleet.engine.plan import ClipOutcome, ClipProgress, ClipTask, FleetPlan
from track_range.fleet.engine.remaining import content_hash, fingerprint
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.output.data_set import publish, publish_record, tracks_location
from track_range.fleet.storage.errors import StorageError


def stub_clips(folder: Path, *names: str) -> list[Clip]:
    """Clips with a small file each."""
    folder.mkdir(exist_ok=True)
    clips = []
    for name in names:
        file = folder / f"{name}.mp4"
        if not file.exists():
            file.write_text(name)
        clips.append(Clip(name, str(file)))
    return clips


def process_stub(task: ClipTask, plan: FleetPlan, progress: ClipProgress) -> ClipOutcome:
    """Fail according to the name of the clip, else publish one row."""
    progress.phase, progress.video_s = "processing", 1.0
    name = task.clip.name
    if name.startswith("slow"):
        time.sleep(0.5)
    for failure, fail in FAILURES.items():
        if name.startswith(failure) and (task.attempt == 1 or "once" not in name):
            fail()
    try:
        return published(task, plan)
    except (OSError, StorageError) as error:
        return ClipOutcome({}, fatal=str(error))
    finally:  # a process takes other clips afterwards
        hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))


def published(task: ClipTask, plan: FleetPlan) -> ClipOutcome:
    """The outcome of a clip with one row in tracks.parquet."""
    clip, out = task.clip, plan.out
    stat = os.stat(clip.left)
    digest = Path(clip.left).read_text()
    record = replace(
        plan.record(clip, task.attempt),
        status="done",
        inputs=fingerprint(clip, {"left": (stat.st_size, stat.st_mtime_ns)}),
        content_hash=content_hash(clip, {"left": digest}),
        seconds=1.0,
        finished_utc=f"{time.time()}",
        stages_ms={"read": 1.5},
    )
    if task.known_hash == record.content_hash:
        return ClipOutcome({}, {"inputs": record.inputs})
    if task.known_hash and not plan.settings.overwrite:
        return ClipOutcome({}, is_kept=True)
    table = pa.table({"frame": [0], "text": [digest]})
    from pyarrow import parquet

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "tracks.parquet"
        parquet.write_table(table, file)
        publish(out, tracks_location(out, clip.name), file)
    publish_record(out, record.row())
    return ClipOutcome(record.row())


def _crash() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _hang() -> None:
    time.sleep(3600)


def _allocate() -> None:
    blocks = [b"x" * 700_000_000]
    time.sleep(20)
    blocks.clear()


def _raise() -> None:
    raise ValueError("a defect")


def _full() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


FAILURES: dict[str, Callable[[], None]] = {
    "crash": _crash,
    "hang": _hang,
    "memory": _allocate,
    "raise": _raise,
    "full": _full,
}
"""What happens by the beginning of a clip's name; only in the first attempt if the name contains
"once"."""
