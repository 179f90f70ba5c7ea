"""fleet.json: state of the run of a fleet, rewritten every few seconds."""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from pydantic import TypeAdapter

from track_range.fleet.errors import FleetError
from track_range.fleet.output.publishing import publish_bytes
from track_range.fleet.storage.location import Location
from track_range.foundation.files.folder_lock import FolderLock
from track_range.foundation.files.structured_text import parse_json
from track_range.foundation.processes import is_running

STATE_FILE = "fleet.json"

HEARTBEAT_S = 5.0
"""Time between two writings of the state, s."""

STALE_S = 60.0
"""Age of a state above which its run has ended without saying so, s."""

_STALE_HERE_S = 600.0
"""The same on this machine, s: a missing process shows it earlier, but its number may be that of another one since."""

State = Literal["running", "finished", "stopped", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetState:
    """State of the run of a fleet.

    Attributes:
        state: "running", "finished", "stopped" by the user, or "failed" for a reason that is not a clip.
        reason: why it failed.
        host: machine of the driver.
        pid: process of the driver.
        started_s: start, Unix time.
        heartbeat_s: time of this state, Unix time.
        total: number of clips.
        skipped: clips that were complete at the start.
        done: clips that were completed in this run.
        failed: clips that failed in this run, or before and are not repeated.
        video_s: duration of the clips completed in this run, s.
        settings_hash: hash of the settings that all clips have in common.
        options: options of the run.
        workers: state of each worker.
    """

    state: State
    reason: str = ""
    host: str = field(default_factory=socket.gethostname)
    pid: int = field(default_factory=os.getpid)
    started_s: float = field(default_factory=time.time)
    heartbeat_s: float = field(default_factory=time.time)
    total: int = 0
    skipped: int = 0
    done: int = 0
    failed: int = 0
    video_s: float = 0.0
    settings_hash: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    workers: Sequence[Mapping[str, Any]] = ()

    def write(self, out: Location) -> None:
        """Write fleet.json.

        Raises:
            StorageError: it cannot be written.
        """
        text = json.dumps({"track_range_fleet": 1, **asdict(self)}, indent=1, ensure_ascii=False, allow_nan=False)
        publish_bytes(out, out.child(STATE_FILE), text.encode())

    @property
    def worker_pids(self) -> tuple[int, ...]:
        """Processes of the workers that have started."""
        return tuple(worker["pid"] for worker in self.workers if worker.get("pid"))

    @property
    def is_alive(self) -> bool:
        """Whether the driver is at work, as far as can be seen from here."""
        if self.state != "running":
            return False
        age_s = time.time() - self.heartbeat_s
        if self.host == socket.gethostname():
            return age_s < _STALE_HERE_S and is_running(self.pid)
        return age_s < STALE_S


def read_state(out: Location) -> FleetState | None:
    """The state in fleet.json; None without a readable one.

    Raises:
        StorageError: the storage cannot be read.
    """
    location = out.child(STATE_FILE)
    if not location.exists():
        return None
    try:
        content: Any = parse_json(location.read_bytes().decode(), location, FleetError, "the state of a fleet")
        if not isinstance(content, dict) or content.pop("track_range_fleet", None) != 1:
            return None
        return TypeAdapter(FleetState).validate_python(content)
    except (FleetError, UnicodeDecodeError, TypeError, ValueError):
        return None


class OutputLock:
    """Lock of the output of a fleet: one driver at a time.

    A local folder is locked by the operating system, an object store by the heartbeat in fleet.json.

    Raises:
        FolderLockError, FleetError: another driver is at work.
        StorageError: the storage cannot be read or written.
    """

    def __init__(self, out: Location) -> None:
        self._lock: FolderLock | None = None
        if out.is_local:
            local = out.path
            try:
                local.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise FleetError(
                    f"{local}: the folder cannot be created ({error.strerror}); choose another --out."
                ) from error
            self._lock = FolderLock(local)
            return
        state = read_state(out)
        if state is not None and state.is_alive and (state.host, state.pid) != (socket.gethostname(), os.getpid()):
            raise FleetError(
                f"{out}: another fleet run (process {state.pid} on {state.host}) is writing here; wait for its end, or "
                "choose another --out."
            )

    def release(self) -> None:
        """Release the lock."""
        if self._lock is not None:
            self._lock.release()
