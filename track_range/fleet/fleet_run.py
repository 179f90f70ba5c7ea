"""run_fleet: the clips of a fleet from the settings to the complete results."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Any

from rich.console import Console

from track_range.fleet.engine.cluster import connected
from track_range.fleet.engine.counts import Counts
from track_range.fleet.engine.plan import FleetPlan, Process, fleet_plan
from track_range.fleet.engine.progress import shown_progress, worker_state
from track_range.fleet.engine.remaining import remaining
from track_range.fleet.errors import FleetError
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.output.data_set import ClipTable
from track_range.fleet.output.publishing import remove_unfinished
from track_range.fleet.output.state import HEARTBEAT_S, FleetState, OutputLock, State
from track_range.fleet.settings import FleetSettings
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location
from track_range.foundation.errors import RunStoppedError, UserError
from track_range.foundation.files.input_files import counted
from track_range.run.interrupts import ignore_interrupts, stop_on_interrupt
from track_range.run.settings_files import without_folders

_MAX_STATES = 1000
"""Largest number of workers in fleet.json."""

_WITH_FOLDERS = ("recordings", "out", "pattern", "rig", "settings", "cache_dir")
"""Settings that fleet.json of an anonymized fleet does not contain, since they name folders."""


@dataclass(frozen=True, slots=True)
class FleetResult:
    """Result of a run of a fleet.

    Attributes:
        counts: clips by result.
        failed: names and errors of the failed clips.
        wall_s: duration of the run, s.
    """

    counts: Counts
    failed: list[tuple[str, str]]
    wall_s: float


def run_fleet(
    settings: FleetSettings,
    options: Mapping[str, Any],
    clips: Sequence[Clip],
    *,
    console: Console | None = None,
    process: Process | None = None,
) -> FleetResult:
    """Process the clips that are not complete.

    Args:
        settings: of the fleet.
        options: options of the runs, by name of the setting.
        clips: all clips.
        console: for the progress; None = none.
        process: processes a clip in a worker; None = `engine.clip_run.run_clip`.

    Raises:
        UsageError: an option is invalid.
        FleetError, FolderLockError, StorageError: the fleet cannot run, or cannot continue.
        RunStoppedError: the user stopped it; what is complete stays.
    """
    if process is None:
        from track_range.fleet.engine.clip_run import run_clip

        process = run_clip
    plan = fleet_plan(settings, options)
    _use_system_memory()
    out = Location.of(settings.out)
    if out.is_read_only:
        raise FleetError(f"{out}: expected a folder or an object store (s3://, gs://) for --out, found a web server.")
    with ExitStack() as stack:
        stack.enter_context(stop_on_interrupt())
        lock = OutputLock(out)
        stack.callback(lock.release)
        stack.callback(remove_unfinished, out)
        remove_unfinished(out)
        return _FleetRun(settings, plan, out, clips, console or Console(quiet=True), process).run()


def _use_system_memory() -> None:
    """Let Arrow allocate from the C library; its own allocator keeps 60 MB more for the table of 100,000 clips."""
    import pyarrow as pa

    pa.set_memory_pool(pa.system_memory_pool())


class _FleetRun:
    """A run of a fleet, with its output locked."""

    def __init__(
        self,
        settings: FleetSettings,
        plan: FleetPlan,
        out: Location,
        clips: Sequence[Clip],
        console: Console,
        process: Process,
    ) -> None:
        self._settings, self._plan, self._out, self._clips = settings, plan, out, clips
        self._console, self._process = console, process
        self._counts = Counts(total=len(clips))
        self._started_s = time.time()
        self._next_heartbeat_s = 0.0
        self._workers: list[dict[str, Any]] = []
        self._table = ClipTable(out)

    def run(self) -> FleetResult:
        """Process the clips."""
        self._write_state("running")
        try:
            self._table.compile()
            self._process_remaining()
            self._table.compile(is_sorted=True)
        except KeyboardInterrupt:
            with ignore_interrupts():
                self._finish("stopped", "stopped by the user")
            counts = self._counts
            raise RunStoppedError(
                f"stopped by the user; {counts.skipped + counts.done} of {counts.total} clips are complete, the same "
                "command continues."
            ) from None
        except UserError as error:
            with ignore_interrupts():
                self._finish("failed", str(error))
            raise
        self._write_state("finished")
        failed = self._table.failed({clip.name for clip in self._clips})
        return FleetResult(self._counts, failed, time.time() - self._started_s)

    def _process_remaining(self) -> None:
        left = remaining(
            self._clips, self._table, self._plan.settings_hash, is_failed_repeated=self._settings.retry_failed
        )
        counts = self._counts
        counts.skipped, counts.failed = left.n_complete, left.n_failed
        if not left.todo:
            return
        with ExitStack() as stack:
            cluster = stack.enter_context(connected(self._settings))
            from track_range.fleet.engine.driver import Driver  # imports Ray, which reads its environment then
            from track_range.fleet.engine.pool import WorkerPool

            stack.enter_context(stop_on_interrupt())  # Ray has replaced the handlers
            n_workers = min(cluster.n_workers, len(left.todo))
            if not self._console.quiet:
                text = f"{counted(len(left.todo), 'clip')} to process, {left.n_complete} complete; "
                self._console.print(text + counted(n_workers, "worker"), highlight=False)
            pool = WorkerPool(cluster, self._plan, self._process, self._settings, n_workers)
            try:
                with shown_progress(self._console, counts) as progress:

                    def report(slots: Any) -> None:
                        progress(slots)
                        self._heartbeat(slots)

                    Driver(
                        plan=self._plan,
                        out=self._out,
                        table=self._table,
                        pool=pool,
                        todo=left.todo,
                        counts=counts,
                        driver_node=cluster.node,
                        report=report,
                    ).run()
            finally:
                with ignore_interrupts():
                    pool.stop()

    def _heartbeat(self, slots: Any) -> None:
        now_s = time.monotonic()
        if now_s >= self._next_heartbeat_s:
            self._next_heartbeat_s = now_s + HEARTBEAT_S
            self._workers = [worker_state(slot) for slot in slots[:_MAX_STATES]]
            self._write_state("running")

    def _finish(self, state: State, reason: str) -> None:
        """Write what is known after a failure, as far as the storage allows it."""
        with suppress(StorageError):
            self._counts.done += self._table.collect_journal()
            self._table.compile(is_sorted=True)
        with suppress(StorageError):
            self._write_state(state, reason)

    def _write_state(self, state: State, reason: str = "") -> None:
        counts = self._counts
        FleetState(
            state=state,
            reason=reason,
            started_s=self._started_s,
            total=counts.total,
            skipped=counts.skipped,
            done=counts.done,
            failed=counts.failed,
            video_s=round(counts.video_s, 3),
            settings_hash=self._plan.settings_hash,
            options=self._options(),
            workers=self._workers if state == "running" else (),
        ).write(self._out)

    def _options(self) -> dict[str, Any]:
        """Options of the fleet and of its runs, as plain values."""
        own = self._settings.model_dump(mode="json", exclude_none=True)
        own["recordings"] = own["recordings"][:10]
        run = {key: _plain(value) for key, value in self._plan.options.items()}
        if self._plan.is_anonymized:
            own = {key: value for key, value in own.items() if key not in _WITH_FOLDERS}
            run = without_folders(run)
        return {**own, "run": run}


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool | list | dict | None) else str(value)
