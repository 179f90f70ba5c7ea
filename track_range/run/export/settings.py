"""Options of `track-range export`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from track_range.foundation.options import Options, option

MARKS: Mapping[str, bytes] = {"parquet": b"PAR1", "mcap": b"\x89MCAP", "rrd": b"RRF"}
"""First bytes of the files that only result writers write, from the rows of a run."""


def export_formats() -> tuple[str, ...]:
    """Names of the formats that are written: label formats, then those of the rows of a run."""
    from track_range.detection.formats.label_formats import LABEL_FORMATS

    return (*(name for name, label_format in LABEL_FORMATS.items() if label_format.write is not None), *MARKS)


class ExportSettings(Options):
    """Input, format and output of `track-range export`."""

    source: Annotated[
        Path,
        option(
            "Result folder of a run, or labels: COCO, CVAT for video 1.1, KITTI, MOTChallenge, a CSV of labels, or a "
            "folder of YOLO labels.",
            metavar="RUN|LABELS",
            is_argument=True,
        ),
    ]
    to: Annotated[str, option("Format of the output.", choices=export_formats)]
    out: Annotated[Path, option("File to write; a folder for yolo.", metavar="PATH")]
    observed_only: Annotated[bool, option("Output without predicted boxes.")] = False
    images: Annotated[
        bool,
        option(
            "With yolo, additional output of the video's frames as JPEG images, for training; those of a run are "
            "rectified like its boxes."
        ),
    ] = False
    video: Annotated[
        Path | None,
        option("Video or folder of images of a label file, for its image size and --images.", metavar="VIDEO|DIR"),
    ] = None
    first_frame: Annotated[
        int, option("Number of the video's first frame in a label file.", metavar="N", ge=0, le=1_000_000)
    ] = 0
