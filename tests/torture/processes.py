"""Commands of track-range in forked processes, which start in milliseconds because its modules are
loaded."""

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

# a command that takes longer counts as hanging; usual ones take less than one second
TIME_LIMIT_S = 20.0
# growth of the address space; pyarrow and threads reserve much more than they use
MEMORY_BYTES = 8_000_000_000
MAX_OUTPUT = 1_000_000  # bytes
LIBRARIES = ("onnx", "onnxruntime", "pandas", "pyarrow", "scipy.optimize", "scipy.stats", "jinja2")


@dataclass(frozen=True, slots=True)
class End:
    """End of a process; a negative status is the number of the signal that killed it."""

    status: int
    stdout: str = ""
    stderr: str = ""
    wall_s: float = 0.0
    growth_mib: float = 0.0  # peak memory above that at the start


def load_modules() -> None:
    """Import the modules of track-range and the libraries that they import later; call it before
    the first command."""
    import track_range

    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    for module in pkgutil.walk_packages(track_range.__path__, "track_range."):
        if not module.name.startswith(
            "track_range.detection.training"
        ) and not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for name in LIBRARIES:
        if importlib.util.find_spec(name.partition(".")[0]):
            importlib.import_module(name)
    gc.collect()
    gc.freeze()


@dataclass(slots=True)
class Child:
    """A running command; `started_s` is a value of `time.monotonic`."""

    pid: int
    started_s: float
    _stdout: IO[bytes]
    _stderr: IO[bytes]

    def wait(self) -> End:
        _, status, usage = os.wait4(self.pid, 0)
        growth_mib = (usage.ru_maxrss - resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 1024
        texts = []
        for file in (self._stdout, self._stderr):
            with file:
                file.seek(0)
                texts.append(file.read(MAX_OUTPUT).decode(errors="replace"))
        return End(
            os.waitstatus_to_exitcode(status), *texts, time.monotonic() - self.started_s, growth_mib
        )

    def has_ended(self) -> bool:
        """Whether the command has ended; `wait` is still to be called."""
        return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None

    def kill(self) -> End:
        os.kill(self.pid, signal.SIGKILL)
        return self.wait()

    def resident_mib(self) -> float:
        pages = int(Path(f"/proc/{self.pid}/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 2**20


def start(
    command: Sequence[str],
    folder: Path,
    *,
    time_limit_s: float = TIME_LIMIT_S,
    prepare: Callable[[], None] | None = None,
) -> Child:
    """Start a command in a folder; SIGALRM ends it at the time limit, and `prepare` is called
    before it."""
    stdout, stderr = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115 - `Child` closes them
    started_s = time.monotonic()
    pid = os.fork()
    if not pid:
        _run_and_exit(command, folder, (stdout, stderr), time_limit_s, prepare)
    return Child(pid, started_s, stdout, stderr)


def run(command: Sequence[str], folder: Path, *, prepare: Callable[[], None] | None = None) -> End:
    """Run a command; one that seems to hang is run again with twice the time."""
    end = start(command, folder, prepare=prepare).wait()
    if end.status == -signal.SIGALRM:
        end = start(command, folder, prepare=prepare, time_limit_s=2 * TIME_LIMIT_S).wait()
    return end


def succeed(command: Sequence[str], folder: Path, *, time_limit_s: float = 300.0) -> End:
    """Run a command that must succeed."""
    end = start(command, folder, time_limit_s=time_limit_s).wait()
    if end.status:
        raise RuntimeError(f"track-range {' '.join(command)} failed: {end.stderr[-1000:]}")
    return end


def _run_and_exit(
    command: Sequence[str],
    folder: Path,
    files: tuple[IO[bytes], IO[bytes]],
    time_limit_s: float,
    prepare: Callable[[], None] | None,
) -> NoReturn:
    status = 1
    try:
        null = os.open(os.devnull, os.O_RDONLY)
        for number, descriptor in enumerate((null, *(file.fileno() for file in files))):
            os.dup2(descriptor, number)
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False, buffering=1)
        os.chdir(folder)
        os.environ["COLUMNS"] = "200"  # messages are not broken
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, time_limit_s)
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES, used + MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if prepare is not None:
            prepare()
        status = _status(command)
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def _status(command: Sequence[str]) -> int:
    from track_range.cli.app import main

    sys.argv = ["track-range", *command]
    try:
        main()
    except SystemExit as ended:
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    return 0
