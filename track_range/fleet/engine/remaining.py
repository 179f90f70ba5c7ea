"""Which clips of a fleet are left to process, after earlier runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from sys import intern

from track_range.fleet.engine.fingerprint import present_fingerprint
from track_range.fleet.engine.plan import ClipTask
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.output.data_set import ClipTable
from track_range.fleet.storage.listings import FolderListings

_N_CONNECTIONS = 32
"""Requests for sizes and times of change at a time."""

_N_BATCH = 2000
"""Clips whose files are looked up together; a request that waits takes about 1.5 kB."""


@dataclass(frozen=True, slots=True)
class Remaining:
    """Clips by what is left to do.

    Attributes:
        todo: clips to process.
        n_complete: clips with a complete result, which are skipped.
        n_failed: clips that failed before and are not repeated.
    """

    todo: list[ClipTask]
    n_complete: int
    n_failed: int


@dataclass(frozen=True, slots=True)
class _Known:
    """Result of an earlier run."""

    status: str
    settings_hash: str
    inputs: str
    content_hash: str


def remaining(clips: Sequence[Clip], table: ClipTable, settings_hash: str, *, is_failed_repeated: bool) -> Remaining:
    """The clips without a result for the present files and settings.

    Files are compared by size and time of change; where these differ, the worker compares the content.

    Args:
        clips: all clips.
        table: results of earlier runs.
        settings_hash: hash of the present settings.
        is_failed_repeated: whether failed clips are processed again though nothing has changed.
    """
    known = dict(_known(table))
    todo: list[ClipTask] = []
    compared: list[tuple[Clip, _Known]] = []
    for clip in clips:
        result = known.get(clip.name)
        is_repeated = result is not None and result.status == "failed" and is_failed_repeated
        if result is None or is_repeated or result.settings_hash != settings_hash:
            todo.append(ClipTask(clip))
        else:
            compared.append((clip, result))
    n_complete = n_failed = 0
    fingerprint = partial(present_fingerprint, listings=FolderListings())
    with ThreadPoolExecutor(_N_CONNECTIONS) as threads:
        for start in range(0, len(compared), _N_BATCH):
            batch = compared[start : start + _N_BATCH]
            present = threads.map(fingerprint, [clip for clip, _ in batch])
            for (clip, result), inputs in zip(batch, present, strict=True):
                if inputs and inputs == result.inputs:
                    n_complete += result.status == "done"
                    n_failed += result.status == "failed"
                else:
                    todo.append(ClipTask(clip, known_hash=result.content_hash if result.status == "done" else ""))
    return Remaining(todo, n_complete, n_failed)


def _known(table: ClipTable) -> Iterable[tuple[str, _Known]]:
    names = ("clip", "status", "settings_hash", "inputs", "content_hash")
    for batch in table.table.select(names).to_batches(max_chunksize=10_000):
        for name, status, settings_hash, *others in zip(*(column.to_pylist() for column in batch.columns), strict=True):
            # these two are equal in most rows
            shared = (intern(value or "") for value in (status, settings_hash))
            yield name, _Known(*shared, *(value or "" for value in others))
    for name, row in table.newer.items():
        yield name, _Known(*(row.get(column) or "" for column in names[1:]))
