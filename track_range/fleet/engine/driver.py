"""Driver: gives the clips of a fleet to its workers until each has a record.

    todo -> worker -> record in the journal -> clips.parquet
             |  worker lost: again at the end of the queue, or a record with an error

A clip is a task of Ray, which never repeats it: only the driver knows how a clip has failed. The
driver holds one clip per worker in progress, and only the names of all other clips.

failure                              attempts in all
input, internal (application error)  1
network while fetching               2
over the limit of time or memory     2
worker died                          2; 4 if workers died with other clips too, since the machine is then the cause
node lost                            not counted
"""

from __future__ import annotations

import tempfile
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeGuard

import ray

from track_range.fleet.engine import worker
from track_range.fleet.engine.plan import ClipOutcome, ClipTask, FileNames, FleetPlan, Process
from track_range.fleet.engine.remaining import present_fingerprint
from track_range.fleet.engine.worker import (
    FOLDER_PREFIX,
    WorkerState,
    process_clip,
    remove_dead_folders,
    shared_files,
)
from track_range.fleet.errors import FleetError
from track_range.fleet.output.data_set import ClipTable, journal_rows, publish_record
from track_range.fleet.output.record import Row, utc_now
from track_range.fleet.output.state import FleetState
from track_range.fleet.settings import size_bytes
from track_range.foundation.files.input_files import counted, shortened
from track_range.foundation.processes import is_running

# kind of a failure; "" = none
ErrorKind = Literal["", "input", "crash", "memory", "timeout", "fetch", "internal"]

_REPEATED: frozenset[ErrorKind] = frozenset(("crash", "memory", "timeout", "fetch"))

# attempts for a clip, and those if workers died with other clips as well
_N_ATTEMPTS, _N_ATTEMPTS_ELSEWHERE = 2, 4
BASE_S = 60.0  # time for opening a clip, in addition to that for its frames
_FETCH_BYTES_PER_S = 1e6  # lowest rate of downloads that is not taken for a hang
# frames that extend the limit like 1 s of video: slow machines, videos of high rate or size
_FRAMES_PER_S = 10.0
_POLL_S = 0.5  # longest wait for the workers at a time, s
_MAX_STARTS = 3  # workers that may die before any of them has started
# longest wait for the end of cancelled workers of this machine, whose folders are then removed
_END_S = 5.0
# time in which the first worker has to start, s: a cluster may have to start machines
_START_S = 900.0
_CANCEL_S = 30.0  # time in which Ray ends a cancelled task; its node is taken for lost afterwards
# time in which Ray notices that a node is lost: five health checks at intervals of 3 s, and reserve
_NODE_S = 30.0


_ADDED = ("events", "outputs", "")  # stages after which an earlier result is still complete


class Attempts:
    """Failed attempts of the clips of a fleet."""

    def __init__(self) -> None:
        self._failures: dict[str, list[ErrorKind]] = defaultdict(list)

    def add(self, clip: str, kind: ErrorKind) -> None:
        """Count a failed attempt."""
        self._failures[clip].append(kind)

    def n_failed(self, clip: str) -> int:
        """Number of failed attempts."""
        return len(self._failures.get(clip, ()))

    def is_repeated(self, clip: str) -> bool:
        """Whether the clip is attempted again after its last failure."""
        kinds = self._failures.get(clip, [])
        if not _REPEATED.issuperset(kinds):
            return False
        crashed_elsewhere = any(
            "crash" in others for name, others in self._failures.items() if name != clip
        )
        is_elsewhere = set(kinds) == {"crash"} and crashed_elsewhere
        return len(kinds) < (_N_ATTEMPTS_ELSEWHERE if is_elsewhere else _N_ATTEMPTS)


def failure_of_lost_worker(
    verdict: tuple[ErrorKind, str] | None, *, is_node_lost: bool
) -> tuple[ErrorKind, str] | None:
    """Kind and reason of the failed attempt of a worker that was cancelled for the reason of its
    verdict, or died by itself; None = the attempt is not counted, since the node was lost.
    """
    if verdict is not None or is_node_lost:
        return verdict
    return "crash", "the process of the worker died (killed, or a crash in a library)."


