"""RunFolder: results of a run read from its folder, where files may be missing or damaged.

A killed run leaves settings.yaml and the rows up to its last complete frame (tracks.csv,
tracks.arrows), but no summary.json. Coverage, errors and tracking metrics are then computed from
the rows, with the ground truth if its file still exists.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, field_validator

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import BoolArray
from track_range.foundation.files.input_files import real_path
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.files.structured_text import read_json, read_yaml
from track_range.foundation.schemas.validation import Number, PositiveNumber, validated
from track_range.ranging.truth.truth import Truth, TruthChoices, read_truth
from track_range.results.approaches import closest_approaches
from track_range.results.events.event import Event
from track_range.results.events.files import EVENTS_FILE, EventFileError, read_events
from track_range.results.events.finder import events_of
from track_range.results.formats.csv_file import TABLE_FILE, read_tracks_csv
from track_range.results.formats.parquet_file import (
    PARQUET_FILE,
    STREAM_FILE,
    read_tracks_arrows,
    read_tracks_parquet,
)
from track_range.results.formats.provenance import Provenance, settings_hash
from track_range.results.progress_note import describe_progress
from track_range.results.replay import frames_of_rows
from track_range.results.rows.columns import declared_columns
from track_range.results.rows.rows import Rows
from track_range.results.summary import (
    MatchedTruth,
    events_section,
    matched_truth,
    truth_figures,
    with_truth,
)
from track_range.results.summary_shape import valid_summary
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import ImageSide
from track_range.stereo.rig_formats.reading import left_from_reference_m

Sections = Mapping[str, Any]

_NEEDED_COLUMNS = frozenset(
    ("frame", "time_s", "track_id", "class", "x1_px", "y1_px", "x2_px", "y2_px")
)
"""Required columns; files of earlier versions may lack others."""

_MAX_FRAME = 1e9  # a year at 30 Hz
_MAX_VALUE = 1e10  # absolute value of a distance by a method that is not installed
_MAX_EDGE_PX = 1e6
_MAX_TRACK_ID = 2.0**53  # up to which all integers are exact in float64
_MAX_SUMMARY_BYTES = 50_000_000  # that of a long run has less than 1 MB
_MAX_NAMED = 5  # values of wrong types that a note names
_MAX_BEYOND_S = 1.0  # tolerance for events after the last row or the end of the video
# without a rate in settings.yaml, as for folders; largest plausible rate
DEFAULT_FPS, _MAX_FPS = 10.0, 10_000.0
EVALUATION_FILE = "evaluation.json"
# its sections, in place of those of summary.json
_EVALUATED = ("methods", "common", "closing", "lateral", "tracks", "truth", "targets")
# settings that are inputs of a run
_INPUTS = ("mono", "rig", "focal_px", "detector", "detections", "curves", "truth")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunFolder:
    """Results of a run; events of a killed run, or of a damaged events.csv, are found again from
    the rows.
    """

    folder: Path
    # content of summary.json, or what can be computed from the rows; its notes begin with `missing`
    summary: Sections
    rows: Rows  # with `truth_m` and `scored_truth_m` if the ground truth can be read
    settings: Sections  # section `run` of settings.yaml; empty without that file
    missing: tuple[str, ...]  # messages about files that are missing or cannot be read
    events: tuple[Event, ...] = ()
    are_events_replayed: bool = False  # whether the events were found again from the rows
    detected: Sections = field(default_factory=dict)  # section `found` of settings.yaml
    fps: float | None = None  # None = unknown
    provenance: Provenance = field(default_factory=Provenance)


class DetectedCamera(BaseModel):
    """Section `found` of settings.yaml: the left camera of the run and its calibration file."""

    image_size_px: tuple[ImageSide, ImageSide]
    principal_point_px: tuple[Number, Number]
    focal_px: PositiveNumber
    focal_y_px: PositiveNumber | None = None
    rig: Path | None = None
    mount: tuple[str, ...] = ()  # of the view in its vehicle; empty = unknown

    @field_validator("mount")
    @classmethod
    def _is_mounting(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if value:
            Mounting.of(value)
        return value

    def mounting(self) -> Mounting | None:
        """Where the view is in the vehicle, and where it looks; None = unknown."""
        return Mounting.of(self.mount) if self.mount else None

    def camera(self) -> PinholeCamera:
        """Left camera of the run."""
        focal_y_px = self.focal_px if self.focal_y_px is None else self.focal_y_px
        return PinholeCamera(
            self.focal_px, focal_y_px, *self.principal_point_px, *self.image_size_px
        )


def truth_of(settings: Sections, detected: Sections) -> Truth:
    """Ground truth of the options `truth`, `truth_calib` and so on, for a run with this section
    `found` of its settings.yaml.

    Raises LabelFileError, RigError: a file cannot be used; OutputError: the section is damaged.
    """
    facts = validated(DetectedCamera, detected, "settings.yaml, found", OutputError)
    shift_m = np.zeros(3)
    if facts.rig and facts.rig.is_file():
        shift_m = left_from_reference_m(facts.rig, is_grey=False, size_px=facts.image_size_px)
    calib, poses = (settings.get(name) for name in ("truth_calib", "truth_poses"))
    given = TruthChoices(
        None if calib is None else Path(str(calib)),
        None if poses is None else Path(str(poses)),
        float(settings.get("truth_ahead_m") or 0.0),
        settings.get("truth_offset_s"),
    )
    return read_truth(Path(str(settings["truth"])), facts.camera(), shift_m, given)


def read_run_folder(folder: Path, *, is_rounded: bool = True, has_events: bool = True) -> RunFolder:
    """Read the files of a run; OutputError if there is no run, or if the file of its rows has other
    columns.

    Numbers are rounded as in tracks.csv, or, without `is_rounded`, in full precision if the run
    wrote tracks.parquet. The events are read only with `has_events`.
    """
    if not folder.is_dir():
        raise OutputError(f"{folder}: expected the result folder of a run, found no such folder.")
    return _Reader(folder).run(is_rounded=is_rounded, has_events=has_events)


class _Reader:
    """Reader of one folder; missing files are collected as messages for the user."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.missing: list[str] = []
        self.summary = self._read_summary()
        document: Any = None
        try:
            document = read_yaml(folder / "settings.yaml", OutputError, "the settings of a run")
        except OutputError:
            is_run = clip_rows(folder) is None
            reason = (
                "settings.yaml is missing or cannot be read"
                if is_run
                else "A fleet writes no settings.yaml of clips"
            )
            self.missing.append(f"{reason}: the settings of the run are unknown.")
        document = document if isinstance(document, dict) else {}
        self.settings, self.detected = _section(document, "run"), _section(document, "found")
        recorded_hash, fps = document.get("settings_hash"), self.detected.get("fps")
        self.settings_hash = (
            recorded_hash if isinstance(recorded_hash, str) else settings_hash(self.settings)
        )
        self.fps = float(fps) if isinstance(fps, int | float) and 0 < fps <= _MAX_FPS else None
        self._use_evaluation(folder / EVALUATION_FILE)

    def _use_evaluation(self, file: Path) -> None:
        """Replace the figures and the ground truth by those of a later evaluation of the run."""
        if not file.exists():
            return
        evaluation = read_json(file, OutputError, "an evaluation of the run")
        evaluation = evaluation if isinstance(evaluation, dict) else {}
        sections = {key: evaluation[key] for key in _EVALUATED if key in evaluation}
        self.settings |= _section(evaluation, "settings")
        if self.summary is not None:
            self.summary = {key: self.summary[key] for key in self.summary if key not in _EVALUATED}
            self.summary |= sections

    def _read_summary(self) -> dict[str, Any] | None:
        file = self.folder / "summary.json"
        if not file.exists():
            killed = (
                "the run was killed"
                if clip_rows(self.folder) is None
                else "the fleet was run without --reports"
            )
            self.missing.append(
                f"summary.json is missing: {describe_progress(self.folder) or killed}. Stage "
                "times, alignment and notes are unknown; the other results are computed from the "
                "rows of the tracks."
            )
            return None
        with suppress(OutputError):
            summary = read_json(
                file, OutputError, "the summary of a run", max_bytes=_MAX_SUMMARY_BYTES
            )
            if isinstance(summary, dict):
                return summary
        self.missing.append(
            "summary.json cannot be read: results are computed from the rows of the tracks."
        )
        return None

    def run(self, *, is_rounded: bool, has_events: bool) -> RunFolder:
        rows = self._rows(is_rounded=is_rounded)
        if self.summary is None and rows is None:
            progress = describe_progress(self.folder)
            raise OutputError(
                f"{self.folder}: no frames yet: {progress}."
                if progress is not None
                else f"{self.folder}: expected the result folder of a run, found neither rows "
                "(tracks.csv, tracks.parquet) nor summary.json in it."
            )
        if rows is None:
            path = clip_rows(self.folder)
            raise OutputError(
                f"{self.folder}: expected the rows of the run in {TABLE_FILE} or {PARQUET_FILE}, "
                "found neither; restore one of the files, or repeat the run with --write csv."
                if path is None
                else f"{self.folder}: expected the rows of this clip in {path}, found no such "
                "file; restore the file, or repeat the clip with fleet run."
            )
        truth = self._truth()
        matched = None if truth is None else matched_truth(rows, truth)
        if matched is not None:
            rows = with_truth(rows, matched)
        events = (
            self._events(rows, self.summary) if has_events and self.summary is not None else None
        )
        is_replayed = has_events and events is None
        summary = self._summary_from_rows(rows, matched) if self.summary is None else self.summary
        if is_replayed:
            fps = self.fps or DEFAULT_FPS
            events = self._replayed_events(rows, fps)
            seconds = float(np.ptp(rows["time_s"])) + 1 / fps if len(rows) else 0.0
            summary["events"] = events_section(events, seconds)
        summary = self._checked(summary)
        # runs of earlier versions have these sections only in summary.json
        earlier: dict[str, Any] = {
            key: summary[key] for key in ("calibration", "utc") if key in summary
        }
        return RunFolder(
            folder=self.folder,
            summary=summary,
            rows=rows,
            settings=self.settings,
            missing=tuple(self.missing),
            events=events or (),
            are_events_replayed=is_replayed,
            detected=self.detected,
            fps=self.fps,
            provenance=Provenance.of_inputs({**earlier, **self.detected}, self.settings_hash),
        )

    def _rows(self, *, is_rounded: bool) -> Rows | None:
        path = rows_file(self.folder, is_rounded=is_rounded)
        if path is None:
            return None
        rows = read_run_rows(path, self.missing)
        return rows.rounded() if is_rounded and path.name != TABLE_FILE else rows

    def _truth(self) -> Truth | None:
        """Ground truth of the run; None if there was none or it can no longer be read."""
        if not self.settings.get("truth"):
            return None
        try:
            return truth_of(self.settings, self.detected)
        except (LabelFileError, RigError, OutputError) as error:
            reason = str(error).rstrip(".")
            self.missing.append(
                f"The ground truth cannot be read, so charts do not show it ({reason})."
            )
            return None

    def _events(self, rows: Rows, summary: Sections) -> tuple[Event, ...] | None:
        """Events of a finished run; empty for a run of an earlier version, None if the file is
        missing or damaged.
        """
        path = self.folder / EVENTS_FILE
        section = _section(summary, "events")
        if not path.exists() and not section:
            return ()
        try:
            events = read_events(path)
        except EventFileError as error:
            self.missing.append(
                f"{EVENTS_FILE} cannot be read: events come from the rows of the tracks ({error})"
            )
            return None
        hours, starts_s = (
            value if isinstance(value, int | float) else 0.0
            for value in (section.get("hours"), summary.get("starts_s"))
        )
        last_s = max(float(np.max(rows["time_s"], initial=0.0)), starts_s + 3600 * hours)
        inside = tuple(event for event in events if event.start_s <= last_s + _MAX_BEYOND_S)
        if n_beyond := len(events) - len(inside):
            self.missing.append(
                f"{n_beyond} of {len(events)} events of {EVENTS_FILE} start after the end of the "
                f"video at {last_s:.1f} s and are ignored."
            )
        return inside

    def _replayed_events(self, rows: Rows, fps: float) -> tuple[Event, ...]:
        """Events found again from the rows, in full precision if the folder contains a file with
        them.
        """
        path = rows_file(self.folder)
        if path is not None and path.name != TABLE_FILE:
            with suppress(OutputError):  # the rounded rows are used
                rows = read_run_rows(path, [])
        rows = rows.select(np.argsort(rows["frame"], kind="stable"))
        frames = np.unique(rows["frame"]).tolist()
        return events_of(frames_of_rows(rows, frames, rows.methods_measured, fps))

    def _summary_from_rows(self, rows: Rows, matched: MatchedTruth | None) -> dict[str, Any]:
        truth = None if matched is None else matched.truth
        frame = rows["frame"]
        first, last = (int(frame.min()), int(frame.max())) if len(frame) else (0, -1)
        every = every_of(self.settings)
        labelled = np.zeros(0, np.int64) if truth is None else np.unique(truth.frame)
        labelled = labelled[
            (labelled >= first) & (labelled <= last) & ((labelled - first) % every == 0)
        ]
        methods = tuple(name for name in rows.methods_measured if f"{name}_sigma_m" in rows)
        inputs = {key: self.settings[key] for key in _INPUTS if key in self.settings}
        stereo = self.settings.get("stereo")
        if isinstance(stereo, list) and len(stereo) == 2:
            inputs = {"left": stereo[0], "right": stereo[1], **inputs}
        return {
            "frames": (last - first) // every + 1,
            **truth_figures(rows, matched, methods, labelled),
            "closest_approaches": closest_approaches(rows),
            "inputs": inputs,
            "files": {"overlay": "overlay.mp4"} if self.settings.get("overlay", True) else {},
        }

    def _checked(self, summary: Sections) -> dict[str, Any]:
        """Summary with the camera and the settings from settings.yaml, without files that do not
        exist.

        Values of wrong types are omitted; missing files and omitted values are added to the notes.
        """
        files = _section(summary, "files")
        absent = [name for name in files.values() if not os.path.isfile(self.folder / str(name))]
        self.missing += [f"{name} is missing and cannot be shown." for name in absent]
        camera = {
            key: self.detected[key]
            for key in ("focal_px", "baseline_m", "versions")
            if self.detected.get(key) is not None
        }
        settings = {key: value for key, value in self.settings.items() if value not in ([], {})}
        merged = {
            **camera,
            "settings": settings,
            "starts_s": settings.get("start_s", 0.0),
            **summary,
        }
        merged["files"] = {key: name for key, name in files.items() if name not in absent}
        checked, invalid = valid_summary(merged)
        if invalid:
            more = "" if len(invalid) <= _MAX_NAMED else f" and {len(invalid) - _MAX_NAMED} more"
            self.missing.append(
                "summary.json and settings.yaml contain values of unexpected types, which are "
                f"ignored: {', '.join(invalid[:_MAX_NAMED])}{more}."
            )
        return {**checked, "notes": [*self.missing, *(checked.get("notes") or [])]}


