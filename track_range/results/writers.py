"""Result writers: one class per format, chosen by name (`--write csv,mot`).

A writer is a class that implements `ResultWriter`, registered by a line in `WRITERS`, by an entry
point of the group `track_range.result_writers` in another package, or by a call of
`register_writer`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Any, Protocol, Self

from track_range.foundation.errors import UserError, call_all
from track_range.foundation.files.atomic_files import describe
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.registry import Registry, imported
from track_range.results.formats.run_info import RunInfo

if TYPE_CHECKING:
    from track_range.pipeline.frame_result import FrameResult

DEFAULT_WRITERS = ("csv", "mot", "parquet", "poses")  # writers of a run without `--write`

FILES_OF_WRITERS: Mapping[str, str] = {  # of this package, for help texts
    "csv": "tracks.csv",
    "mot": "mot.txt",
    "parquet": "tracks.parquet",
    "poses": "poses.csv, the path of the camera",
    "kitti": "kitti.txt",
    "recorded": "recorded_boxes.csv, in pixels of the video",
    "mcap": "run.mcap, for Foxglove and ROS 2",
    "rrd": "run.rrd, for Rerun",
    "openscenario": "run.xosc and run.xodr, trajectories and their road for simulators",
    "depth": "depth.tar, depth of all pixels as 16-bit PNGs",
    "osi": "run_sd.osi, ASAM OSI SensorData",
    "osi-gt": "run_gt.osi, ASAM OSI GroundTruth, for simulators",
    "osi-mcap": "run_osi.mcap, ASAM OSI in MCAP",
    "mf4": "run.mf4, ASAM MDF4 for CANape, MATLAB and asammdf",
    "openlabel": "run.openlabel.json, ASAM OpenLABEL 1.0",
}

_RUN_FILES = (  # besides those of its writers
    *(
        "summary.json",
        "settings.yaml",
        "progress.json",
        "overlay.mp4",
        "disparity.mp4",
        "report.html",
    ),
    *("events.csv", "events.parquet", "telemetry.csv", "evaluation.json"),
    *("crossings.csv", "crossings.parquet"),
)


class WriterError(UserError):
    """There is no such writer, or it cannot be used."""


class ResultWriter(Protocol):
    """Writer of one format; created without arguments, used for one run.

    `files` are names, without folder, of the files that it writes to the output folder; they must
    differ from the files of the run and of its other writers. The next run into the folder removes
    them. `open` is called once, `write` for each frame, `close` once. An OSError is reported with
    the names of the files. Files should be readable after the program is killed: flush after each
    frame if the format allows it. If `write` raises, the files should be as before;
    `track_range.results.formats.row_file.RowFile` does both for text. Optional members:

    - `discard_last()` removes the last frame from the files. It is called if a later writer of the run, or the run
      itself, fails in the same frame, so that all files of a run end with the same frame.
    - `check_requirements()` raises a UserError, before the run begins, if the writer cannot be used, for example
      because a package is missing.
    - `needs_images`: whether it needs more than the rows of a run, so that `export` cannot write
    its files.
    - `temporary_files` are names of files that exist only while the run is in progress, and remain if it is killed.
    """

    files: tuple[str, ...]

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the files in the existing output folder."""

    def write(self, result: FrameResult) -> None:
        """Add one frame."""

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Finish the files; `summary` is the content of summary.json, None if the run ended before
        it.
        """


# function without arguments that returns a writer, usually its class
WriterFactory = Callable[[], ResultWriter]

WRITERS: Registry[WriterFactory | str] = Registry(  # imported on first use
    "track_range.result_writers",
    {
        "csv": "track_range.results.formats.csv_file:CsvWriter",
        "mot": "track_range.results.formats.box_files:MotWriter",
        "parquet": "track_range.results.formats.parquet_file:ParquetWriter",
        "poses": "track_range.results.formats.poses_file:PosesWriter",
        "kitti": "track_range.results.formats.box_files:KittiWriter",
        "recorded": "track_range.results.formats.box_files:RecordedBoxesWriter",
        "mcap": "track_range.results.formats.mcap.writer:McapWriter",
        "rrd": "track_range.results.formats.rerun_file:RerunWriter",
        "openscenario": "track_range.results.formats.adas.openscenario_file:OpenScenarioWriter",
        "depth": "track_range.results.formats.depth_file:DepthWriter",
        "osi": "track_range.results.formats.adas.osi_file:OsiWriter",
        "osi-gt": "track_range.results.formats.adas.osi_file:OsiGroundTruthWriter",
        "osi-mcap": "track_range.results.formats.adas.osi_file:OsiMcapWriter",
        "mf4": "track_range.results.formats.adas.mdf_file:MdfWriter",
        "openlabel": "track_range.results.formats.adas.openlabel_file:OpenLabelWriter",
    },
)


def register_writer(name: str, factory: WriterFactory | str) -> None:
    """Register a writer for this process; WriterError if the name is in use.

    `name`: name for `--write`. `factory`: class of the writer, or "package.module:Class", which is
    imported on first use.
    """
    if name in WRITERS.names:
        raise WriterError(
            f"the name '{name}' is already used by another writer; choose another name."
        )
    WRITERS.registered[name] = factory


def create_writer(name: str) -> ResultWriter:
    """New writer; WriterError if there is no writer of that name, or it cannot be imported or lacks
    a part.
    """
    factory = WRITERS.find(name)
    if factory is None:
        raise WriterError(f"unknown format '{name}': expected {', '.join(WRITERS.names)}.")
    try:
        writer = imported(factory)()
    # other packages may raise anything; runs without this writer are not affected
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
        origin = WRITERS.origin(name) or factory
        raise WriterError(f"the writer '{name}' ({origin}) cannot be used: {reason}.") from error
    problem = _problem(writer)
    if problem:
        raise WriterError(f"the writer '{name}': expected {problem}.")
    return writer


def _problem(writer: Any) -> str:
    """The part that an object lacks to be a `ResultWriter` with files in the folder, not of the
    run; "" = none.
    """
    for method in ("open", "write", "close"):
        if not callable(getattr(writer, method, None)):
            return f"a method {method}, found none"
    for attribute, default in (("files", None), ("temporary_files", ())):
        files = getattr(writer, attribute, default)
        if not isinstance(files, tuple | list) or not all(isinstance(file, str) for file in files):
            return f"`{attribute}`, a tuple of file names, got {files!r}"
    files = _all_files(writer)
    for file in files:
        # PureWindowsPath recognises drives and the separators of all systems
        if file in ("", ".", "..") or PureWindowsPath(file).name != file or not file.isprintable():
            return f"file names without a folder, got {file!r}"
        if file.casefold() in _RUN_FILES:
            return f"file names that the run does not already use, got {file}"
    return (
        f"each file once, got {', '.join(files)}"
        if len(set(map(str.casefold, files))) < len(files)
        else ""
    )


def _all_files(writer: ResultWriter) -> tuple[str, ...]:
    return (*writer.files, *getattr(writer, "temporary_files", ()))


def create_writers(names: Sequence[str]) -> tuple[ResultWriter, ...]:
    """New writers for a run, in the given order; duplicate names are ignored.

    WriterError if a writer cannot be created, or two writers write the same file; ExtraError if a
    package that a writer requires is not installed.
    """
    writers = {name: create_writer(name) for name in dict.fromkeys(names)}
    for writer in writers.values():
        getattr(writer, "check_requirements", lambda: None)()
    names_by_file: dict[str, str] = {}
    for name, writer in writers.items():
        for file in _all_files(writer):
            if (other := names_by_file.setdefault(file.casefold(), name)) != name:
                raise WriterError(
                    f"the writers '{other}' and '{name}' both write {file}; choose one of them."
                )
    return tuple(writers.values())


def result_names() -> tuple[str, ...]:
    """Names of all files that a run may write to its folder, with any of the writers that can be
    used.
    """
    names: list[str] = []
    for name in WRITERS.names:
        with suppress(WriterError):
            names += _all_files(create_writer(name))
    return (*names, *_RUN_FILES)


class OpenWriters:
    """Writers of a run in progress, by name; a context manager that closes the writers that `close`
    did not close.

    WriterError: a writer cannot be used, or two writers write the same file. OutputError: a file
    cannot be created; also raised by `write` and `close`, with the name of the file.
    """

    def __init__(self, names: Sequence[str], info: RunInfo, folder: Path) -> None:
        self._folder = folder
        self._open: list[ResultWriter] = []
        self._failed: ResultWriter | None = None
        writers = create_writers(names)
        self.files = tuple(file for writer in writers for file in writer.files)
        try:
            for writer in writers:
                with self._errors_of(writer, "cannot be created"):
                    writer.open(info, folder)
                self._open.append(writer)
        except BaseException:
            self.close(None)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close(None)

    def write(self, result: FrameResult) -> None:
        """Add one frame to all files; if one file fails, the other files are cut back to the frame
        before.
        """
        for number, writer in enumerate(self._open):
            try:
                with self._errors_of(writer):
                    writer.write(result)
            except BaseException:
                self.discard_last(number)
                raise

    def discard_last(self, n_writers: int | None = None) -> None:
        """Remove the last frame from all files that can be cut back, or from the files of the first
        `n_writers`.
        """
        for writer in self._open[:n_writers]:
            with suppress(OSError):  # the error that made this necessary is the one to report
                getattr(writer, "discard_last", lambda: None)()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Finish all files; a second call does nothing. A writer whose `write` has failed is not
        reported again.
        """

        def close_next() -> None:
            # after an unexpected error, a second call closes those that are left
            writer = self._open.pop(0)
            with (
                suppress(OutputError) if writer is self._failed else nullcontext(),
                self._errors_of(writer),
            ):
                writer.close(summary)

        call_all([close_next] * len(self._open))

    @contextmanager
    def _errors_of(self, writer: ResultWriter, problem: str = "writing failed") -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._failed = writer
            names = ", ".join(_all_files(writer))
            raise OutputError(f"{self._folder / names}: {problem} ({describe(error)}).") from error
