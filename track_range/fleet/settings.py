"""Settings of `track-range fleet run`, without the options of the runs themselves."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

from pydantic import field_validator

from track_range.foundation.options import Options, option

_INPUT, _OUTPUT, _WORKERS = "Recordings", "Results", "Workers"
"""Headings of the help page."""

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12}
"""Bytes by prefix of the unit."""

_SIZE = re.compile(r"(\d{1,12}(?:\.\d{1,3})?)\s*([kmgt]?)i?b?", re.IGNORECASE)
"""A size as text: 2GB, 500 MB."""


def size_bytes(text: str) -> int:
    """Bytes of a size such as "2GB".

    Raises:
        ValueError: the text is not a size.
    """
    match = _SIZE.fullmatch(text.strip())
    if match is None or not float(match[1]):
        raise ValueError("expected a size such as 2GB or 500MB")
    return int(float(match[1]) * _UNITS[match[2].lower()])


class FleetSettings(Options):
    """Options of `track-range fleet run` that are not options of a run."""

    recordings: Annotated[
        tuple[str, ...],
        option(
            "Folders, patterns such as 'DIR/*.mp4', or one manifest (CSV or Parquet: clip, left, right, rig, ...); "
            "local or s3://, gs://, https://.",
            metavar="RECORDINGS",
            is_argument=True,
            is_repeated=True,
            min_length=1,
        ),
    ]
    out: Annotated[
        str, option("Folder of the results: a local one, or s3://BUCKET/PREFIX.", metavar="DIR|URI", panel=_OUTPUT)
    ]
    pattern: Annotated[
        str | None,
        option(
            "Names of the files of a clip below RECORDINGS, left and right: '{clip}_left.mp4,{clip}_right.mp4' "
            "(default: each video is one clip).",
            metavar="PATTERN",
            panel=_INPUT,
        ),
    ] = None
    rig: Annotated[
        str | None,
        option(
            "Calibration of all clips, or a pattern with {clip} and other names of --pattern (default: rig.yaml or "
            "calib.txt beside the left video).",
            metavar="FILE|PATTERN",
            panel=_INPUT,
        ),
    ] = None
    settings: Annotated[
        Path | None,
        option(
            "Settings of an earlier run (settings.yaml), without its inputs and outputs; other options override them.",
            metavar="FILE",
            panel=_INPUT,
        ),
    ] = None
    dry_run: Annotated[bool, option("Only a list of the clips, with the problems in their headers.", panel=_INPUT)] = (
        False
    )
    retry_failed: Annotated[bool, option("Repetition of the clips that failed before.", panel=_OUTPUT)] = False
    reports: Annotated[
        bool,
        option("Report (report.html, summary.json) of each clip in runs/clip=NAME.", panel=_OUTPUT),
    ] = False
    workers: Annotated[
        int | None,
        option(
            "Number of workers (default: cores of the cluster / --threads).",
            metavar="N",
            panel=_WORKERS,
            ge=1,
            le=100_000,
        ),
    ] = None
    threads: Annotated[int, option("CPU threads of a worker.", metavar="N", panel=_WORKERS, ge=1, le=1024)] = 1
    worker_memory: Annotated[
        str,
        option(
            "Memory of a worker: reserved for it, and its limit; a clip that takes more is repeated once, then fails.",
            metavar="SIZE",
            panel=_WORKERS,
        ),
    ] = "2GB"
    gpus_per_worker: Annotated[
        float, option("GPUs of a worker, also a fraction.", metavar="N", panel=_WORKERS, ge=0, le=64)
    ] = 0.0
    address: Annotated[
        str | None,
        option(
            "Ray cluster: HOST:PORT, or auto for the one of this machine or of RAY_ADDRESS (default: a cluster of this "
            "machine alone for the time of the run).",
            metavar="auto|HOST:PORT",
            panel=_WORKERS,
        ),
    ] = None
    timeout: Annotated[
        float,
        option(
            "Time limit of a clip: 60 s and this number of seconds for each second of video, or for each 10 processed "
            "frames if these are more; a clip that takes longer is repeated once and then fails.",
            metavar="FACTOR",
            panel=_WORKERS,
            ge=0.01,
            le=1e6,
        ),
    ] = 60.0
    cache_dir: Annotated[
        Path | None,
        option(
            "Folder on the workers for remote recordings and unfinished results (default: the temporary folder).",
            metavar="DIR",
            panel=_WORKERS,
        ),
    ] = None
    cache_size: Annotated[
        str, option("Largest size of a remote clip in the cache of a worker.", metavar="SIZE", panel=_WORKERS)
    ] = "20GB"

    @field_validator("worker_memory", "cache_size")
    @classmethod
    def _size(cls, text: str) -> str:
        size_bytes(text)
        return text

    @property
    def worker_memory_bytes(self) -> int:
        """Memory limit of a worker, bytes."""
        return size_bytes(self.worker_memory)

    @property
    def cache_bytes(self) -> int:
        """Size limit of the cache of a worker, bytes."""
        return size_bytes(self.cache_size)
