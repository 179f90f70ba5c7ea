"""Processing of one clip in a worker: fetch, run, publish.

    fetch -> compare the content -> open -> frames -> tracks.parquet -> other files -> record (the clip is complete)

A clip that has a complete result of other options is computed from the first stage that has changed
(`StageKeys`): with the stored boxes in place of the detector, from the stored rows alone, or for its
missing files. A clip that cannot be processed is a record with an error. Only storage that refuses
the results ends the fleet.
"""

from __future__ import annotations

import errno
import platform
import tempfile
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from track_range.fleet.engine.plan import (
    ClipOutcome,
    ClipProgress,
    ClipTask,
    FileNames,
    FleetPlan,
    Stage,
    hashed_text,
    output_name,
)
from track_range.fleet.engine.remaining import content_hash, fingerprint
from track_range.fleet.engine.worker import peak_memory_bytes, reset_peak_memory
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.inputs.dry_run import check_clips
from track_range.fleet.inputs.fetch import fetched
from track_range.fleet.output import data_set
from track_range.fleet.output.record import ERROR_FIGURES, ClipRecord, utc_now
from track_range.fleet.output.stored import (
    OF_ROWS,
    StoredDetections,
    metadata_of,
    pose_row,
    stored_events,
    write_of_rows,
    write_poses,
)
from track_range.fleet.settings import size_bytes
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import FolderListings, Location
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import printable
from track_range.foundation.processes import tuned_process
from track_range.foundation.schemas.keywords import flags_in_errors
from track_range.results.events.event import CLIPS_FOLDER
from track_range.results.events.files import (
    EVENTS_FILE,
    EVENTS_PARQUET,
    write_event_files,
    write_events_parquet,
)
from track_range.run.options.opened import OpenedDetectors
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings import RunSettings
from track_range.run.run import Run

if TYPE_CHECKING:
    import pyarrow as pa

_DETECTORS = OpenedDetectors()  # detector of this process, which its clips share
_MAX_ERROR = 600  # longest error of a clip, in characters
# lowest plausible data rate of a video; a damaged header may state any duration
_MIN_BYTES_PER_S = 1000.0
# with paths, or published elsewhere
_NOT_PUBLISHED = {"settings.yaml", data_set.TRACKS_FILE, EVENTS_PARQUET}
# outputs that show events, and their files
_WITH_EVENTS = {
    "clips": (),
    "mcap": ("run.mcap",),
    "reports": ("report.html", "summary.json"),
    "rrd": ("run.rrd",),
}


class _PublishingError(Exception):
    """The results cannot be written; the fleet ends."""


@flags_in_errors()
def run_clip(task: ClipTask, plan: FleetPlan, progress: ClipProgress) -> ClipOutcome:
    """Process a clip and publish its results; `progress` is updated meanwhile."""
    clip_run = _ClipRun(task, plan, progress)
    try:
        return clip_run.outcome()
    except _PublishingError as error:
        return ClipOutcome(clip_run.failed("internal", str(error)), fatal=str(error))


