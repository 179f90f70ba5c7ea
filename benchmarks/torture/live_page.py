"""A hostile client of the live page: garbage, long headers, foreign hosts, other paths."""

from __future__ import annotations

import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from random import Random

from benchmarks.torture.cases import Case, End, problems
from benchmarks.torture.processes import start
from benchmarks.torture.result_files import result_problems
from benchmarks.torture.seeds import FOCAL_PX, simulate

_N_FRAMES = 60
"""Number of frames of the drive."""

_TIME_LIMIT_S = 300.0
"""Time limit of a run, in seconds."""

_LOCAL = "Host: 127.0.0.1\r\n"

_REQUESTS: dict[str, tuple[bytes, tuple[bytes, ...]]] = {
    "page": (f"GET / HTTP/1.1\r\n{_LOCAL}\r\n".encode(), (b"200",)),
    "HEAD": (f"HEAD / HTTP/1.1\r\n{_LOCAL}\r\n".encode(), (b"200",)),
    "foreign host": (b"GET /frame.jpg HTTP/1.1\r\nHost: example.org\r\n\r\n", (b"403", b"400")),
    "path traversal": (f"GET /../../etc/passwd HTTP/1.1\r\n{_LOCAL}\r\n".encode(), (b"404", b"400")),
    "encoded traversal": (f"GET /%2e%2e/%2e%2e/etc/passwd HTTP/1.1\r\n{_LOCAL}\r\n".encode(), (b"404", b"400")),
    "absolute path": (f"GET //etc/passwd HTTP/1.1\r\n{_LOCAL}\r\n".encode(), (b"404", b"400")),
    "long header": (f"GET / HTTP/1.1\r\n{_LOCAL}X: {'x' * 100_000}\r\n\r\n".encode(), (b"431", b"400", b"")),
    "many headers": (f"GET / HTTP/1.1\r\n{_LOCAL}".encode() + b"X: y\r\n" * 5000 + b"\r\n", (b"431", b"400", b"")),
    "long path": (f"GET /{'x' * 100_000} HTTP/1.1\r\n{_LOCAL}\r\n".encode(), (b"414", b"404", b"")),
    "unknown method": (f"BREW / HTTP/1.1\r\n{_LOCAL}\r\n".encode(), (b"501", b"405")),
    "POST": (f"POST / HTTP/1.1\r\n{_LOCAL}Content-Length: 9999999999\r\n\r\n".encode(), (b"501", b"405")),
    "unknown version": (f"GET / HTTP/9.9\r\n{_LOCAL}\r\n".encode(), (b"505", b"400", b"200")),
    "no request": (b"", (b"",)),
}
"""Requests, and the first statuses that may answer them; "" = the connection is closed."""


def run_server(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Cases of runs with a live page that gets hostile requests; `benchmarks.speed.server` measures slow readers."""
    simulate(folder / "drive", n_frames=_N_FRAMES)
    for number in range(n_cases):
        random = Random(f"{seed}-{number}")
        yield _hostile_case(folder, random)
    shutil.rmtree(folder / "out", ignore_errors=True)


def _hostile_case(folder: Path, random: Random) -> Case:
    """A run whose page gets every hostile request and random bytes."""
    faults: list[str] = []

    def attack(port: int) -> None:
        for name, (request, statuses) in _REQUESTS.items():
            answer = _answer(port, request)
            if b"root:" in answer:
                faults.append(f"{name}: discloses a file")
            status = answer.split(b" ")[1] if answer.count(b" ") > 1 else b""
            if status not in statuses:
                faults.append(f"{name}: answered with {answer[:60]!r}")
        for _ in range(50):
            _answer(port, random.randbytes(random.randint(1, 2000)) + b"\r\n\r\n")

    end, command = _run_with_client(folder, attack)
    faults += [*problems(end), *result_problems(folder / "out", has_overlay=True)]
    if end.status:
        faults.append(end.stderr[-300:])
    return Case("server", "hostile requests", "", "accepted", tuple(faults), command, folder, end)


def _run_with_client(folder: Path, client: Callable[[int], None]) -> tuple[End, tuple[str, ...]]:
    """A run with a live page, and a client in a thread that is started when the page answers."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = (
        *("--mono", "drive/left.mp4", "--focal-px", str(FOCAL_PX), "--detections", "drive/detections.txt"),
        *("--lanes", "off", "--serve", str(port), "--out", "out"),
    )
    child = start(command, folder, time_limit_s=_TIME_LIMIT_S)
    deadline_s = time.monotonic() + _TIME_LIMIT_S
    while not _listens(port) and time.monotonic() < deadline_s and not child.has_ended():
        time.sleep(0.01)
    thread = threading.Thread(target=client, args=(port,), daemon=True)
    thread.start()
    end = child.wait()
    thread.join(60)
    return end, command


def _listens(port: int) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
        return True
    return False


def _answer(port: int, request: bytes) -> bytes:
    """The first bytes that the page answers."""
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=2) as client:
        client.sendall(request)
        client.shutdown(socket.SHUT_WR)
        return client.recv(4096)
    return b""
