"""Which clips of a fleet are left to process: fingerprints of their inputs and of earlier
results.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from sys import intern
from typing import Any, NamedTuple

from track_range.fleet.engine.plan import (
    OUTPUTS,
    ClipTask,
    FleetPlan,
    Stage,
    StageKeys,
    named_options,
    output_name,
)
from track_range.fleet.errors import FleetError
from track_range.fleet.inputs.clip import Clip, is_file_setting
from track_range.fleet.output.data_set import ClipTable
from track_range.fleet.output.state import read_state
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import FolderListings, Location
from track_range.foundation.files.input_files import counted, shortened
from track_range.run.options.settings import RunSettings

_N_CONNECTIONS = 32  # requests for sizes and times of change at a time
_N_BATCH = 2000  # clips whose files are looked up together; a request that waits takes about 1.5 kB


class _Known(NamedTuple):
    status: str
    settings_hash: str
    detections_key: str
    tracks_key: str
    events_key: str
    inputs: str
    content_hash: str
    outputs: tuple[str, ...]


class WouldReplaceError(FleetError):
    """Finished results would be replaced, which only --overwrite does."""


def remaining(
    clips: Sequence[Clip], table: ClipTable, keys: StageKeys, *, is_failed_repeated: bool
) -> tuple[list[ClipTask], int, int]:
    """Clips without a result for the present files and options, each with the first stage that is
    computed; numbers of complete and of failed clips.

    Files are compared by size and time of change; where these differ, the worker compares the
    content. Failed clips are repeated if something has changed, or `is_failed_repeated`.
    """
    known = dict(_known(table))
    todo: list[ClipTask] = []
    compared: list[tuple[ClipTask, _Known]] = []
    for clip in clips:
        result = known.get(clip.name)
        task = ClipTask(clip)
        if result is not None and result.status == "done":
            task = _task_after(clip, result, keys)
        elif result is not None and not is_failed_repeated:
            is_same = result.settings_hash in (keys.settings, keys.former)
            task = replace(task, stage="" if is_same else task.stage)
        if result is None or task.stage in ("detections", "tracks"):
            todo.append(task)
        else:
            compared.append((task, result))
    n_equal: Counter[str] = Counter()
    for task, result, is_equal in _compared(compared):
        if not is_equal:
            is_done = result.status == "done"
            other = replace(task, known_hash=result.content_hash)
            todo.append(other if is_done else ClipTask(task.clip))
        elif task.stage:
            todo.append(task)
        else:
            n_equal[result.status] += 1
    return todo, n_equal["done"], n_equal["failed"]


def _compared(
    tasks: Sequence[tuple[ClipTask, _Known]],
) -> Iterator[tuple[ClipTask, _Known, bool]]:
    """The tasks, and whether the files of their clips are those of the result."""
    fingerprint = partial(present_fingerprint, listings=FolderListings())
    with ThreadPoolExecutor(_N_CONNECTIONS) as threads:
        for start in range(0, len(tasks), _N_BATCH):
            batch = tasks[start : start + _N_BATCH]
            present = threads.map(fingerprint, [task.clip for task, _ in batch])
            for (task, result), inputs in zip(batch, present, strict=True):
                yield task, result, bool(inputs) and inputs == result.inputs


def _task_after(clip: Clip, result: _Known, keys: StageKeys) -> ClipTask:
    """What is left to do for a clip with a complete result, if its files are the same."""
    if not result.tracks_key:  # of an earlier version
        stage: Stage = "" if result.settings_hash == keys.former else "detections"
        return ClipTask(clip, stage=stage, is_replaced=bool(stage))
    made = result.outputs
    if result.tracks_key != keys.tracks:
        stage = "tracks" if result.detections_key == keys.detections else "detections"
        return ClipTask(clip, stage=stage, made=made, is_replaced=True)
    if result.events_key != keys.events:
        return ClipTask(clip, stage="events", made=made, is_replaced=True)
    missing = set(keys.outputs).difference(made)
    # another variant has the name of the file
    is_replaced = not set(map(output_name, missing)).isdisjoint(map(output_name, made))
    return ClipTask(clip, stage="outputs" if missing else "", made=made, is_replaced=is_replaced)


_REPLACED: Mapping[Stage, str] = {
    "detections": "detections, tracks, events and other files",
    "tracks": "tracks, events and other files",
    "events": "events, and files that show them",
    "outputs": "files with other contents",
}
_MADE: Mapping[Stage, str] = {
    "detections": "all over again",
    "tracks": "from stored detections, without the detector",
    "events": "for events alone",
    "outputs": "for missing files alone",
}


def check_replaced(clips: Sequence[Clip], table: ClipTable, plan: FleetPlan) -> None:
    """WouldReplaceError if results would be replaced, with the options that differ from those of
    the last run.
    """
    known = dict(_known(table))
    done = [(clip, known[clip.name]) for clip in clips if clip.name in known]
    tasks = [
        _task_after(clip, result, plan.keys) for clip, result in done if result.status == "done"
    ]
    counts = Counter(task.stage for task in tasks if task.is_replaced)
    if not counts:
        return
    replaced = "; ".join(
        f"{what} of {counted(counts[stage], 'clip')}"
        for stage, what in _REPLACED.items()
        if counts[stage]
    )
    state = read_state(plan.out)
    before = {} if state is None else state.options.get("run", {})
    now = named_options(plan)["run"]
    replaces_nothing = {"threads"} if counts["outputs"] else {"threads", *OUTPUTS}
    names = sorted(
        RunSettings.flag(name)
        for name in (before.keys() | now.keys()) - replaces_nothing
        if before.get(name) != now.get(name)
    )
    others = names or ["another version of track-range, or other content of their files"]
    options = f" ({shortened(', '.join(others), 100)})"
    raise WouldReplaceError(
        f"{plan.out}: expected the options of the finished results, found others{options}, which "
        f"would replace {replaced}; repeat the command with --overwrite, or choose another --out."
    )


def work_text(todo: Sequence[ClipTask], n_complete: int) -> str:
    """Clause with the numbers of clips to process and of complete clips, and why earlier results do
    not count.
    """
    counts = Counter(task.stage for task in todo if task.is_replaced or task.stage == "outputs")
    n_touched = sum(bool(task.known_hash) for task in todo)
    n_other = sum(task.is_replaced for task in todo)
    reasons = [f"{n_other} with a result of other options"] if n_other else []
    reasons += [f"{counts[stage]} {how}" for stage, how in _MADE.items() if counts[stage]]
    reasons += (
        [f"{n_touched} complete if the content of the changed files is the same"]
        if n_touched
        else []
    )
    named = f" ({', '.join(reasons)})" if reasons else ""
    return f"{counted(len(todo), 'clip')} to process{named}, {n_complete} complete"


def _known(table: ClipTable) -> Iterator[tuple[str, _Known]]:
    def values(columns: Iterable[Any]) -> _Known:
        *texts, outputs = columns
        # most of them are equal in most rows
        shared = (intern(text or "") for text in texts)
        return _Known._make([*shared, tuple(outputs or ())])

    names = ("clip", *_Known._fields)
    for batch in table.table.select(names).to_batches(max_chunksize=10_000):
        for name, *columns in zip(*(column.to_pylist() for column in batch.columns), strict=True):
            yield name, values(columns)
    for name, row in table.newer.items():
        yield name, values(row.get(column) for column in _Known._fields)


def present_fingerprint(clip: Clip, listings: FolderListings | None = None) -> str:
    """`fingerprint` of a clip's files now (or when `listings` were made); "" if the storage cannot
    be reached.
    """
    listings = listings or FolderListings()
    try:
        states = {
            role: listings.state(Location.of(address))
            for role, address in clip.files(listings.stat).items()
        }
    except StorageError:
        return ""
    return fingerprint(
        clip,
        {
            role: (-1, -1) if state is None else (state.size, state.mtime_ns)
            for role, state in states.items()
        },
    )


def content_hash(clip: Clip, digests: Mapping[str, str]) -> str:
    """Hash of the content of the files of a clip, given as SHA-256, and of its settings."""
    return f"sha256:{hashlib.sha256(fingerprint(clip, digests).encode()).hexdigest()}"


def fingerprint(clip: Clip, files: Mapping[str, object]) -> str:
    """Files of a clip, each with size and time of change or with a hash, and the clip's settings,
    in canonical JSON.
    """
    settings = {
        name: value for name, value in clip.settings.items() if not is_file_setting(name, value)
    }
    return json.dumps({"files": files, "settings": settings}, sort_keys=True, separators=(",", ":"))
