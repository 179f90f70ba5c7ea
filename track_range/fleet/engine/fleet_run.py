"""run_fleet: the clips of a fleet from the settings to the complete results."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from rich.console import Console

from track_range.fleet.engine.cameras import with_cameras
from track_range.fleet.engine.cluster import connected
from track_range.fleet.engine.plan import FleetPlan, Process, fleet_plan, named_options
from track_range.fleet.engine.progress import shown_progress, worker_state
from track_range.fleet.engine.remaining import (
    check_replaced,
    remaining,
    work_text,
)
from track_range.fleet.errors import FleetError
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.output.data_set import ClipTable, remove_unfinished
from track_range.fleet.output.state import HEARTBEAT_S, FleetState, State, locked_output
from track_range.fleet.settings import FleetSettings
from track_range.fleet.storage.errors import StorageError
from track_range.foundation.errors import RunStoppedError, UserError
from track_range.foundation.files.input_files import counted
from track_range.run.interrupts import ignore_interrupts, stop_on_interrupt

_MAX_STATES = 1000  # largest number of workers in fleet.json


class FleetResult(NamedTuple):
    """Clips by result, names and errors of failed clips, duration of the run in s, and names of
    clips that keep results of earlier files.
    """

    counts: FleetState
    failed: list[tuple[str, str]]
    wall_s: float
    kept: list[str]


def run_fleet(
    settings: FleetSettings,
    options: Mapping[str, Any],
    clips: Sequence[Clip],
    *,
    console: Console | None = None,
    process: Process | None = None,
) -> FleetResult:
    """Process the clips that are not complete.

    `options`: options of the runs, by name of the setting; `console`: for the progress; `process`:
    processes a clip in a worker (default: `engine.clip_run.run_clip`). Complete clips remain in any
    case. Raises UsageError: an option is invalid; FleetError, FolderLockError, StorageError: the
    fleet cannot run or continue; RunStoppedError: the user stopped it.
    """
    import pyarrow as pa

    if process is None:
        from track_range.fleet.engine.clip_run import run_clip

        process = run_clip
    plan = fleet_plan(settings, options)
    # Arrow's own allocator keeps 60 MB more for the table of 100,000 clips
    pa.set_memory_pool(pa.system_memory_pool())
    if plan.out.is_web:
        raise FleetError(
            f"{plan.out}: expected a folder or an object store (s3://, gs://) for --out, found a "
            "web server."
        )
    with stop_on_interrupt(), locked_output(plan.out):
        remove_unfinished(plan.out)
        console = console or Console(quiet=True)
        try:
            table = ClipTable(plan.out)
            if not settings.overwrite:
                check_replaced(clips, table, plan)
            with_rigs = with_cameras(clips, plan, console)
            return _FleetRun(plan, with_rigs, table, console).run(process)
        finally:
            remove_unfinished(plan.out)


class _FleetRun:
    def __init__(
        self, plan: FleetPlan, clips: Sequence[Clip], table: ClipTable, console: Console
    ) -> None:
        self._plan, self._clips, self._console = plan, clips, console
        options = named_options(plan)
        self._state = FleetState(
            state="running", total=len(clips), settings_hash=plan.keys.settings, options=options
        )
        self._kept: list[str] = []
        self._unmade: list[tuple[str, str]] = []
        self._next_heartbeat_s = 0.0
        self._table = table

    def run(self, process: Process) -> FleetResult:
        state = self._state
        self._write_state("running")
        try:
            self._table.compile()
            self._process_remaining(process)
            self._table.compile(is_sorted=True)
        except KeyboardInterrupt:
            self._finish("stopped", "stopped by the user")
            raise RunStoppedError(
                f"stopped by the user; {state.skipped + state.done} of {state.total} clips are "
                "complete; repeat the command to continue."
            ) from None
        except Exception as error:
            kind = (
                ""
                if isinstance(error, UserError)
                else f"unexpected error, {type(error).__name__}: "
            )
            self._finish("failed", f"{kind}{error}")
            raise
        self._write_state("finished")
        failed = self._table.failed({clip.name for clip in self._clips})
        failed = sorted([*failed, *self._unmade])
        return FleetResult(state, failed, state.heartbeat_s - state.started_s, sorted(self._kept))

    def _process_remaining(self, process: Process) -> None:
        state, plan, table = self._state, self._plan, self._table
        todo, state.skipped, state.failed = remaining(
            self._clips, table, plan.keys, is_failed_repeated=plan.settings.retry_failed
        )
        if not todo:
            return
        # Ray has replaced the handlers
        with connected(plan.settings) as n_available, stop_on_interrupt():
            # imports Ray, which reads its environment then
            from track_range.fleet.engine.driver import Driver

            n_workers = min(n_available, len(todo))
            if not self._console.quiet:
                text = f"{work_text(todo, state.skipped)}; {counted(n_workers, 'worker')}"
                self._console.print(text, highlight=False)
            with shown_progress(self._console, state) as progress:

                def report(slots: Sequence[Any]) -> None:
                    state.heartbeat_s = time.time()
                    progress(slots)
                    now_s = time.monotonic()
                    if now_s >= self._next_heartbeat_s:
                        self._next_heartbeat_s = now_s + HEARTBEAT_S
                        self._write_state(
                            "running", workers=[worker_state(slot) for slot in slots[:_MAX_STATES]]
                        )

                driver = Driver(plan, process, n_workers, table, todo, state, report)
                self._kept, self._unmade = driver.kept, driver.unmade
                try:
                    driver.run()
                finally:
                    with ignore_interrupts():
                        driver.stop()

    def _finish(self, state: State, reason: str) -> None:
        with ignore_interrupts():
            with suppress(StorageError):
                self._state.done += self._table.collect_journal()
                self._table.compile(is_sorted=True)
            with suppress(StorageError):
                self._write_state(state, reason)

    def _write_state(
        self, name: State, reason: str = "", workers: Sequence[Mapping[str, Any]] = ()
    ) -> None:
        state = self._state
        state.state, state.reason, state.workers, state.heartbeat_s = (
            name,
            reason,
            workers,
            time.time(),
        )
        state.write(self._plan.out)
