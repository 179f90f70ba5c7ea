"""WorkerPool: the workers of a fleet as Ray actors, with one clip each at a time.

    start -> idle -> clip -> idle ... ; a worker that dies, hangs or takes too much memory is replaced

Ray neither restarts actors nor repeats calls here: both are decided by the driver, which knows the clips.
"""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import ray

from track_range.fleet.engine.attempts import ErrorKind
from track_range.fleet.engine.cluster import Cluster
from track_range.fleet.engine.limits import Limits
from track_range.fleet.engine.plan import ClipOutcome, ClipTask, FleetPlan, Process
from track_range.fleet.engine.scratch import folder_of
from track_range.fleet.engine.shared_files import shared_files
from track_range.fleet.engine.worker import Worker, WorkerInfo, WorkerState
from track_range.fleet.settings import FleetSettings
from track_range.foundation.processes import is_running

_STATE_S = 1.0
"""Time between two questions for the state of a worker, s."""

_CLOSE_S = 5.0
"""Time in which workers without a clip remove their folders, s."""

_END_S = 2.0
"""Longest wait for the end of a killed process, s."""

_BUSY_CALLS = 2
"""Threads of an actor for its state, so that one that waits for the interpreter does not block the next."""


@dataclass(slots=True, eq=False)
class Slot:
    """A place for a worker, with the worker that is in it.

    Attributes:
        number: number of the place, from 0.
        actor: Ray's handle.
        answer: pending call: the start of the worker, or a clip.
        info: properties of the worker; None = it has not started yet.
        task: the clip that it is at.
        start_s: start of the clip, or of the worker, on the monotonic clock.
        state: last state.
        n_clips: number of clips that it has finished.
    """

    number: int
    actor: Any
    answer: Any
    info: WorkerInfo | None = None
    task: ClipTask | None = None
    start_s: float = field(default_factory=time.monotonic)
    state: WorkerState | None = None
    state_call: Any = None
    state_s: float = 0.0
    n_clips: int = 0

    @property
    def is_idle(self) -> bool:
        """Whether it can take a clip."""
        return self.info is not None and self.task is None


@dataclass(frozen=True, slots=True)
class WorkerEvent:
    """What happened to a worker.

    Attributes:
        slot: place of the worker.
        kind: "ready", "finished" or "lost".
        task: the clip that it was at; None = none.
        outcome: answer about the clip, if it finished.
        error_kind: kind of the failure, if the worker was lost.
        reason: sentence about the failure.
        node: id of the worker's node; "" = not known.
    """

    slot: Slot
    kind: Literal["ready", "finished", "lost"]
    task: ClipTask | None = None
    outcome: ClipOutcome | None = None
    error_kind: ErrorKind = ""
    reason: str = ""
    node: str = ""


