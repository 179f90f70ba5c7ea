"""Fixtures that every test may use."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.command_line import Finished, run_command
from tests.support.drive_cache import DriveCache
from track_range.simulation.drive import Drive

pytest_plugins = ["tests.tiers"]

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data (never part of the project); tests that need it are skipped where it
    is absent."""
    folder = Path(os.environ.get("TRACK_RANGE_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no folder of real data; set TRACK_RANGE_DATA (now {folder})")
    return folder


@pytest.fixture(scope="session", autouse=True)
def sigint() -> Iterator[None]:
    """Ctrl-C interrupts tests and programs that they start, also where a shell runs the tests in
    the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session")
def cli() -> Callable[..., Finished]:
    """The command line in this process: `cli("--mono", video, ...)` gives (status, stdout,
    stderr)."""
    return run_command


@pytest.fixture(scope="session")
def render_drive(
    pytestconfig: pytest.Config, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., Drive]:
    """Renders a simulated drive or copies it from the cache: `render_drive(seed=3, seconds=1.2)`,
    see `DriveCache`."""
    cache = getattr(pytestconfig, "cache", None)  # none with -p no:cacheprovider
    folder = (
        Path(cache.mkdir("drives")) if cache else tmp_path_factory.getbasetemp().parent / "drives"
    )
    drives = DriveCache(folder)
    return lambda **options: drives.drive(tmp_path_factory.mktemp("drive") / "files", **options)


@pytest.fixture(scope="session")
def small_drive(render_drive: Callable[..., Drive]) -> Drive:
    """A simulated drive of 12 frames of 620x188, for tests that only read it."""
    return render_drive()


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Installs a package with entry points, and gives the folder of its metadata.

    `install("track_range.trackers", greedy="tests.toys.toy_tracker:GreedyIouTracker")`
    """
    folder = tmp_path / "site-packages"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))

    def installed(group: str, **entry_points: str) -> Path:
        name = f"package{len(list(folder.glob('*.dist-info')))}"
        info = folder / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        lines = [f"[{group}]", *(f"{key} = {value}" for key, value in entry_points.items())]
        (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
        return info

    return installed
