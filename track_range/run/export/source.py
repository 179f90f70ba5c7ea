"""Source of an export: a finished run, or a label file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.formats.label_formats import label_format_of
from track_range.detection.formats.tables.box_table import (
    NO_FACTS,
    BoxTable,
    VideoFacts,
    file_name_part,
)
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import Image
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.files.structured_text import read_yaml
from track_range.foundation.schemas.validation import validated
from track_range.recording.sources.live.address import live_address
from track_range.recording.sources.open_video import open_video
from track_range.results.folder import (
    DetectedCamera,
    RunFolder,
    every_of,
    read_run_folder,
    rows_file,
)
from track_range.results.formats.box_files import table_of_rows
from track_range.run.build import open_input
from track_range.run.options.precedence import settings_from
from track_range.stereo.geometry.camera import PinholeCamera

_RUN_FILES = ("settings.yaml", "tracks.csv", "tracks.parquet", "tracks.arrows", "summary.json")


def is_run(path: Path) -> bool:
    """Whether a path is the result folder of a run."""
    return any(os.path.isfile(path / name) for name in _RUN_FILES) or rows_file(path) is not None


def run_files(folder: Path) -> list[Path]:
    """The files of a run that an export reads."""
    return [*(folder / name for name in _RUN_FILES), *filter(None, [rows_file(folder)])]


def open_run(folder: Path, *, has_events: bool = False) -> tuple[RunFolder, PinholeCamera | None]:
    """The results of a run and its left camera, None = unknown; OutputError if the folder does not
    contain a run.
    """
    run = read_run_folder(folder, is_rounded=False, has_events=has_events)
    file = folder / "settings.yaml"
    if os.path.isfile(file):
        read_yaml(file, OutputError, "the settings of a run")  # an unreadable file is an error here
    if not run.detected:
        return run, None
    return run, validated(DetectedCamera, run.detected, f"{file}, found", OutputError).camera()


def boxes_of_run(run: RunFolder, camera: PinholeCamera | None) -> BoxTable:
    """The boxes of a run, in rectified pixels."""
    rows, video_name, every = run.rows, _video_of(run.settings), every_of(run.settings)
    frames = processed_frames(run, is_live=live_address(video_name) is not None)
    video = VideoFacts(
        name=file_name_part(Path(video_name).stem),
        n_frames=frames[-1] + 1 if frames else None,
        first_frame=frames[0] if frames else 0,
        size_px=None if camera is None else (camera.width_px, camera.height_px),
        fps=run.fps and run.fps * every,
        is_rectified=True,
        provenance=run.provenance.metadata(),
        frames=frames,
    )
    return table_of_rows(rows, camera, video)


def processed_frames(run: RunFolder, *, is_live: bool) -> Sequence[int]:
    """Numbers of the processed frames; for a killed run that may have dropped frames, the frames
    with rows.
    """
    with_rows: list[int] = np.unique(run.rows["frame"]).tolist()
    n_frames, every = int(run.summary.get("frames") or 0), every_of(run.settings)
    spans = [
        range(first, last + 1, every) for first, last in run.summary.get("processed_frames") or ()
    ]
    if spans and sum(map(len, spans)) == n_frames:
        return sorted({*with_rows, *(frame for span in spans for frame in span)})
    if run.summary.get("frames_dropped", is_live or run.settings.get("realtime")):
        return with_rows
    # the numbers of the frames of a live run start at the number of the first processed one
    first = min(with_rows, default=0) if is_live or run.settings.get("start_s") else 0
    end = max(max(with_rows, default=-1) + 1, first + (n_frames - 1) * every + 1)
    has_others = any((frame - first) % every for frame in with_rows)
    return range(first, end, 1 if has_others else every)


def _video_of(settings: Mapping[str, Any]) -> str:
    """The left or only video, or its first file; "" = unknown."""
    stereo = settings.get("stereo")
    video = stereo[0] if isinstance(stereo, list) and stereo else settings.get("mono")
    if isinstance(video, list):  # several files
        video = video[0] if video else None
    return str(video or "")


def facts_of_video(video: Path) -> VideoFacts:
    """Properties of a video or folder of images; VideoError if it cannot be read."""
    with closing(open_video(video)) as reader:
        return VideoFacts(
            video.stem, reader.n_total, 0, (reader.width_px, reader.height_px), reader.fps
        )


def boxes_of_labels(
    path: Path, *, video: Path | None, first_frame: int, names: tuple[str, ...] = ()
) -> BoxTable:
    """The boxes of a label file, with frames from 0; `first_frame`: number of the video's first
    frame in the file; `names`: those of class numbers.

    LabelFileError: the file cannot be read, or has boxes before the first frame; VideoError: the
    video cannot be read.
    """
    facts = NO_FACTS if video is None else facts_of_video(video)
    table = label_format_of(path).read(path, replace(facts, first_frame=first_frame, names=names))
    if first_frame:
        if len(table) and table.frame[0] < first_frame:
            raise LabelFileError(
                f"{path}: expected frame numbers from {first_frame} (--first-frame), found "
                f"{table.frame[0]}."
            )
        table = _shifted(table, first_frame, has_video_length=facts.n_frames is not None)
    last = int(table.frame.max(initial=-1))
    if facts.n_frames is not None and last >= facts.n_frames:
        note = (
            f"{path.name} has boxes up to frame {last}, but the last frame of the video is "
            f"{facts.n_frames - 1}."
        )
        table = replace(table, notes=(*table.notes, note))
    return table


def _shifted(table: BoxTable, first_frame: int, *, has_video_length: bool) -> BoxTable:
    """The boxes with frames from `first_frame`, which becomes 0; a length that is not the video's
    counts frames of the file.
    """
    n_frames = table.video.n_frames
    if n_frames is not None and not has_video_length:
        n_frames = max(n_frames - first_frame, 1)
    start = max(table.video.first_frame - first_frame, 0)
    video = replace(table.video, n_frames=n_frames, first_frame=start)
    return replace(table, frame=table.frame - first_frame, video=video)


def frames_of_run(folder: Path) -> Iterator[tuple[int, Image]]:
    """Number and rectified left image of each frame of a run. May raise ConfigError, VideoError or
    RigError.
    """
    with closing(
        open_input(settings_from({"align": "off"}, folder / "settings.yaml"))
    ) as recording:
        for frame in recording.frames:
            yield frame.index, frame.left


def frames_of_video(video: Path) -> Iterator[tuple[int, Image]]:
    """Number and image of each frame of a video or folder of images; VideoError if it cannot be
    read.
    """
    with closing(open_video(video)) as reader:
        for frame in reader:
            yield frame.index, frame.image
