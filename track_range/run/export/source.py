"""Source of an export: a finished run, or a label file."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.formats.box_table import BoxTable, VideoFacts, file_name_part
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.label_formats import label_format_of
from track_range.foundation.arrays import Image
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.files.structured_text import read_yaml
from track_range.foundation.validation import validated
from track_range.recording.live.address import live_address
from track_range.recording.open_video import open_video
from track_range.results.folder import DetectedCamera, RunFolder, read_run_folder
from track_range.results.formats.box_files import table_of_rows
from track_range.results.provenance import Provenance, settings_hash
from track_range.run.build import open_input
from track_range.run.settings_files import settings_from
from track_range.stereo.geometry.camera import PinholeCamera

_RUN_FILES = ("settings.yaml", "tracks.csv", "tracks.parquet", "tracks.arrows", "summary.json")


@dataclass(frozen=True, slots=True)
class RunSource:
    """A finished run: its results, the section `found` of settings.yaml, and the left camera; None = unknown."""

    run: RunFolder
    detected: Mapping[str, Any]
    camera: PinholeCamera | None
    settings_hash: str

    @property
    def provenance(self) -> Provenance:
        """Origin of the results, from settings.yaml and, for runs of earlier versions, summary.json."""
        earlier = {key: self.run.summary[key] for key in ("calibration", "utc") if key in self.run.summary}
        return Provenance.of_inputs({**earlier, **self.detected}, self.settings_hash)

    @property
    def fps(self) -> float | None:
        """Frame rate; None = unknown."""
        fps = self.detected.get("fps")
        return float(fps) if isinstance(fps, int | float) and fps > 0 else None


def is_run(path: Path) -> bool:
    """Whether a path is the result folder of a run."""
    return any(os.path.isfile(path / name) for name in _RUN_FILES)


def run_files(folder: Path) -> list[Path]:
    """The files of a run that an export reads."""
    return [folder / name for name in _RUN_FILES]


def open_run(folder: Path) -> RunSource:
    """The results of a run.

    Raises:
        OutputError: the folder does not contain a run.
    """
    run = read_run_folder(folder, is_rounded=False, has_events=False)
    detected: Any = {}
    recorded_hash: Any = None
    if os.path.isfile(folder / "settings.yaml"):
        settings = read_yaml(folder / "settings.yaml", OutputError, "the settings of a run")
        if isinstance(settings, dict):
            detected, recorded_hash = settings.get("found"), settings.get("settings_hash")
    detected = detected if isinstance(detected, dict) else {}
    section = (
        validated(DetectedCamera, detected, f"{folder / 'settings.yaml'}, found", OutputError) if detected else None
    )
    camera = None if section is None else section.camera()
    return RunSource(
        run, detected, camera, recorded_hash if isinstance(recorded_hash, str) else settings_hash(run.settings)
    )


def boxes_of_run(source: RunSource) -> BoxTable:
    """The boxes of a run, in rectified pixels."""
    run, camera = source.run, source.camera
    rows, frames, video_name = run.columns, run.summary.get("frames"), _video_of(run.settings)
    n_frames = int(rows["frame"].max(initial=-1)) + 1
    # the numbers of the frames of a live run start at that of the first processed one
    is_part = bool(run.settings.get("start_s")) or live_address(video_name) is not None
    first = int(rows["frame"].min(initial=n_frames)) if is_part else 0
    if isinstance(frames, int):
        n_frames = max(n_frames, first + frames)
    video = VideoFacts(
        name=file_name_part(Path(video_name).stem),
        n_frames=n_frames or None,
        first_frame=first,
        size_px=None if camera is None else (camera.width_px, camera.height_px),
        fps=source.fps,
        is_rectified=True,
        provenance=source.provenance.metadata(),
    )
    return table_of_rows(rows, camera, video)


def _video_of(settings: Mapping[str, Any]) -> str:
    """The left or only video, or its first file; "" = unknown."""
    stereo = settings.get("stereo")
    video = stereo[0] if isinstance(stereo, list) and stereo else settings.get("mono")
    if isinstance(video, list):  # several files
        video = video[0] if video else None
    return str(video or "")


def boxes_of_labels(path: Path, *, video: Path | None, first_frame: int) -> BoxTable:
    """The boxes of a label file, with frames from 0; `first_frame`: number of the video's first frame in the file.

    Raises:
        LabelFileError: the file cannot be read, or has boxes before the first frame.
        VideoError: the video cannot be read.
    """
    facts = VideoFacts() if video is None else _facts(video)
    table = label_format_of(path).read(path, facts)
    if first_frame:
        if len(table) and table.frame[0] < first_frame:
            raise LabelFileError(
                f"{path}: expected frame numbers from {first_frame} (--first-frame), found {table.frame[0]}."
            )
        n_frames = table.video.n_frames
        shifted = replace(
            table.video,
            n_frames=n_frames if n_frames is None or facts.n_frames is not None else max(n_frames - first_frame, 1),
            first_frame=max(table.video.first_frame - first_frame, 0),
        )
        table = replace(table, frame=table.frame - first_frame, video=shifted)
    last = int(table.frame.max(initial=-1))
    if facts.n_frames is not None and last >= facts.n_frames:
        note = f"{path.name} has boxes up to frame {last}, but the last frame of the video is {facts.n_frames - 1}."
        table = replace(table, notes=(*table.notes, note))
    return table


def _facts(video: Path) -> VideoFacts:
    with closing(open_video(video)) as reader:
        return VideoFacts(video.stem, reader.n_frames, 0, (reader.width_px, reader.height_px), reader.fps)


def named_boxes(table: BoxTable) -> tuple[BoxTable, tuple[str, ...]]:
    """A table with the class person for boxes without a class, as in MOTChallenge, and a note on them."""
    n_unnamed = int(np.count_nonzero(table.class_name == ""))
    if not n_unnamed:
        return table, ()
    return table.with_class(0), (f"Boxes without a class in the input, which are written as person: {n_unnamed}.",)


def frames_of_run(folder: Path) -> Iterator[tuple[int, Image]]:
    """Number and rectified left image of each frame of a run, from its video.

    Raises:
        ConfigError, VideoError, RigError: settings.yaml or the video cannot be read.
    """
    recording = open_input(settings_from({"align": "off"}, folder / "settings.yaml"))
    with closing(recording):
        for frame in recording.frames:
            yield frame.index, frame.left


def frames_of_video(video: Path) -> Iterator[tuple[int, Image]]:
    """Number and image of each frame of a video or folder of images.

    Raises:
        VideoError: it cannot be read.
    """
    with closing(open_video(video)) as reader:
        for frame in reader:
            yield frame.index, frame.image
