"""Runs that are killed, share a folder, meet a full disk or a failing write, are long, or serve a
hostile client."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from random import Random

from tests.torture.cases import MAX_LAG_FRAMES, Case, finished, outcome, problems, result_problems
from tests.torture.processes import TIME_LIMIT_S, Child, End, run, start, succeed
from tests.torture.seeds import FOCAL_PX, read_images, simulate, write_video

RUN_LIMIT_S = 900.0
GRACE_S = 0.5  # from the creation of the folder until settings.yaml must exist, on a busy machine
MAX_WRITES = 60  # largest number of the write that fails; a run has about as many
# memory is compared from the second on, when buffers and caches are filled
LONG_FRAMES, FIRST_SAMPLE = 3000, 1000
LONG_GROWTH_MIB = 8.0  # rows of the summary take 250 bytes, and the allocator some MiB

MONO = tuple(
    f"--mono drive/left.mp4 --focal-px {FOCAL_PX} --detections drive/detections.txt --out "
    "out".split()
)
PLAIN = (*MONO, "--lanes", "off")
STEREO = tuple("--stereo drive/left.mp4 drive/right.mp4 --rig drive/rig.yaml".split())
ALIGNED = (*STEREO, *"--detections drive/detections.txt --no-sgbm --out out".split())
PROGRAM = (sys.executable, "-m", "track_range")
RESULTS = tuple(
    "tracks.csv mot.txt tracks.parquet tracks.arrows overlay.mp4 report.html summary.json "
    "settings.yaml".split()
)


def run_kills(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Runs that are killed at random times after their folder exists, and the commands after
    them."""
    simulate(folder / "drive", n_frames=60)
    random = Random(seed)
    commands = {"mono": MONO, "stereo, alignment from the drive": ALIGNED}
    duration_s = {}
    for kind, command in commands.items():
        child = start(command, folder, time_limit_s=RUN_LIMIT_S)
        _wait_for_folder(child, folder)
        started_s = time.monotonic()
        if (end := child.wait()).status:
            raise RuntimeError(f"track-range {' '.join(command)}: {end.stderr[-500:]}")
        duration_s[kind] = time.monotonic() - started_s
    for number in range(n_cases):
        kind = random.choice(list(commands))
        place, delay_s = _new_place(folder, f"kill-{number}"), random.uniform(0, duration_s[kind])
        child = start(commands[kind], place, time_limit_s=RUN_LIMIT_S)
        _wait_for_folder(child, place)
        time.sleep(delay_s)
        killed = child.kill()
        out = place / "out"
        faults = list(result_problems(out, has_overlay=True, max_lag=MAX_LAG_FRAMES))
        if delay_s > GRACE_S and not (out / "settings.yaml").exists():
            faults.append("no settings.yaml")
        rows = out / "tracks.csv"
        n_rows = len(rows.read_text(encoding="utf-8").splitlines()) if rows.exists() else 0
        next_run = (*MONO, "--no-overlay", "--lanes", "off")
        for name, command in (("report", ("report", "out")), ("next run", next_run)):
            end = run(command, place)
            faults += [f"{name}: {problem}" for problem in problems(end)]
            if outcome(end) == "refused" and (n_rows > 1 or name == "next run"):
                faults.append(f"{name}: {end.stderr[:300]}")
        end = End(
            0 if killed.status == -9 else killed.status, killed.stdout, killed.stderr, killed.wall_s
        )
        name = f"after {delay_s:.2f} s, {n_rows} rows"
        yield finished(
            Case("kills", kind, name, "accepted", tuple(faults), commands[kind], place, end)
        )


