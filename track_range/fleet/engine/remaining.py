"""Which clips of a fleet are left to process: fingerprints of their inputs and of earlier
results.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from sys import intern
from typing import NamedTuple

from track_range.fleet.engine.plan import ClipTask
from track_range.fleet.inputs.clip import Clip, is_file_setting
from track_range.fleet.output.data_set import ClipTable
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import FolderListings, Location
from track_range.foundation.files.input_files import counted

_N_CONNECTIONS = 32  # requests for sizes and times of change at a time
_N_BATCH = 2000  # clips whose files are looked up together; a request that waits takes about 1.5 kB


class _Known(NamedTuple):
    status: str
    settings_hash: str
    inputs: str
    content_hash: str


def remaining(
    clips: Sequence[Clip], table: ClipTable, settings_hash: str, *, is_failed_repeated: bool
) -> tuple[list[ClipTask], int, int]:
    """Clips without a result for the present files and settings; numbers of complete and of failed
    clips.

    Files are compared by size and time of change; where these differ, the worker compares the
    content. Failed clips are repeated if something has changed, or `is_failed_repeated`.
    """
    known = dict(_known(table))
    todo: list[ClipTask] = []
    compared: list[tuple[Clip, _Known]] = []
    for clip in clips:
        result = known.get(clip.name)
        is_repeated = result is not None and result.status == "failed" and is_failed_repeated
        if result is None or is_repeated or result.settings_hash != settings_hash:
            todo.append(
                ClipTask(clip, has_other_options=result is not None and result.status == "done")
            )
        else:
            compared.append((clip, result))
    n_equal: Counter[str] = Counter()
    fingerprint = partial(present_fingerprint, listings=FolderListings())
    with ThreadPoolExecutor(_N_CONNECTIONS) as threads:
        for start in range(0, len(compared), _N_BATCH):
            batch = compared[start : start + _N_BATCH]
            present = threads.map(fingerprint, [clip for clip, _ in batch])
            for (clip, result), inputs in zip(batch, present, strict=True):
                if inputs and inputs == result.inputs:
                    n_equal[result.status] += 1
                else:
                    todo.append(
                        ClipTask(
                            clip, known_hash=result.content_hash if result.status == "done" else ""
                        )
                    )
    return todo, n_equal["done"], n_equal["failed"]


def work_text(todo: Sequence[ClipTask], n_complete: int) -> str:
    """Clause with the numbers of clips to process and of complete clips, and why earlier results do
    not count.
    """
    n_other, n_touched = (
        sum(task.has_other_options for task in todo),
        sum(bool(task.known_hash) for task in todo),
    )
    reasons = [f"{n_other} with a result of other options"] if n_other else []
    reasons += (
        [f"{n_touched} complete if the content of the changed files is the same"]
        if n_touched
        else []
    )
    named = f" ({', '.join(reasons)})" if reasons else ""
    return f"{counted(len(todo), 'clip')} to process{named}, {n_complete} complete"


def _known(table: ClipTable) -> Iterator[tuple[str, _Known]]:
    names = ("clip", *_Known._fields)
    for batch in table.table.select(names).to_batches(max_chunksize=10_000):
        for name, status, settings_hash, *others in zip(
            *(column.to_pylist() for column in batch.columns), strict=True
        ):
            # these two are equal in most rows
            shared = (intern(value or "") for value in (status, settings_hash))
            yield name, _Known(*shared, *(value or "" for value in others))
    for name, row in table.newer.items():
        yield name, _Known(*(row.get(column) or "" for column in _Known._fields))


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
