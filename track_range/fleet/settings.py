"""Settings of `track-range fleet run`, without the options of the runs themselves."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Annotated

from pydantic import field_validator

from track_range.foundation.schemas.options import Options, option

_input, _output, _workers = (
    partial(option, panel=heading) for heading in ("Recordings", "Results", "Workers")
)

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12}  # bytes by prefix of the unit
# a size as text: 2GB, 500 MB
_SIZE = re.compile(r"(\d{1,12}(?:\.\d{1,3})?)\s*([kmgt]?)i?b?", re.IGNORECASE)


def size_bytes(text: str) -> int:
    """Bytes of a size such as "2GB". Raises ValueError: the text is not a size."""
    match = _SIZE.fullmatch(text.strip())
    if match is None or not float(match[1]):
        raise ValueError("expected a size such as 2GB or 500MB")
    return int(float(match[1]) * _UNITS[match[2].lower()])


class FleetSettings(Options):
    """Options of `track-range fleet run` that are not options of a run."""

    recordings: Annotated[
        tuple[str, ...],
        option(
            "Folders, patterns such as 'DIR/*.mp4', or one manifest (CSV or Parquet: clip, left, "
            "right, rig, ...); local or s3://, gs://, https://.",
            metavar="RECORDINGS",
            is_argument=True,
            is_repeated=True,
            min_length=1,
        ),
    ]
    out: Annotated[
        str,
        _output("Folder of the results: a local folder, or s3://BUCKET/PREFIX.", metavar="DIR|URI"),
    ]
    pattern: Annotated[
        str | None,
        _input(
            "Names of the files of a clip below RECORDINGS, left and right: "
            "'{clip}_left.mp4,{clip}_right.mp4' (default: each video is one clip).",
            metavar="PATTERN",
        ),
    ] = None
    rig: Annotated[
        str | None,
        _input(
            "Calibration of all clips, or a pattern with {clip} and other names of --pattern "
            "(default: NAME.rig.yaml, rig.yaml or calib.txt beside the left video).",
            metavar="FILE|PATTERN",
        ),
    ] = None
    camera: Annotated[
        str | None,
        _input(
            "Name of the camera of all clips without a calibration, or a pattern with {folder} (the "
            "name of the folder of a clip), placeholders of --pattern or columns of the manifest, "
            "such as '{vehicle}': before the run, the focal length of each camera is estimated "
            "once, from up to 12 of its clips (default: of each clip by itself).",
            metavar="NAME|PATTERN",
        ),
    ] = None
    rig_camera: Annotated[
        str | None,
        _input(
            "Name of the camera of all clips in calibration files of several cameras, or the names "
            "of the left and the right one, as --camera of a run (--camera of a fleet names "
            "cameras without a calibration).",
            metavar="NAME|LEFT,RIGHT",
        ),
    ] = None
    settings: Annotated[
        Path | None,
        _input(
            "Settings of an earlier run (settings.yaml), without its inputs and outputs; other "
            "options override them.",
            metavar="FILE",
        ),
    ] = None
    dry_run: Annotated[
        bool, _input("List of the clips with problems in their headers, without processing them.")
    ] = False
    overwrite: Annotated[
        bool,
        _output(
            "Replacement of finished results of other options or files (default: a fleet with other "
            "options stops, and says what it would replace; clips with other files keep their "
            "results)."
        ),
    ] = False
    retry_failed: Annotated[
        bool, _output("Clips that failed in an earlier run are processed again.")
    ] = False
    reports: Annotated[
        bool, _output("Report (report.html, summary.json) of each clip in runs/clip=NAME.")
    ] = False
    workers: Annotated[
        int | None,
        _workers(
            "Number of workers (default: cores of the cluster / --threads).",
            metavar="N",
            ge=1,
            le=100_000,
        ),
    ] = None
    threads: Annotated[int, _workers("CPU threads of a worker.", metavar="N", ge=1, le=1024)] = 1
    worker_memory: Annotated[
        str,
        _workers(
            "Memory that is reserved for a worker, and its limit; a clip that takes more is "
            "repeated once and then fails.",
            metavar="SIZE",
        ),
    ] = "2GB"
    gpus_per_worker: Annotated[
        float,
        _workers("Number of GPUs of a worker, which may be a fraction.", metavar="N", ge=0, le=64),
    ] = 0.0
    address: Annotated[
        str | None,
        _workers(
            "Ray cluster: HOST:PORT, or auto for the cluster on this machine or in RAY_ADDRESS "
            "(default: a cluster on this machine for the duration of the run).",
            metavar="auto|HOST:PORT",
        ),
    ] = None
    timeout: Annotated[
        float,
        _workers(
            "Time limit of a clip: 60 s and this number of seconds for each second of video, or "
            "for each 10 processed frames, whichever is more; a clip that takes longer is repeated "
            "once and then fails.",
            metavar="FACTOR",
            ge=0.01,
            le=1e6,
        ),
    ] = 60.0
    cache_dir: Annotated[
        Path | None,
        _workers(
            "Folder on the workers for remote recordings and unfinished results (default: the "
            "temporary folder).",
            metavar="DIR",
        ),
    ] = None
    cache_size: Annotated[
        str, _workers("Largest size of a remote clip in the cache of a worker.", metavar="SIZE")
    ] = "20GB"

    @field_validator("worker_memory", "cache_size")
    @classmethod
    def _size(cls, text: str) -> str:
        size_bytes(text)
        return text
