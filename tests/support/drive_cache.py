"""Simulated drives, rendered once for all test runs: kept on disk under a hash of the sources that
render them."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import av
import cv2
import numpy as np
from filelock import FileLock

from track_range.simulation.drive import Drive, write_drive
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.settings import DriveOptions

PROJECT = Path(__file__).resolve().parents[2]

SOURCES = (
    *(
        "track_range/simulation",
        "track_range/foundation",
        "track_range/views/videos/video_writer.py",
        "track_range/foundation/files/output_files.py",
    ),
    *(
        "detection/classes.py",
        "detection/formats/video_labels/kitti.py",
        "detection/formats/tables/limits.py",
        "ranging/truth/reference_distance.py",
    ),
    *("stereo/geometry", "stereo/rig_formats", "stereo/evaluation/kitti_2015.py"),
)
"""What decides how a drive looks."""

SIZE_PX = (620, 188)
"""Width and height of a drive unless others are asked for: half of KITTI's, a quarter of its
time."""


class DriveCache:
    """Simulated drives in a folder that outlives the test run; several processes may use it at
    once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._version = _hash(text for text in _versions())

    def drive(
        self,
        target: Path,
        *,
        seed: int = 3,
        seconds: float = 1.2,
        size_px: tuple[int, int] = SIZE_PX,
        options: DriveOptions | None = None,
    ) -> Drive:
        """A copy of a drive in the new folder `target`, rendered if the cache does not have it."""
        options = options or DriveOptions()
        kept = self._folder / self._version / _hash([repr((seed, seconds, size_px, options))])
        self._folder.mkdir(parents=True, exist_ok=True)
        with FileLock(self._folder / f"{kept.name}.lock"):
            if not kept.is_dir():
                self._remove_old()
                unfinished = kept.with_suffix(".unfinished")
                shutil.rmtree(unfinished, ignore_errors=True)
                rig = kitti_like_rig(width_px=size_px[0], height_px=size_px[1])
                write_drive(unfinished, seed=seed, seconds=seconds, rig=rig, options=options)
                unfinished.rename(kept)
        shutil.copytree(kept, target)
        return Drive.in_folder(target, is_lossless=options.lossless)

    def _remove_old(self) -> None:
        for other in self._folder.iterdir():
            if other.is_dir() and other.name != self._version:
                shutil.rmtree(other, ignore_errors=True)


def _versions() -> Iterator[str]:
    """The sources and the versions of the libraries that render and encode."""
    yield from (av.__version__, cv2.__version__, np.__version__)
    for source in SOURCES:
        path = PROJECT / source
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        for file in files:
            yield f"{file.relative_to(PROJECT)}\n{file.read_text(encoding='utf-8')}"


def _hash(texts: Iterator[str] | list[str]) -> str:
    digest = hashlib.sha256()
    for text in texts:
        digest.update(text.encode())
    return digest.hexdigest()[:16]
