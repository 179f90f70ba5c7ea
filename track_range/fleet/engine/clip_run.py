"""Processing of one clip in a worker: fetch, run, publish.

    fetch -> compare the content -> open -> frames -> tracks.parquet -> other files -> record (the clip is complete)

A clip that cannot be processed is a record with an error. Only storage that refuses the results ends the fleet.
"""

from __future__ import annotations

import errno
import platform
import tempfile
import time
import traceback
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from track_range.fleet.engine.plan import ClipOutcome, ClipProgress, ClipTask, FileNames, FleetPlan
from track_range.fleet.engine.remaining import content_hash, fingerprint
from track_range.fleet.engine.worker import peak_memory_bytes, reset_peak_memory
from track_range.fleet.inputs.clip import Clip
from track_range.fleet.inputs.dry_run import check_clips
from track_range.fleet.inputs.fetch import fetched
from track_range.fleet.output import data_set
from track_range.fleet.output.record import ERROR_FIGURES, ClipRecord, utc_now
from track_range.fleet.settings import size_bytes
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import FolderListings, Location
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import printable
from track_range.foundation.processes import tuned_process
from track_range.foundation.schemas.keywords import flags_in_errors
from track_range.results.events.event import CLIPS_FOLDER
from track_range.results.events.files import EVENTS_PARQUET, write_events_parquet
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
                if self._record.content_hash == self._task.known_hash:
                    return ClipOutcome(self._record.row(), is_unchanged=True)
                self._process(local, Path(name), max(file.size for file in files.values()))
            return ClipOutcome(self._record.row())
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

    def _process(self, clip: Clip, folder: Path, n_bytes: int) -> None:
        """Run the clip with local files, the largest of `n_bytes`, and publish the results."""
        progress, plan, out, name = self._progress, self._plan, self._out, self._clip.name
        settings = clip_settings(plan.options, clip)
        names = set(settings.write if "write" in {**plan.options, **clip.settings} else ()) - {
            "parquet"
        }
        has_files = plan.settings.reports or bool(names) or settings.overlay or settings.disparity
        run_folder = folder / "run" if has_files else None
        settings = settings.model_copy(update={"out": run_folder, "write": tuple(names)})
        start_s = time.perf_counter()
        progress.phase = "opening"
        header = next(
            check_clips(
                [clip],
                fps=settings.fps,
                stereo_layout=settings.stereo_layout,
                threads=1,
            )
        )
        stated_s = header.duration_s or 0.0
        if settings.duration_s is not None:
            stated_s = min(stated_s, settings.duration_s)
        progress.video_s = max(0.0, min(stated_s, n_bytes / _MIN_BYTES_PER_S))
        with (
            Run(settings, opened_detectors=_DETECTORS) as run,
            tuned_process(has_dense_stereo=settings.sgbm),
        ):
            progress.phase = "processing"
            for _ in run:
                progress.frames += 1
        self._run_s = time.perf_counter() - start_s
        progress.phase = "publishing"
        table = run.session.rows.table.to_arrow(is_rounded=False)
        metadata = {
            **run.session.origin.provenance.metadata(),
            "track_range.settings_hash": plan.settings_hash,
            "track_range.content_hash": self._record.content_hash,
            "track_range.clip": name,
        }
        write_tracks(folder / data_set.TRACKS_FILE, table, metadata)
        write_events_parquet(folder / EVENTS_PARQUET, run.events, metadata)
        self._add_summary(run.summary, table.num_rows, run)
        try:
            data_set.publish(
                out, data_set.tracks_location(out, name), folder / data_set.TRACKS_FILE
            )
            data_set.publish(out, data_set.events_location(out, name), folder / EVENTS_PARQUET)
            if run_folder is not None:
                left_out = _NOT_PUBLISHED | (
                    set() if plan.settings.reports else {"report.html", "summary.json"}
                )
                for file in sorted(run_folder.iterdir()):
                    if file.is_file() and file.name not in left_out and file.name[0] != ".":
                        data_set.publish(
                            out, data_set.runs_location(out, name).child(file.name), file
                        )
                if settings.clips:
                    data_set.publish_event_videos(
                        out, name, sorted((run_folder / CLIPS_FOLDER).glob("*.mp4"))
                    )
            self._record = self._with_times(self._record)
            data_set.publish_record(out, self._record.row())
        except StorageError as error:
            raise _PublishingError(str(error)) from error

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
    shared = {
        key: value for key, value in options.items() if not (key == "focal_px" and "rig" in own)
    }
    return settings_from({**shared, **video, **own})


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