def time_limit_s(
    time_factor: float, video_s: float, fetch_bytes: float = 0.0, n_frames: int = 0
) -> float:
    """Time limit of a clip; it grows with the processed frames, since a worker that makes progress
    does not hang.

    `time_factor`: seconds for each second of video, or for ten frames; `video_s`: duration, 0 = not
    known yet; `fetch_bytes`: bytes to download; `n_frames`: frames processed so far.
    """
    length_s = max(video_s, n_frames / _FRAMES_PER_S)
    return BASE_S + time_factor * length_s + fetch_bytes / _FETCH_BYTES_PER_S


@dataclass(slots=True)
class Slot:
    """A place for a worker."""

    number: int
    task: ClipTask | None = None
    states: Any = None  # generator of Ray with the states of the worker and the outcome
    state: WorkerState | None = None  # None = the worker has not started yet
    start_s: float = 0.0  # time of the first state, monotonic clock
    verdict: tuple[ErrorKind, str] | None = None  # kind and reason for which the task was cancelled
    cancel_s: float = 0.0  # time of the cancellation, monotonic clock
    # time at which its worker died on another node, monotonic clock; None = it lives
    death_s: float | None = None
    n_clips: int = 0  # clips that have been finished in it


class Driver:
    """Scheduling of the clips `todo`, with `table` and `state` updated, and `report` called about
    twice a second.
    """

    def __init__(
        self,
        plan: FleetPlan,
        process: Process,
        n_workers: int,
        table: ClipTable,
        todo: Iterable[ClipTask],
        state: FleetState,
        report: Callable[[list[Slot]], None],
    ) -> None:
        self._plan, self._settings, self._out = plan, plan.settings, plan.out
        self._table, self._todo, self._state, self._report = table, deque(todo), state, report
        self._memory_bytes = size_bytes(plan.settings.worker_memory)
        remote: Any = ray.remote
        self._process_clip = remote(
            num_cpus=plan.settings.threads,
            num_gpus=plan.settings.gpus_per_worker,
            memory=self._memory_bytes,
            num_returns="streaming",
            max_calls=worker.CLIPS_PER_PROCESS,
            max_retries=0,
        )(process_clip)
        files = {} if plan.settings.address is None else shared_files(plan)
        self._arguments = (ray.put(plan), process, ray.put(files))
        self._slots = [Slot(number) for number in range(n_workers)]
        # not lost as long as the driver is at work
        self._node = ray.get_runtime_context().get_node_id()
        self._cancelled: list[int] = []  # processes of this machine that may not have ended yet
        self._attempts = Attempts()
        # clips whose results are of earlier files; clips without the outputs, and the reasons
        self.kept: list[str] = []
        self.unmade: list[tuple[str, str]] = []
        self._has_started, self._n_starts_lost = False, 0
        self._start_s = time.monotonic()

    def run(self) -> None:
        """Process all clips; FleetError: the fleet cannot continue; StorageError: the results
        cannot be written.
        """
        while self._todo or any(slot.task for slot in self._slots):
            for slot in self._slots:
                if self._todo and slot.task is None:
                    self._submit(slot, self._todo.popleft())
            for slot in self._ready():
                self._take(slot)
            self._check_limits()
            self._table.compile_if_due()
            self._report(self._slots)

    def stop(self) -> None:
        """End all workers."""
        pids = [
            *self._cancelled,
            *(slot.state.pid for slot in self._slots if self._is_here(slot.state)),
        ]
        for slot in self._slots:
            if slot.states is not None:
                with suppress(ray.exceptions.RayError, ValueError):
                    ray.cancel(slot.states, force=True)
        end_s = time.monotonic() + _END_S
        while any(map(is_running, pids)) and time.monotonic() < end_s:
            time.sleep(0.05)
        remove_dead_folders(self._settings.cache_dir or Path(tempfile.gettempdir()), FOLDER_PREFIX)

    def _submit(self, slot: Slot, task: ClipTask) -> None:
        if task.clip.problem:
            self._fail(task, "input", task.clip.problem)
            return
        slot.task = replace(task, attempt=self._attempts.n_failed(task.clip.name) + 1)
        slot.state = slot.verdict = None
        slot.states = self._process_clip.remote(slot.task, *self._arguments)

    def _ready(self) -> Iterator[Slot]:
        slots = {slot.states: slot for slot in self._slots if slot.states is not None}
        if slots:
            ready, _ = ray.wait(list(slots), num_returns=1, timeout=_POLL_S)
            if ready and len(slots) > 1:
                ready, _ = ray.wait(list(slots), num_returns=len(slots), timeout=0)
            yield from (slots[states] for states in ready)
        elif any(slot.task for slot in self._slots):
            time.sleep(_POLL_S)

    def _take(self, slot: Slot) -> None:
        """Take a worker's next state, outcome or error; FleetError: workers cannot start, results
        cannot be stored.
        """
        try:
            value: WorkerState | ClipOutcome = ray.get(next(slot.states))
        except ray.exceptions.RayTaskError as error:
            cause = getattr(error, "cause", None) or error
            if isinstance(cause, FleetError):
                raise FleetError(str(cause)) from None
            reason = next(
                (line for line in reversed(str(cause).splitlines()) if line.strip()), repr(cause)
            ).strip()
            raise FleetError(f"the workers cannot start: {shortened(reason, 300)}") from error
        except ray.exceptions.OutOfMemoryError:
            reason = (
                "the machine ran out of memory; start fewer --workers, or give them more "
                "--worker-memory."
            )
            self._repeat_or_fail(self._freed(slot), "memory", reason)
        except ray.exceptions.NodeDiedError:
            self._lost(slot, is_node_lost=True)
        except (ray.exceptions.RayError, StopIteration) as error:
            self._n_starts_lost += not self._has_started
            if self._n_starts_lost >= _MAX_STARTS:
                raise FleetError(
                    f"the workers cannot start: {shortened(' '.join(str(error).split()), 300)}"
                ) from error
            if slot.verdict is None and slot.state is not None and slot.state.node != self._node:
                # its node may be lost, which Ray notices later
                slot.states, slot.death_s = None, time.monotonic()
            else:
                self._lost(slot)
        else:
            if isinstance(value, ClipOutcome):
                slot.n_clips += 1
                self._finished(self._freed(slot), value)
                return
            if slot.state is None:
                self._has_started, slot.start_s = True, time.monotonic()
            slot.state = value

    @staticmethod
    def _freed(slot: Slot) -> ClipTask:
        """The clip of a slot, which is empty afterwards."""
        task, slot.task, slot.states, slot.state, slot.death_s = slot.task, None, None, None, None
        if task is None:
            raise RuntimeError("a worker without a clip has answered")
        return task

    def _lost(self, slot: Slot, *, is_node_lost: bool = False) -> None:
        """Decide on a clip whose worker was cancelled for the reason of the verdict, or died by
        itself.
        """
        task = self._freed(slot)
        # the last act for the clip may have been complete
        row = journal_rows(self._out, [task.clip.name]).get(task.clip.name, {})
        present = row.get("status"), row.get("settings_hash"), row.get("attempts")
        is_whole = task.stage not in _ADDED  # the row of others was complete before
        if is_whole and present == ("done", self._plan.keys.settings, task.attempt):
            self._done(row)
        elif failure := failure_of_lost_worker(slot.verdict, is_node_lost=is_node_lost):
            self._repeat_or_fail(task, *failure)
        else:
            self._todo.append(task)

    def _finished(self, task: ClipTask, outcome: ClipOutcome) -> None:
        if outcome.fatal:
            raise FleetError(f"the results cannot be stored: {outcome.fatal}")
        row = outcome.row
        if outcome.defect:
            self._repeat_or_fail(task, "internal", outcome.defect)
        elif outcome.is_kept:
            self.kept.append(task.clip.name)
            self._state.skipped += 1
        elif outcome.changes is not None:
            self._table.touch(task.clip.name, outcome.changes)
            self._state.done += bool(task.stage)
            self._state.skipped += not task.stage
        elif row["status"] == "done":
            self._done(row)
        elif outcome.is_transient:
            self._repeat_or_fail(task, row["error_kind"], row["error"], row)
        else:
            self._add_failed(task, row)

    def _repeat_or_fail(
        self, task: ClipTask, kind: ErrorKind, reason: str, row: Row | None = None
    ) -> None:
        self._attempts.add(task.clip.name, kind)
        if self._attempts.is_repeated(task.clip.name):
            self._todo.append(task)
        elif row is not None:
            self._add_failed(task, row)
        else:
            self._fail(task, kind, reason)

    def _check_limits(self) -> None:
        """Cancel the tasks over a limit, and decide on workers that died; raise FleetError if no
        worker starts.
        """
        now_s = time.monotonic()
        if not self._has_started and now_s - self._start_s > _START_S:
            raise FleetError(
                f"no worker started within {_START_S / 60:.0f} minutes: no node of the cluster has "
                "--threads CPUs, --worker-memory and --gpus-per-worker free."
            )
        is_waiting = any(slot.death_s is not None for slot in self._slots)
        nodes: list[dict[str, Any]] = ray.nodes() if is_waiting else []  # type: ignore[no-untyped-call]
        alive = {node["NodeID"] for node in nodes if node["Alive"]}
        for slot in self._slots:
            is_cancelled = slot.verdict is not None and slot.task is not None
            if slot.death_s is not None and slot.state is not None:
                is_node_lost = slot.state.node not in alive
                if is_node_lost or now_s - slot.death_s > _NODE_S:
                    self._lost(slot, is_node_lost=is_node_lost)
            elif is_cancelled and now_s - slot.cancel_s > _CANCEL_S:
                self._lost(slot)
            elif slot.state is not None and slot.verdict is None:
                self._cancel_over_limit(slot, slot.state, now_s)

    def _cancel_over_limit(self, slot: Slot, state: WorkerState, now_s: float) -> None:
        slot.verdict = self._verdict(state, now_s - slot.start_s)
        if slot.verdict is not None:
            slot.cancel_s = now_s
            self._cancelled += [state.pid] if self._is_here(state) else []
            ray.cancel(slot.states, force=True)

    def _is_here(self, state: WorkerState | None) -> TypeGuard[WorkerState]:
        return state is not None and state.node == self._node

    def _verdict(self, state: WorkerState, elapsed_s: float) -> tuple[ErrorKind, str] | None:
        """Kind and sentence of the limit that a worker exceeds; None if it exceeds no limit."""
        if state.memory_bytes > self._memory_bytes:
            return "memory", (
                f"the worker took {state.memory_bytes / 1e9:.1f} GB, more than --worker-memory "
                f"{self._settings.worker_memory}; give more memory."
            )
        at = state.progress
        limit_s = time_limit_s(self._settings.timeout, at.video_s, at.fetch_bytes, at.frames)
        if elapsed_s > limit_s:
            return "timeout", (
                f"the time limit of {limit_s:.0f} s (--timeout) was exceeded while {at.phase}, "
                f"after {counted(at.frames, 'frame')}."
            )
        return None

    def _done(self, row: Row) -> None:
        self._table.add(row, is_in_journal=True)
        self._state.done += 1
        self._state.video_s += row.get("seconds") or 0.0

    def _fail(self, task: ClipTask, kind: ErrorKind, reason: str) -> None:
        names = FileNames(task.clip, is_anonymized=self._plan.is_anonymized)
        record = self._plan.record(task.clip, max(1, self._attempts.n_failed(task.clip.name)))
        failed = replace(record, error=names.text(reason), error_kind=kind, finished_utc=utc_now())
        self._add_failed(task, failed.row())

    def _add_failed(self, task: ClipTask, row: Row) -> None:
        self._state.failed += 1
        if task.stage in _ADDED:  # the complete result remains
            self.unmade.append((task.clip.name, row["error"]))
            return
        if not row["inputs"]:
            row["inputs"] = present_fingerprint(task.clip)
        publish_record(self._out, row)
        self._table.add(row, is_in_journal=True)