def every_of(settings: Sections) -> int:
    """N, if the settings of a run process every N-th frame of the video."""
    every = settings.get("every")
    return every if isinstance(every, int) and 1 <= every <= 1000 else 1


def _section(document: Sections, name: str) -> dict[str, Any]:
    section = document.get(name)
    return dict(section) if isinstance(section, dict) else {}


def rows_file(folder: Path, *, is_rounded: bool = False) -> Path | None:
    """The file with the rows of a run or of a fleet's clip, in full precision or rounded if both
    exist; None = none.
    """
    # the stream of a run in progress, or of one that was killed
    in_full = (PARQUET_FILE, STREAM_FILE)
    paths = [
        folder / name for name in ((TABLE_FILE, *in_full) if is_rounded else (*in_full, TABLE_FILE))
    ]
    return next(
        (path for path in (*paths, clip_rows(folder)) if path is not None and path.is_file()), None
    )


def clip_rows(folder: Path) -> Path | None:
    """File of the rows of a fleet's clip, whose folder is runs/clip=NAME or tracks/clip=NAME; None
    = another folder.
    """
    path = real_path(folder)
    is_clip = path.name.startswith("clip=") and path.parent.name in ("runs", "tracks")
    return path.parent.parent / "tracks" / path.name / PARQUET_FILE if is_clip else None