class _ClipRun:
    def __init__(self, task: ClipTask, plan: FleetPlan, progress: ClipProgress) -> None:
        self._task, self._plan, self._progress = task, plan, progress
        self._clip = task.clip
        self._out = plan.out
        self._start_s = time.perf_counter()
        self._run_s = 0.0
        self._names: dict[str, str] = {}
        self._file_names = FileNames(self._clip, is_anonymized=plan.is_anonymized)
        self._record = replace(plan.record(self._clip, task.attempt), node=platform.node())

    def outcome(self) -> ClipOutcome:
        reset_peak_memory()
        try:
            if not self._task.known_hash and (changes := self._made_from_rows()):
                return ClipOutcome({}, changes)
            self._progress.phase = "fetching"
            listings = FolderListings()
            for location in map(Location.of, self._clip.named_files().values()):
                # files on this machine only have to be read
                weight = 0.05 if location.is_local else 1.0
                if (state := listings.state(location)) is not None:
                    self._progress.fetch_bytes += max(state.size, 0) * weight
            with (
                tempfile.TemporaryDirectory(prefix="clip-", ignore_cleanup_errors=True) as name,
                fetched(
                    self._clip, Path(name, "inputs"), size_bytes(self._plan.settings.cache_size)
                ) as (local, files),
            ):
                self._names = {
                    str(file.path): str(Location.of(file.address)) for file in files.values()
                }
                states = {role: (file.size, file.mtime_ns) for role, file in files.items()}
                self._record = replace(
                    self._record,
                    inputs=fingerprint(self._clip, states),
                    content_hash=content_hash(
                        self._clip, {role: file.sha256 for role, file in files.items()}
                    ),
                )
                folder, n_bytes = Path(name), max(file.size for file in files.values())
                return self._outcome_of(local, folder, n_bytes)
        except StorageError as error:
            return self._failure("fetch", error, is_transient=error.is_transient)
        except UserError as error:
            return self._failure("input", error)
        except MemoryError as error:
            return self._failure("memory", error, is_transient=True)
        except Exception as error:
            return self._failure("internal", error)

    def failed(self, kind: str, message: str) -> dict[str, Any]:
        text = printable(" ".join(self._with_names(message).split()))[:_MAX_ERROR]
        return self._with_times(
            replace(self._record, status="failed", error=text, error_kind=kind)
        ).row()

    def _failure(self, kind: str, error: Exception, *, is_transient: bool = False) -> ClipOutcome:
        if _is_full(error):
            raise _PublishingError(
                f"no space left for the clip {self._clip.name} on {platform.node()}: {error}"
            ) from error
        message = str(error)
        if kind == "internal":
            at = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(at.filename).name}, line {at.lineno}"
            message = f"unexpected error, {type(error).__name__}: {message or 'no text'} ({where})"
        if kind == "memory":
            message = message or "the memory of the machine is not enough for this clip"
        return ClipOutcome(self.failed(kind, message), is_transient=is_transient)

    def _outcome_of(self, local: Clip, folder: Path, n_bytes: int) -> ClipOutcome:
        """The outcome with the files on this machine, the largest of `n_bytes`."""
        task, stage = self._task, self._task.stage
        if task.known_hash:
            inputs = {"inputs": self._record.inputs}
            if self._record.content_hash != task.known_hash:
                if not self._plan.settings.overwrite:
                    return ClipOutcome({}, is_kept=True)
                stage = "tracks"  # boxes of the same images remain
            elif not stage:
                return ClipOutcome({}, inputs)
            elif changes := self._made_from_rows():
                return ClipOutcome({}, changes | inputs)
        self._process(local, folder, n_bytes, stage)
        if stage != "outputs":
            return ClipOutcome(self._record.row())
        return ClipOutcome({}, {"inputs": self._record.inputs, "outputs": self._outputs_after})

    def _made_from_rows(self) -> dict[str, Any]:
        """What changes in the complete record, if what is to be made follows from the stored rows:
        events, or tables without images; {} = it does not.
        """
        task, keys, out, name = self._task, self._plan.keys, self._out, self._clip.name
        kept = {output for output in task.made if output_name(output) not in _WITH_EVENTS}
        is_of_events = task.stage == "events" and kept.issuperset(keys.outputs)
        is_of_rows = task.stage == "outputs" and self._missing <= OF_ROWS
        if not (is_of_events or is_of_rows):
            return {}
        self._progress.phase = "reading"
        with tempfile.TemporaryDirectory(prefix="clip-", ignore_cleanup_errors=True) as temporary:
            folder = Path(temporary)
            tracks = folder / data_set.TRACKS_FILE
            tracks.write_bytes(data_set.tracks_location(out, name).read_bytes())
            if is_of_rows:
                files = write_of_rows(tracks, data_set.events_location(out, name), self._missing)
                with _publishing():
                    for file in files:
                        place = data_set.runs_location(out, name).child(file.name)
                        data_set.publish(out, place, file)
                return {"outputs": self._outputs_after}
            settings = clip_settings(self._plan.options, self._clip).event_settings
            events = stored_events(tracks, data_set.poses_location(out, name), settings)
            if events is None:
                return {}
            write_event_files(folder, events, metadata_of(tracks))
            with _publishing():
                self._publish_events(folder)
        changes = {"events_key": keys.events, "settings_hash": keys.settings}
        return {**changes, "events": len(events), "outputs": sorted(kept)}

    def _publish_events(self, folder: Path) -> None:
        """Publish events in place of others, and remove the files that show the others."""
        out, name = self._out, self._clip.name
        place = data_set.runs_location(out, name)
        data_set.publish(out, data_set.events_location(out, name), folder / EVENTS_PARQUET)
        if place.child(EVENTS_FILE).exists():
            data_set.publish(out, place.child(EVENTS_FILE), folder / EVENTS_FILE)
        for file in chain(*_WITH_EVENTS.values()):
            place.child(file).remove()
        data_set.publish_files(out, place.child(CLIPS_FOLDER), ())

    @property
    def _missing(self) -> set[str]:
        """The outputs that the complete result lacks."""
        return set(self._plan.keys.outputs).difference(self._task.made)

    @property
    def _outputs_after(self) -> list[str]:
        """The outputs of the complete result and the requested ones, of each name the latter."""
        outputs = self._plan.keys.outputs
        names = set(map(output_name, outputs))
        return sorted(
            {*outputs, *(made for made in self._task.made if output_name(made) not in names)}
        )

    def _process(self, clip: Clip, folder: Path, n_bytes: int, stage: Stage) -> None:
        """Run the clip with local files, the largest of `n_bytes`, and publish the results."""
        progress, plan, out, name = self._progress, self._plan, self._out, self._clip.name
        settings = clip_settings(plan.options, clip)
        outputs = plan.keys.outputs
        names = set(map(output_name, outputs)).intersection(settings.write)
        run_folder = folder / "run" if outputs else None
        settings = settings.model_copy(update={"out": run_folder, "write": tuple(sorted(names))})
        start_s = time.perf_counter()
        progress.phase = "opening"
        progress.video_s = _video_s(clip, settings, n_bytes)
        boxes = StoredDetections.read(
            data_set.detections_location(out, name), detections_key(plan, clip)
        )
        poses = []
        with (
            # what is blurred are more boxes than those
            Run(
                settings,
                opened_detectors=_DETECTORS,
                boxes=(lambda source: source) if settings.anonymize else boxes.source,
            ) as run,
            tuned_process(has_dense_stereo=settings.sgbm),
        ):
            progress.phase = "processing"
            for result in run:
                progress.frames += 1
                poses.append(pose_row(result))
        self._run_s = time.perf_counter() - start_s
        progress.phase = "publishing"
        table = run.session.rows.table.to_arrow(is_rounded=False)
        metadata = {
            **run.session.origin.provenance.metadata(),
            "track_range.settings_hash": plan.keys.settings,
            "track_range.content_hash": self._record.content_hash,
            "track_range.clip": name,
        }
        write_tracks(folder / data_set.TRACKS_FILE, table, metadata)
        # of which the data set knows the clips by their places in it
        place = f"{data_set.RUNS}/{data_set.partition(name)}"
        events = [
            replace(event, clip_file=event.clip_file and f"{place}/{event.clip_file}")
            for event in run.events
        ]
        write_events_parquet(folder / EVENTS_PARQUET, events, metadata)
        self._add_summary(run.summary, table.num_rows, run)
        places = {
            data_set.events_location(out, name): folder / EVENTS_PARQUET,
            data_set.poses_location(out, name): folder / "poses.parquet",
            data_set.tracks_location(out, name): folder / data_set.TRACKS_FILE,
        }
        write_poses(folder / "poses.parquet", poses)
        if boxes.is_changed:
            places[data_set.detections_location(out, name)] = folder / "detections.parquet"
            boxes.write(folder / "detections.parquet")
        with _publishing():
            if stage != "outputs":
                for location, file in places.items():
                    data_set.publish(out, location, file)
            elif "clips" in self._missing:  # of which the events know the names
                location = data_set.events_location(out, name)
                data_set.publish(out, location, folder / EVENTS_PARQUET)
            self._publish_files(run_folder, is_whole=stage != "outputs")
            self._record = self._with_times(self._record)
            if stage != "outputs":
                data_set.publish_record(out, self._record.row())

    def _publish_files(self, folder: Path | None, *, is_whole: bool) -> None:
        """Publish the other files of a run; without `is_whole`, only missing ones."""
        out = self._out
        place = data_set.runs_location(out, self._clip.name)
        made = () if folder is None else sorted(folder.iterdir())
        left_out = _NOT_PUBLISHED | (
            set() if self._plan.settings.reports else {"report.html", "summary.json"}
        )
        files = [
            file
            for file in made
            if file.is_file() and file.name not in left_out and file.name[0] != "."
        ]
        clips = () if folder is None else sorted((folder / CLIPS_FOLDER).glob("*.mp4"))
        if is_whole:
            data_set.publish_files(out, place, files)
            data_set.publish_files(out, place.child(CLIPS_FOLDER), clips)
            return
        for file in files:
            # events name their videos
            is_other = file.name == EVENTS_FILE and "clips" in self._missing
            if self._task.is_replaced or is_other or not place.child(file.name).exists():
                data_set.publish(out, place.child(file.name), file)
        if "clips" in self._missing:
            data_set.publish_files(out, place.child(CLIPS_FOLDER), clips)

    def _add_summary(self, summary: Mapping[str, Any], n_rows: int, run: Run) -> None:
        methods: Mapping[str, Mapping[str, Any]] = summary["methods"]
        errors = {
            name: _numbers({key: values.get(key) for key in ERROR_FIGURES})
            for name, values in methods.items()
        }
        self._record = replace(
            self._record,
            status="done",
            frames=int(summary["frames"]),
            rows=n_rows,
            tracks=int(summary["tracks"]["n"]),
            events=len(run.events),
            outputs=self._plan.keys.outputs,
            seconds=round(run.session.rows.seconds, 6),
            calibration=str(summary["calibration"]),
            focal_px=summary["focal_px"],
            focal_sigma=summary["focal_sigma"],
            start_utc=str((summary["utc"] or {}).get("start") or ""),
            warnings=[self._with_names(note) for note in summary["notes"]],
            stages_ms=summary["stages_ms"],
            coverage={name: values.get("coverage") for name, values in methods.items()},
            errors={name: values for name, values in errors.items() if values},
            alignment={
                key: float(value) for key, value in _numbers(summary.get("alignment", {})).items()
            },
        )

    def _with_times(self, record: ClipRecord) -> ClipRecord:
        wall_s = time.perf_counter() - self._start_s
        return replace(
            record,
            wall_s=round(wall_s, 3),
            overhead_s=round(wall_s - self._run_s, 3),
            peak_memory_mb=round(peak_memory_bytes() / 1e6, 1),
            finished_utc=utc_now(),
        )

    def _with_names(self, text: str) -> str:
        """A text with the names of the recordings in the results instead of the paths of their
        local copies.
        """
        for local, name in self._names.items():
            text = text.replace(local, name)
        return self._file_names.text(text)