class WorkerPool:
    """Workers on a cluster.

    Args:
        cluster: the connected cluster.
        plan: of the fleet.
        process: processes a clip in a worker.
        settings: of the fleet.
        n_workers: number of workers.
    """

    def __init__(
        self, cluster: Cluster, plan: FleetPlan, process: Process, settings: FleetSettings, n_workers: int
    ) -> None:
        self._cluster, self._settings = cluster, settings
        self._limits = Limits(settings.timeout, settings.worker_memory_bytes)
        self._cache_dir = plan.cache_dir
        self._arguments = (ray.put(plan), process, ray.put({} if cluster.is_local else shared_files(plan)))
        remote: Any = ray.remote  # its types know no concurrency groups
        actor_class = remote(max_restarts=0, max_task_retries=0, concurrency_groups={"state": _BUSY_CALLS})(Worker)
        self._actor_class = actor_class.options(
            num_cpus=settings.threads, num_gpus=settings.gpus_per_worker, memory=settings.worker_memory_bytes
        )
        self.slots = [self._started(number) for number in range(n_workers)]

    def _started(self, number: int) -> Slot:
        actor = self._actor_class.remote(*self._arguments)
        return Slot(number, actor, actor.info.remote())

    @property
    def idle(self) -> list[Slot]:
        """Places with a worker that can take a clip."""
        return [slot for slot in self.slots if slot.is_idle]

    def submit(self, slot: Slot, task: ClipTask) -> None:
        """Give a clip to an idle worker."""
        slot.task, slot.start_s, slot.state = task, time.monotonic(), None
        slot.answer = slot.actor.run.remote(task)

    def events(self, timeout_s: float) -> Iterator[WorkerEvent]:
        """What has happened, after waiting for at most `timeout_s`."""
        by_answer = {slot.answer: slot for slot in self.slots if slot.answer is not None}
        if by_answer:
            ready, _ = ray.wait(list(by_answer), num_returns=1, timeout=timeout_s)
            if ready and len(by_answer) > 1:
                ready, _ = ray.wait(list(by_answer), num_returns=len(by_answer), timeout=0)
            for answer in ready:
                yield self._event(by_answer[answer])
        else:
            time.sleep(timeout_s)
        self._ask_states()
        yield from self._over_limit()

    def replace(self, slot: Slot) -> None:
        """Start a new worker in the place of a lost one."""
        self.slots[slot.number] = self._started(slot.number)

    def stop(self) -> None:
        """End all workers; those without a clip, also those that are still starting, remove their folders."""
        closing = [slot.actor.close.remote() for slot in self.slots if slot.task is None]
        if closing:
            ray.wait(closing, num_returns=len(closing), timeout=_CLOSE_S)
        for slot in self.slots:
            self._kill(slot)

    def _event(self, slot: Slot) -> WorkerEvent:
        answer, slot.answer = slot.answer, None
        try:
            value = ray.get(answer)
        except ray.exceptions.RayError as error:
            return self._lost(slot, *(_cause(error) if slot.info is not None else ("crash", _last_line(error))))
        if isinstance(value, WorkerInfo):
            slot.info = value
            return WorkerEvent(slot, "ready")
        task, slot.task = slot.task, None
        slot.n_clips += 1
        return WorkerEvent(slot, "finished", task, outcome=value)

    def _lost(self, slot: Slot, kind: ErrorKind, reason: str) -> WorkerEvent:
        self._kill(slot, has_ended=kind == "crash")
        task, slot.task = slot.task, None
        node = "" if slot.info is None else slot.info.node
        return WorkerEvent(slot, "lost", task, error_kind=kind, reason=reason, node=node)

    def _kill(self, slot: Slot, *, has_ended: bool = False) -> None:
        """End a worker; the number of a process that `has_ended` may be that of another one by now."""
        slot.answer = slot.state_call = None
        with suppress(ray.exceptions.RayError, ValueError):
            ray.kill(slot.actor, no_restart=True)
        # a process that hangs in a library may not follow Ray's request
        if slot.info is not None and slot.info.node == self._cluster.node:
            if not has_ended:
                with suppress(OSError):
                    os.kill(slot.info.pid, signal.SIGKILL)
                _wait_for_end(slot.info.pid)  # it could write into the folder while that is removed
            shutil.rmtree(folder_of(slot.info.pid, self._cache_dir), ignore_errors=True)

    def _ask_states(self) -> None:
        """Take the answers of the workers to the questions for their states, and ask again."""
        now_s = time.monotonic()
        calls = {slot.state_call: slot for slot in self.slots if slot.state_call is not None}
        ready, _ = ray.wait(list(calls), num_returns=len(calls), timeout=0) if calls else ([], [])
        for call in ready:
            slot = calls[call]
            slot.state_call = None
            with suppress(ray.exceptions.RayError):  # the call of the clip fails too
                slot.state = ray.get(call)
        for slot in self.slots:
            if slot.task is not None and slot.state_call is None and now_s - slot.state_s >= _STATE_S:
                slot.state_s = now_s
                slot.state_call = slot.actor.state.options(concurrency_group="state").remote()

    def _over_limit(self) -> Iterator[WorkerEvent]:
        """Events of workers that are over a limit; they are ended."""
        now_s = time.monotonic()
        for slot in self.slots:
            if slot.task is None or slot.answer is None:
                continue
            state = slot.state if slot.state is not None and slot.state.clip == slot.task.clip.name else None
            if state is not None and state.memory_bytes > self._limits.memory_bytes:
                yield self._lost(
                    slot,
                    "memory",
                    f"the worker took {state.memory_bytes / 1e9:.1f} GB, more than --worker-memory "
                    f"{self._settings.worker_memory}; give more memory.",
                )
                continue
            known = (0.0, 0.0, 0) if state is None else (state.video_s, state.fetch_bytes, state.frames)
            limit_s = self._limits.time_s(*known)
            if now_s - slot.start_s > limit_s:
                at = "" if state is None else f" while {state.phase}, after {state.frames} frames"
                yield self._lost(
                    slot, "timeout", f"not finished within the time limit of {limit_s:.0f} s (--timeout){at}."
                )


def _wait_for_end(pid: int) -> None:
    """Wait until a process has ended, for at most `_END_S`."""
    until_s = time.monotonic() + _END_S
    while is_running(pid) and time.monotonic() < until_s:
        time.sleep(0.01)


def _cause(error: Exception) -> tuple[ErrorKind, str]:
    """Kind and sentence of the failure of a call."""
    if isinstance(error, ray.exceptions.OutOfMemoryError):
        return "memory", "the machine ran out of memory; start fewer --workers, or give them more --worker-memory."
    if isinstance(error, ray.exceptions.RayActorError):
        text = " ".join(str(error).split())
        if "memory pressure" in text or "OutOfMemory" in text:
            return "memory", "the machine ran out of memory; start fewer --workers, or give them more --worker-memory."
        return "crash", "the process of the worker died (killed, or a crash in a library)."
    return "internal", " ".join(str(getattr(error, "cause", None) or error).split())[-300:]


def _last_line(error: Exception) -> str:
    """The last line of an error's text, which is the exception in the process of the worker."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1] if lines else type(error).__name__


def alive_nodes() -> set[str]:
    """Ids of the nodes of the cluster that are alive."""
    nodes: Sequence[Mapping[str, Any]] = ray.nodes()  # type: ignore[no-untyped-call]
    return {node["NodeID"] for node in nodes if node["Alive"]}