def read_run_rows(path: Path, missing: list[str]) -> Rows:
    """Rows of a tracks.csv, tracks.parquet or tracks.arrows without damaged ones.

    A message with the number of damaged rows is added to `missing`. OutputError if the file cannot
    be read, is not of a run, or all of its rows are malformed.
    """
    if path.suffix == ".arrows":
        columns, is_cut = read_tracks_arrows(path)
    elif path.suffix == ".parquet":
        columns, is_cut = read_tracks_parquet(path), False
    else:
        columns = read_tracks_csv(path)
        with path.open("rb") as file:
            file.seek(-1, os.SEEK_END)  # the file contains at least a header
            is_cut = file.read() != b"\n"
    if not columns.keys() >= _NEEDED_COLUMNS:
        raise OutputError(
            f"{path}: expected the {path.name} of a run, but columns are missing: "
            f"{', '.join(sorted(_NEEDED_COLUMNS - columns.keys()))}."
        )
    is_valid = valid_rows(columns)
    n_rows = int(np.sum(is_valid))
    n_invalid = len(is_valid) - n_rows
    if n_invalid and not n_rows:
        raise OutputError(
            f"{path}: expected rows with frame numbers, times, track IDs and boxes, found only "
            f"malformed ones ({n_invalid}); repeat the run or restore the file."
        )
    if n_invalid:
        missing.append(
            f"{n_invalid} of {len(is_valid)} rows of {path.name} are malformed and were ignored."
        )
    if is_cut:
        missing.append(f"{path.name} ends in the middle of a row, so later rows are missing.")
    return Rows({name: _without_infinity(values[is_valid]) for name, values in columns.items()})


