"""Fixtures of all tests of track_range: videos with identifiable frames, a run, and a browser."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import track_range as tr
from tests.support.images.films import N_NOISE_FRAMES, level_image, noise, number_of, write_film
from track_range.simulation.drive import Drive


@pytest.fixture(scope="session")
def film() -> Callable[..., Path]:
    """Writes a video: `film(path, times_s, ...)`, see `write_film`."""
    return write_film


@pytest.fixture(scope="session")
def level() -> Callable[..., np.ndarray]:
    """The image of a number: `level(number, width_px=64, height_px=48)`."""
    return level_image


@pytest.fixture(scope="session")
def number_in() -> Callable[[np.ndarray], int]:
    """Number of an image of such a video, from its grey level."""
    return number_of


@pytest.fixture(scope="session")
def run_on_noise(
    tmp_path_factory: pytest.TempPathFactory, film: Callable[..., Path]
) -> Callable[..., tr.Run]:
    """A run on a video of noise with two boxes in each frame."""
    folder = tmp_path_factory.mktemp("inputs")
    video = film(
        folder / "film.mp4",
        [number / 10 for number in range(N_NOISE_FRAMES)],
        images=noise(N_NOISE_FRAMES),
    )
    row = "{} {} Car 0 0 0 {} 10 {} 40 -1 -1 -1 -1000 -1000 -1000 -10 0.9\n"
    rows = [
        row.format(n, track, 5 + 30 * track, 25 + 30 * track)
        for n in range(N_NOISE_FRAMES)
        for track in (0, 1)
    ]
    (folder / "boxes.txt").write_text("".join(rows))

    def run(out: Path, **options: Any) -> tr.Run:
        given = {"detections": folder / "boxes.txt", "focal_px": 60, "lanes": "off", "out": out}
        return tr.Run.mono(video, **{**given, **options})

    return run


@pytest.fixture(scope="session")
def drive_folder(render_drive: Callable[..., Drive]) -> Path:
    """The folder of a simulated drive of 13 frames of 620x188, long enough for an alignment; for
    tests that only read it."""
    return render_drive(seed=0, seconds=1.3).left.parent


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Playwright's own Chromium, else the system's; skipped, with the reason, if there is none."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed (extra dev)"
    )
    with playwright.sync_playwright() as started:
        own = Path(started.chromium.executable_path)
        names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
        program = str(own) if own.is_file() else next(filter(None, map(shutil.which, names)), None)
        if program is None:
            pytest.skip("no Chromium here: neither playwright's own nor one on the PATH")
        try:
            launched = started.chromium.launch(executable_path=program, args=["--no-sandbox"])
        except playwright.Error as error:
            pytest.skip(f"{program} does not start here: {str(error).splitlines()[0]}")
        yield launched
        launched.close()
