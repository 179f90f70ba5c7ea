"""Commands of track-range in forked processes, which start in milliseconds because its modules are loaded."""

from __future__ import annotations

import gc
import importlib.util
import os
import pkgutil
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NoReturn

from benchmarks.torture.cases import End

TIME_LIMIT_S = 20.0
"""Duration in seconds after which a command counts as hanging; usual ones take less than one."""

_MEMORY_BYTES = 8_000_000_000
"""Largest growth of the address space of a command; pyarrow and threads reserve much more than they use."""

_MAX_OUTPUT = 1_000_000
"""Number of bytes of the output that are kept."""

_COLUMNS = "200"
"""Width of the terminal: messages are not broken."""

_UNLOADED = ("track_range.detection.training",)
"""Packages that need libraries which are not always installed."""

_LIBRARIES = ("onnx", "onnxruntime", "pandas", "pyarrow", "scipy.optimize", "scipy.stats", "jinja2")
"""Libraries that commands import when they need them."""


def load_modules() -> None:
    """Import the modules of track-range and the libraries that they import later; call it before the first command."""
    import track_range

    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    for module in pkgutil.walk_packages(track_range.__path__, "track_range."):
        if not module.name.startswith(_UNLOADED) and not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for name in _LIBRARIES:
        if importlib.util.find_spec(name.partition(".")[0]):
            importlib.import_module(name)
    gc.collect()
    gc.freeze()


@dataclass(slots=True)
class Child:
    """A running command.

    Attributes:
        pid: process id.
        started_s: value of `time.monotonic` at the start.
    """

    pid: int
    started_s: float
    _stdout: IO[bytes]
    _stderr: IO[bytes]

    def wait(self) -> End:
        """The end of the command."""
        _, status, usage = os.wait4(self.pid, 0)
        return self._end(status, usage)

    def has_ended(self) -> bool:
        """Whether the command has ended; `wait` is still to be called."""
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def kill(self) -> End:
        """Kill the command without a warning."""
        os.kill(self.pid, signal.SIGKILL)
        return self.wait()

    def resident_mib(self) -> float:
        """Resident memory in MiB."""
        pages = int(Path(f"/proc/{self.pid}/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 2**20

    def _end(self, status: int, usage: resource.struct_rusage) -> End:
        growth_mib = (usage.ru_maxrss - resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024
        return End(
            os.waitstatus_to_exitcode(status),
            _text(self._stdout),
            _text(self._stderr),
            time.monotonic() - self.started_s,
            growth_mib,
        )


def _text(file: IO[bytes]) -> str:
    """The beginning of a file, which is closed."""
    with file:
        file.seek(0)
        return file.read(_MAX_OUTPUT).decode(errors="replace")


def start(
    command: Sequence[str],
    folder: Path,
    *,
    time_limit_s: float = TIME_LIMIT_S,
    prepare: Callable[[], None] | None = None,
) -> Child:
    """Start a command of track-range.

    Args:
        command: arguments of `track-range`.
        folder: working folder.
        time_limit_s: duration after which it is killed by SIGALRM.
        prepare: what the process does before the command, such as setting a limit.
    """
    stdout, stderr = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115 - `Child` closes them
    started_s = time.monotonic()
    pid = os.fork()
    if not pid:
        _run(command, folder, (stdout, stderr), time_limit_s, prepare)
    return Child(pid, started_s, stdout, stderr)


def run(command: Sequence[str], folder: Path, *, prepare: Callable[[], None] | None = None) -> End:
    """Run a command of track-range; a command that seems to hang is run again with twice the time."""
    end = start(command, folder, prepare=prepare).wait()
    if end.status == -signal.SIGALRM:
        end = start(command, folder, prepare=prepare, time_limit_s=2 * TIME_LIMIT_S).wait()
    return end


def _run(
    command: Sequence[str],
    folder: Path,
    files: tuple[IO[bytes], IO[bytes]],
    time_limit_s: float,
    prepare: Callable[[], None] | None,
) -> NoReturn:
    """Run a command in this process, and end it."""
    status = 1
    try:
        null = os.open(os.devnull, os.O_RDONLY)
        for number, descriptor in enumerate((null, *(file.fileno() for file in files))):
            os.dup2(descriptor, number)
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False, buffering=1)
        os.chdir(folder)
        os.environ["COLUMNS"] = _COLUMNS
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, time_limit_s)
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + _MEMORY_BYTES, used + _MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if prepare is not None:
            prepare()
        status = _status_of(command)
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def _status_of(command: Sequence[str]) -> int:
    from track_range.cli.app import main

    sys.argv = ["track-range", *command]
    try:
        main()
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
        return 1
    return 0