def _without_infinity(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return np.where(np.isinf(values), np.nan, values) if values.dtype.kind == "f" else values


def valid_rows(columns: Mapping[str, npt.NDArray[Any]]) -> BoolArray:
    """(N,) mask of rows with a frame number, a time, a track ID that is unique in the frame, and a
    box.
    """
    frame, track_id = columns["frame"], columns["track_id"]
    edges_px = np.stack([columns[name] for name in ("x1_px", "y1_px", "x2_px", "y2_px")], axis=1)
    declared = declared_columns()
    is_valid: BoolArray = np.isfinite(columns["time_s"]) & (np.abs(edges_px) <= _MAX_EDGE_PX).all(
        axis=1
    )
    for name, values in columns.items():
        if values.dtype.kind == "f" and name not in ("frame", "track_id"):
            largest = declared[name].largest if name in declared else _MAX_VALUE
            is_valid &= ~np.isfinite(values) | (np.abs(values) <= largest)
    for number, lowest, highest in ((frame, 0, _MAX_FRAME), (track_id, 1, _MAX_TRACK_ID)):
        is_valid &= (number >= lowest) & (number <= highest) & (number == np.floor(number))
    rows = np.flatnonzero(is_valid)
    _, first = np.unique(np.stack([frame, track_id], axis=1)[rows], axis=0, return_index=True)
    is_first = np.zeros(len(frame), np.bool_)
    is_first[rows[first]] = True
    return is_first