def run_locks(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Two runs into one folder: the second is refused, and the first ends as usual."""
    simulate(folder / "drive", n_frames=60)
    random = Random(seed)
    for number in range(n_cases):
        place = _new_place(folder, f"lock-{number}")
        children = [start(MONO, place, time_limit_s=RUN_LIMIT_S)]
        if number % 2:  # half of the pairs start at the same moment
            _wait_for_folder(children[0], place)
            time.sleep(random.uniform(0, 0.5))
        children.append(start(MONO, place, time_limit_s=RUN_LIMIT_S))
        ends = sorted((child.wait() for child in children), key=lambda end: end.status)
        faults = list(problems(ends[1], names=("out",)))
        if [end.status for end in ends] != [0, 1]:
            faults.append(
                f"exit status {ends[0].status} and {ends[1].status}: {ends[0].stderr[-200:]}"
            )
        faults += result_problems(place / "out", has_overlay=True)
        yield finished(
            Case(
                "locks",
                "two runs",
                f"pair {number}",
                "refused",
                tuple(faults),
                MONO,
                place,
                ends[1],
            )
        )


def run_full_disks(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Runs with a limit on the size of files, or as root on a small file system (every other
    case)."""
    simulate(folder / "drive", n_frames=20)
    succeed(PLAIN, folder)
    sizes = [file.stat().st_size for file in (folder / "out").iterdir()]
    random = Random(seed)
    mounts = _can_mount()
    if not mounts:
        print("No small file systems: mounting in a private namespace requires root and `unshare`.")
    for number in range(n_cases):
        place = _new_place(folder, f"disk-{number}")
        if mounts and number % 2:
            n_kib = random.randint(4, sum(sizes) // 1024 + 8)
            script = (
                f"mkdir out && mount -t tmpfs -o size={n_kib}k none out || exit 99; "
                '"$@"; status=$?; cp -a out copy; umount out; rmdir out; mv copy out; exit $status'
            )
            end = _run_program(["unshare", "-m", "sh", "-c", script, "sh", *PROGRAM, *PLAIN], place)
            yield _disk_case("full-disk", "small file system", f"{n_kib} KiB", place, end)
        else:
            n_bytes = random.randint(100, max(sizes))
            end = run(PLAIN, place, prepare=partial(_limit_file_size, n_bytes))
            yield _disk_case("full-disk", "file-size limit", f"{n_bytes} bytes", place, end)


def run_failing_writes(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Runs in which one write, or all from one on, fail with ENOSPC or EIO; none without a C
    compiler."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        print("No failing writes: they require Linux and a C compiler, `cc`.")
        return
    library = folder / "failing_write.so"
    source = Path(__file__).with_name("failing_write.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
    simulate(folder / "drive", n_frames=20)
    random = Random(seed)
    for number in range(n_cases):
        place = _new_place(folder, f"write-{number}")
        code, write, is_lasting = (
            random.choice((errno.ENOSPC, errno.EIO)),
            random.randint(1, MAX_WRITES),
            number % 2,
        )
        environment = {
            "LD_PRELOAD": str(library),
            "TORTURE_FOLDER": str(place / "out"),
            "TORTURE_WRITE": str(write),
            "TORTURE_ERROR": str(code),
            **({"TORTURE_FOREVER": "1"} if is_lasting else {}),
        }
        end = _run_program([*PROGRAM, *PLAIN], place, environment)
        kind = f"{errno.errorcode[code]}, {'lasting' if is_lasting else 'once'}"
        yield _disk_case("failing-writes", kind, f"write {write}", place, end)


def run_memory(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Runs of 3,000 small frames with recorded boxes: the growth of the resident memory."""
    for number in range(n_cases):
        place = folder / f"memory-{number}"
        n_frames = 40
        drive = simulate(place / "drive", n_frames=n_frames, options=("--seed", str(seed + number)))
        images = read_images(drive / "left.mp4")
        write_video(place / "long.mp4", (images[index % n_frames] for index in range(LONG_FRAMES)))
        rows = [line.split(" ") for line in (drive / "detections.txt").read_text().splitlines()]
        with (place / "detections.txt").open("w", encoding="utf-8") as file:
            for first in range(0, LONG_FRAMES, n_frames):
                file.writelines(
                    " ".join([str(int(row[0]) + first), *row[1:]]) + "\n" for row in rows
                )
        options = "--detections detections.txt --lanes off --no-overlay --out out"
        command = tuple(f"--mono long.mp4 --focal-px {FOCAL_PX} {options}".split())
        child = start(command, place, time_limit_s=RUN_LIMIT_S)
        samples = []
        while (
            frame := _last_frame(place / "out/tracks.csv")
        ) < LONG_FRAMES - 100 and not child.has_ended():
            time.sleep(0.05)
            if frame >= FIRST_SAMPLE and not child.has_ended():
                samples.append(child.resident_mib())
        end = child.wait()
        faults = [*problems(end), *result_problems(place / "out")]
        if not samples or end.status:
            faults.append(f"no samples of the memory, or failed: {end.stderr[-200:]}")
        else:
            last_mib = sorted(samples[-10:])[len(samples[-10:]) // 2]
            print(
                f"Memory at frame {FIRST_SAMPLE} and at the end: {samples[0]:.1f} and "
                f"{last_mib:.1f} MiB."
            )
            if last_mib - samples[0] > LONG_GROWTH_MIB:
                faults.append(f"memory grows from {samples[0]:.0f} to {last_mib:.0f} MiB")
        name = f"run {number}"
        yield finished(
            Case(
                "memory",
                f"{LONG_FRAMES} frames",
                name,
                "accepted",
                tuple(faults),
                command,
                place,
                end,
            )
        )


def run_determinism(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Runs with the packaged detector on one and two threads, twice: the rows must be equal."""
    for number in range(n_cases):
        place = folder / f"equal-{number}"
        simulate(place / "drive", n_frames=20, options=("--seed", str(seed + number)))
        contents: dict[str, list[bytes]] = {}
        faults: list[str] = []
        for name, threads in (("a1", "1"), ("a2", "2"), ("b1", "1"), ("b2", "2")):
            command = (*STEREO, "--no-overlay", "--threads", threads, "--out", name)
            end = start(command, place, time_limit_s=RUN_LIMIT_S).wait()
            faults += problems(end)
            if end.status:
                faults.append(f"run {name}: {end.stderr[-200:]}")
                break
            contents[name] = [
                (place / name / file).read_bytes() for file in ("tracks.csv", "mot.txt")
            ]
        faults += [
            f"run {name} differs from run a1"
            for name, content in contents.items()
            if content != contents["a1"]
        ]
        kind, name = "--threads 1 and 2, twice", f"run {number}"
        yield finished(
            Case("determinism", kind, name, "accepted", tuple(faults), command, place, end)
        )


LOCAL = "Host: 127.0.0.1\r\n"
REQUESTS = {
    "page": (f"GET / HTTP/1.1\r\n{LOCAL}\r\n", {"200"}),
    "HEAD": (f"HEAD / HTTP/1.1\r\n{LOCAL}\r\n", {"200"}),
    "foreign host": ("GET /frame.jpg HTTP/1.1\r\nHost: example.org\r\n\r\n", {"403", "400"}),
    "path traversal": (f"GET /../../etc/passwd HTTP/1.1\r\n{LOCAL}\r\n", {"404", "400"}),
    "encoded traversal": (f"GET /%2e%2e/%2e%2e/etc/passwd HTTP/1.1\r\n{LOCAL}\r\n", {"404", "400"}),
    "absolute path": (f"GET //etc/passwd HTTP/1.1\r\n{LOCAL}\r\n", {"404", "400"}),
    "long header": (f"GET / HTTP/1.1\r\n{LOCAL}X: {'x' * 100_000}\r\n\r\n", {"431", "400", ""}),
    "many headers": (f"GET / HTTP/1.1\r\n{LOCAL}" + "X: y\r\n" * 5000 + "\r\n", {"431", "400", ""}),
    "long path": (f"GET /{'x' * 100_000} HTTP/1.1\r\n{LOCAL}\r\n", {"414", "404", ""}),
    "unknown method": (f"BREW / HTTP/1.1\r\n{LOCAL}\r\n", {"501", "405"}),
    "POST": (f"POST / HTTP/1.1\r\n{LOCAL}Content-Length: 9999999999\r\n\r\n", {"501", "405"}),
    "unknown version": (f"GET / HTTP/9.9\r\n{LOCAL}\r\n", {"505", "400", "200"}),
    "no request": ("", {""}),
}
"""Requests, and the first statuses that may answer them; "" = the connection is closed."""


def run_server(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """Runs whose live page gets every hostile request and random bytes."""
    simulate(folder / "drive", n_frames=60)
    for number in range(n_cases):
        place, random = _new_place(folder, f"server-{number}"), Random(f"{seed}-{number}")
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        command = (*PLAIN, "--serve", str(port))
        child = start(command, place, time_limit_s=RUN_LIMIT_S)
        deadline_s = time.monotonic() + RUN_LIMIT_S
        while not _listens(port) and time.monotonic() < deadline_s and not child.has_ended():
            time.sleep(0.01)
        faults: list[str] = []
        client = threading.Thread(target=_attack, args=(port, random, faults), daemon=True)
        client.start()
        end = child.wait()
        client.join(60)
        faults += [*problems(end), *result_problems(place / "out", has_overlay=True)]
        if end.status:
            faults.append(end.stderr[-300:])
        yield finished(
            Case("server", "hostile requests", "", "accepted", tuple(faults), command, place, end)
        )


def _attack(port: int, random: Random, faults: list[str]) -> None:
    for name, (request, statuses) in REQUESTS.items():
        answer = _answer(port, request.encode())
        if b"root:" in answer:
            faults.append(f"{name}: discloses a file")
        status = answer.split(b" ")[1].decode(errors="replace") if answer.count(b" ") > 1 else ""
        if status not in statuses:
            faults.append(f"{name}: answered with {answer[:60]!r}")
    for _ in range(50):
        _answer(port, random.randbytes(random.randint(1, 2000)) + b"\r\n\r\n")


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


def _new_place(folder: Path, name: str) -> Path:
    """A new folder with a link to the drive."""
    place = folder / name
    place.mkdir()
    (place / "drive").symlink_to(folder / "drive")
    return place


def _wait_for_folder(child: Child, place: Path) -> None:
    while not (place / "out").exists() and time.monotonic() < child.started_s + RUN_LIMIT_S:
        time.sleep(0.005)


def _disk_case(part: str, kind: str, name: str, place: Path, end: End) -> Case:
    faults = list(problems(end, names=RESULTS))
    out = place / "out"
    if out.exists():
        faults += result_problems(out, has_overlay=True, max_lag=MAX_LAG_FRAMES)
    if not end.status and not (out / "summary.json").exists():
        faults.append("success without summary.json")
    return finished(
        Case(
            part,
            kind,
            name,
            "refused" if end.status else "accepted",
            tuple(faults),
            PLAIN,
            place,
            end,
        )
    )


def _limit_file_size(n_bytes: int) -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, n_bytes))


def _can_mount() -> bool:
    """Whether a small file system can be mounted in a private namespace."""
    if shutil.which("unshare") is None or shutil.which("mount") is None:
        return False
    command = ["unshare", "-m", "sh", "-c", "mount -t tmpfs -o size=64k none /mnt"]
    return subprocess.run(command, capture_output=True).returncode == 0


def _run_program(command: list[str], place: Path, environment: dict[str, str] | None = None) -> End:
    """A command in a separate process."""
    variables = {**os.environ, "COLUMNS": "200", **(environment or {})}
    options = {
        "cwd": place,
        "env": variables,
        "capture_output": True,
        "text": True,
        "stdin": subprocess.DEVNULL,
    }
    try:
        # including the start of Python
        done = subprocess.run(command, **options, timeout=4 * TIME_LIMIT_S)
    except subprocess.TimeoutExpired:
        return End(-signal.SIGALRM)
    return End(done.returncode, done.stdout, done.stderr)


def _last_frame(rows: Path) -> int:
    """Number of the last frame in a file of rows; -1 = none."""
    try:
        with rows.open("rb") as file:
            file.seek(max(0, rows.stat().st_size - 600))
            complete = file.read().rpartition(b"\n")[0]
    except OSError:
        return -1
    text = complete.rpartition(b"\n")[2].split(b",")[0]
    return int(text) if text.isdigit() else -1