def clip_settings(options: Mapping[str, Any], clip: Clip) -> RunSettings:
    """Settings of the run of a clip with local files; its settings have precedence over the options
    of all clips.

    Raises UsageError for a setting of the clip that is invalid, or does not suit its video.
    """
    video: dict[str, Any] = (
        {"mono": clip.left} if clip.right is None else {"stereo": (clip.left, clip.right)}
    )
    own: dict[str, Any] = dict(clip.settings)
    n_topics = len([topic for topic in str(own.get("topics", "")).split(",") if topic])
    if clip.right is None and (n_topics > 1 or "stereo_layout" in {**options, **own}):
        video = {"stereo": (clip.left,)}
    # a calibration of the clip knows them
    known = {"focal_px", "lens_fov_deg", "camera_model"} if "rig" in own else set()
    shared = {key: value for key, value in options.items() if key not in known}
    return settings_from({**shared, **video, **own})


def detections_key(plan: FleetPlan, clip: Clip) -> str:
    """Hash of all that determines the boxes of the detector in an image of a clip."""
    own = {
        name: value
        for name, value in clip.settings.items()
        if RunSettings.stage_of(name) == "detections"
    }
    return hashed_text({"common": plan.keys.detections, "clip": own})


def _video_s(clip: Clip, settings: RunSettings, n_bytes: int) -> float:
    """Duration that is processed of a clip whose largest file has `n_bytes`, as far as it is
    known.
    """
    header = next(
        check_clips([clip], fps=settings.fps, stereo_layout=settings.stereo_layout, threads=1)
    )
    stated_s = header.duration_s or 0.0
    if settings.duration_s is not None:
        stated_s = min(stated_s, settings.duration_s)
    return max(0.0, min(stated_s, n_bytes / _MIN_BYTES_PER_S))


@contextmanager
def _publishing() -> Iterator[None]:
    try:
        yield
    except StorageError as error:
        raise _PublishingError(str(error)) from error


def write_tracks(path: Path, table: pa.Table, metadata: Mapping[str, str]) -> None:
    """Write the rows of a clip; the same rows give the same bytes."""
    from track_range.results.formats.parquet_file import write_table

    write_table(path, table.replace_schema_metadata(dict(metadata)))


def _is_full(error: BaseException | None) -> bool:
    while error is not None:
        number = error.errno if isinstance(error, OSError) else None
        if getattr(error, "kind", "") == "full" or number in (errno.ENOSPC, errno.EDQUOT):
            return True
        error = error.__cause__ or error.__context__
    return False


def _numbers(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: value
        for key, value in values.items()
        if isinstance(value, int | float) and not isinstance(value, bool)
    }
