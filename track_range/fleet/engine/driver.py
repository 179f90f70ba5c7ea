"""Driver: gives the clips of a fleet to its workers until each has a record.

    todo -> worker -> record in the journal -> clips.parquet
             |  worker lost: again at the end of the queue, or a record with an error (`engine.attempts`)

The driver has one clip per worker in flight, and of the others only the names.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from track_range.fleet.engine.attempts import Attempts, ErrorKind
from track_range.fleet.engine.counts import Counts
from track_range.fleet.engine.fingerprint import present_fingerprint
from track_range.fleet.engine.plan import ClipTask, FleetPlan
from track_range.fleet.engine.pool import Slot, WorkerEvent, WorkerPool, alive_nodes
from track_range.fleet.errors import FleetError
from track_range.fleet.output.data_set import ClipTable, journal_row, publish_record
from track_range.fleet.output.file_names import FileNames
from track_range.fleet.output.record import ClipRecord, Row
from track_range.fleet.storage.location import Location
from track_range.foundation.files.input_files import shortened

_POLL_S = 0.5
"""Longest wait for the workers at a time, s."""

_MAX_STARTS = 3
"""Workers that may die one after the other before their first clip."""

_START_S = 900.0
"""Time in which the first worker has to start, s: a cluster may have to start machines."""

_NODE_S = 30.0
"""Time in which Ray notices that a node is lost, s: five health checks at intervals of 3 s, and some reserve."""


_NODES_S = 2.0
"""Time between two looks at the nodes of the cluster, s."""


@dataclass(slots=True)
class _Waiting:
    """A clip whose last failure may have been that of its node; decided when Ray knows."""

    task: ClipTask
    kind: ErrorKind
    reason: str
    node: str
    until_s: float


class Driver:
    """Scheduling of the clips.

    Args:
        plan: of the fleet.
        out: folder of the results.
        table: rows of the fleet.
        pool: the workers.
        todo: the clips to process.
        counts: counts, which are updated.
        driver_node: id of the node of this driver; "" = not known.
        report: called about twice a second with the workers.
    """

    def __init__(
        self,
        *,
        plan: FleetPlan,
        out: Location,
        table: ClipTable,
        pool: WorkerPool,
        todo: Iterable[ClipTask],
        counts: Counts,
        driver_node: str,
        report: Callable[[list[Slot]], None],
    ) -> None:
        self._plan, self._out, self._table, self._pool = plan, out, table, pool
        self._todo = deque(todo)
        self._counts, self._report = counts, report
        self._attempts = Attempts()
        self._waiting: list[_Waiting] = []
        self._driver_node = driver_node
        self._alive: set[str] = set()
        self._lost_nodes: set[str] = set()
        self._next_nodes_s = 0.0
        self._n_starts_lost = 0
        self._has_started = False
        self._start_s = time.monotonic()

    def run(self) -> None:
        """Process all clips.

        Raises:
            FleetError: the fleet cannot continue.
            StorageError: the results cannot be written.
        """
        while self._todo or self._waiting or any(slot.task for slot in self._pool.slots):
            for slot in self._pool.idle:
                if not self._todo:
                    break
                self._submit(slot, self._todo.popleft())
            for event in self._pool.events(_POLL_S):
                self._handle(event)
            self._decide_waiting()
            self._check_start()
            self._table.compile_if_due()
            self._report(self._pool.slots)

    def _submit(self, slot: Slot, task: ClipTask) -> None:
        task = replace(task, attempt=self._attempts.number(task.clip.name))
        if task.clip.problem:
            self._fail(task, "input", task.clip.problem)
            return
        self._pool.submit(slot, task)

    def _handle(self, event: WorkerEvent) -> None:
        if event.kind == "ready":
            self._ready(event)
        elif event.kind == "finished":
            self._finished(event)
        else:
            self._lost(event)

    def _ready(self, event: WorkerEvent) -> None:
        info = event.slot.info
        if info is not None and info.version != self._plan.version:
            raise FleetError(
                f"node {info.host}: expected track-range {self._plan.version}, found {info.version}; install the same "
                "version on all nodes."
            )
        self._has_started, self._n_starts_lost = True, 0

    def _finished(self, event: WorkerEvent) -> None:
        outcome, task = event.outcome, event.task
        if outcome is None or task is None:
            return
        if outcome.fatal:
            raise FleetError(f"the results cannot be stored: {outcome.fatal}")
        row = outcome.row
        if outcome.is_unchanged:
            self._table.touch(task.clip.name, row["inputs"])
            self._counts.skipped += 1
        elif row["status"] == "done":
            self._done(row, is_in_journal=outcome.is_published)
        elif outcome.is_transient:
            self._attempts.add(task.clip.name, row["error_kind"])
            self._repeat_or_fail(task, row["error_kind"], row["error"], row)
        else:
            self._add_failed(task, row)

    def _lost(self, event: WorkerEvent) -> None:
        self._pool.replace(event.slot)
        task = event.task
        if task is None:
            self._n_starts_lost += 1
            if self._n_starts_lost >= _MAX_STARTS:
                raise FleetError(f"the workers cannot start: {shortened(event.reason, 300)}")
            return
        row = None
        if event.error_kind == "crash":  # the worker may have died after its last act for the clip
            row = journal_row(self._out, task.clip.name)
        if row is not None and self._is_of_attempt(row, task):
            self._done(row, is_in_journal=True)
            return
        if event.node in self._lost_nodes and event.error_kind == "crash":
            self._todo.append(task)
            return
        self._attempts.add(task.clip.name, event.error_kind, event.node)
        # the node of the driver is not lost as long as the driver is at work
        may_be_node = event.error_kind == "crash" and event.node not in ("", self._driver_node)
        if may_be_node and not self._attempts.is_repeated(task.clip.name):
            until_s = time.monotonic() + _NODE_S
            self._waiting.append(_Waiting(task, event.error_kind, event.reason, event.node, until_s))
            return
        self._repeat_or_fail(task, event.error_kind, event.reason)

    def _is_of_attempt(self, row: Row, task: ClipTask) -> bool:
        return bool(
            row["status"] == "done"
            and row.get("settings_hash") == self._plan.settings_hash
            and row.get("attempts") == task.attempt
        )

    def _repeat_or_fail(self, task: ClipTask, kind: ErrorKind, reason: str, row: Row | None = None) -> None:
        if self._attempts.is_repeated(task.clip.name):
            self._todo.append(task)
        elif row is not None:
            self._add_failed(task, row)
        else:
            self._fail(task, kind, reason)

    def _decide_waiting(self) -> None:
        """Take back the attempts that lost nodes have ended, and decide about the clips that wait for that."""
        now_s = time.monotonic()
        if now_s < self._next_nodes_s:
            return
        self._next_nodes_s = now_s + _NODES_S
        alive = alive_nodes()
        for node in self._alive - alive:
            self._attempts.forget_node(node)
            self._lost_nodes.add(node)
        self._alive = alive
        for waiting in [waiting for waiting in self._waiting if waiting.node not in alive or now_s > waiting.until_s]:
            self._waiting.remove(waiting)
            self._repeat_or_fail(waiting.task, waiting.kind, waiting.reason)

    def _check_start(self) -> None:
        if not self._has_started and time.monotonic() - self._start_s > _START_S:
            raise FleetError(
                f"no worker started within {_START_S / 60:.0f} minutes: no node of the cluster has --threads CPUs, "
                "--worker-memory and --gpus-per-worker free."
            )

    def _done(self, row: Row, *, is_in_journal: bool) -> None:
        self._table.add(row, is_in_journal=is_in_journal)
        self._counts.done += 1
        self._counts.video_s += row.get("seconds") or 0.0

    def _fail(self, task: ClipTask, kind: ErrorKind, reason: str) -> None:
        clip = task.clip
        names = FileNames(clip, is_anonymized=self._plan.is_anonymized)
        record = ClipRecord(
            clip=clip.name,
            status="failed",
            error=names.text(reason),
            error_kind=kind,
            attempts=max(1, self._attempts.n_failed(clip.name)),
            left=names.left,
            right=names.right,
            settings_hash=self._plan.settings_hash,
            version=self._plan.version,
            finished_utc=datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
            labels=dict(clip.labels),
        )
        self._add_failed(task, record.row())

    def _add_failed(self, task: ClipTask, row: Row) -> None:
        if not row["inputs"]:
            row["inputs"] = present_fingerprint(task.clip)
        publish_record(self._out, row)
        self._table.add(row, is_in_journal=True)
        self._counts.failed += 1
