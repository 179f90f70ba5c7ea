"""Writers of results: one class per format, chosen by name (`--write csv,mot`).

A writer is one file with a class as `ResultWriter` describes it and one registration: a line in `_registered`,
an entry point of the group `track_range.result_writers` in another package, or a call of `register_writer`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path, PureWindowsPath
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self

from track_range.foundation.atomic_files import describe
from track_range.foundation.errors import UserError
from track_range.results.output_files import OutputError

if TYPE_CHECKING:
    from track_range.run.frame_result import FrameResult
    from track_range.stereo.geometry.camera import PinholeCamera
    from track_range.stereo.geometry.rig import StereoRig

ENTRY_POINT_GROUP = "track_range.result_writers"

DEFAULT_WRITERS = ("csv", "mot")

_RUN_FILES = ("summary.json", "settings.yaml", "overlay.mp4", "disparity.mp4", "report.html")
"""Files that a run itself writes."""


class WriterError(UserError):
    """No such writer, a class that is none, or files that cannot be a writer's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunInfo:
    """What is known of a run before its first frame.

    Attributes:
        camera: the left camera, rectified (one camera: undistorted).
        rig: the rectified pair; None = one camera, or an uncalibrated pair.
        fps: nominal frames per second.
        settings: the section `run` of settings.yaml.
    """

    camera: PinholeCamera
    rig: StereoRig | None
    fps: float
    settings: Mapping[str, Any]


class ResultWriter(Protocol):
    """One format of results; made without arguments, used for one run.

    The calls are one `open`, a `write` per frame, one `close`. An OSError becomes a sentence that names the file. What
    has been written when the program is killed should be readable: flush after each frame where the format allows it.

    Attributes:
        files: plain names of the files and folders that it writes in the folder of the results; no other writer of the
            run and not the run itself may write one of them. The next run into the folder removes these files.
    """

    files: tuple[str, ...]

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the files in the folder of the results, which exists."""
        ...

    def write(self, result: FrameResult) -> None:
        """Add one frame."""
        ...

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Finish the files; `summary` is what summary.json holds, None where the run ended before that."""
        ...


WriterFactory = Callable[[], ResultWriter]
"""Makes a writer; a class."""

_registered: dict[str, WriterFactory | str] = {
    "csv": "track_range.results.csv_file:CsvWriter",
    "mot": "track_range.results.mot_file:MotWriter",
}
"""Writers by name; a string "package.module:Class" is imported when it is used."""


def register_writer(name: str, factory: WriterFactory | str) -> None:
    """Add a writer, for this process.

    Args:
        name: for `--write`.
        factory: the class, or "package.module:Class", which is imported when it is used.

    Raises:
        WriterError: another writer has this name.
    """
    if name in writer_names():
        raise WriterError(f"the name of the writer '{name}' is in use.")
    _registered[name] = factory


@contextmanager
def registered_writer(name: str, factory: WriterFactory | str) -> Iterator[None]:
    """A writer that is registered inside of the with-block only.

    Raises:
        WriterError: as `register_writer`.
    """
    register_writer(name, factory)
    try:
        yield
    finally:
        del _registered[name]


def writer_names() -> tuple[str, ...]:
    """Names that `--write` accepts: registered writers first, then those of entry points."""
    return tuple(dict.fromkeys([*_registered, *sorted(point.name for point in entry_points(group=ENTRY_POINT_GROUP))]))


def create_writer(name: str) -> ResultWriter:
    """A new writer.

    Raises:
        WriterError: there is none of that name, it cannot be imported, or it is no `ResultWriter`.
    """
    points = [point.value for point in entry_points(group=ENTRY_POINT_GROUP) if point.name == name]
    factory = _registered.get(name, points[0] if points else None)
    if factory is None:
        raise WriterError(f"unknown format '{name}': expected {', '.join(writer_names())}.")
    try:
        writer = (_imported(factory) if isinstance(factory, str) else factory)()
    except Exception as error:  # whatever another package's module raises: runs without this writer go on
        reason = f"{type(error).__name__}: {error}"
        raise WriterError(f"the writer '{name}' ({factory}) cannot be used: {reason}.") from error
    _check_writer(name, writer)
    return writer


def create_writers(names: Sequence[str]) -> tuple[ResultWriter, ...]:
    """New writers of one run, in this order; a name that is given twice counts once.

    Raises:
        WriterError: as `create_writer`, or two of them write one file.
    """
    writers = {name: create_writer(name) for name in dict.fromkeys(names)}
    writer_of: dict[str, str] = {}
    for name, writer in writers.items():
        for file in writer.files:
            if (other := writer_of.setdefault(file.casefold(), name)) != name:
                raise WriterError(f"the writers '{other}' and '{name}' both write {file}: choose one of them.")
    return tuple(writers.values())


def result_names() -> tuple[str, ...]:
    """Names of all files that a run may leave in its folder, whatever writers it uses.

    Writers that cannot be used are left out: they are errors of the runs that choose them.
    """
    names: list[str] = []
    for name in writer_names():
        with suppress(WriterError):
            names += create_writer(name).files
    return (*names, *_RUN_FILES)


def _imported(path: str) -> WriterFactory:
    module, _, attribute = path.partition(":")
    factory: WriterFactory = getattr(import_module(module), attribute)
    return factory


def _check_writer(name: str, writer: Any) -> None:
    """Refuse an object that is no `ResultWriter`, and files outside of the folder or of the run itself.

    Raises:
        WriterError: it cannot be used.
    """
    for method in ("open", "write", "close"):
        if not callable(getattr(writer, method, None)):
            raise WriterError(f"the writer '{name}': expected a method {method}, found none.")
    files = getattr(writer, "files", None)
    if not isinstance(files, tuple | list) or not all(isinstance(file, str) for file in files):
        raise WriterError(f"the writer '{name}': expected `files`, a tuple of file names, got {files!r}.")
    for file in files:
        # PureWindowsPath knows the separators of all systems, and drives
        if file in ("", ".", "..") or PureWindowsPath(file).name != file or not file.isprintable():
            raise WriterError(f"the writer '{name}': expected plain file names without a folder, got {file!r}.")
        if file.casefold() in _RUN_FILES:
            raise WriterError(f"the writer '{name}': expected files of its own, but the run itself writes {file}.")
    if len({file.casefold() for file in files}) < len(files):
        raise WriterError(f"the writer '{name}': expected each file once, got {', '.join(files)}.")


class OpenWriters:
    """The writers of a run in progress; a context manager that closes those that `close` did not.

    Args:
        names: of writers; one that is given twice counts once.
        info: of the run.
        folder: of the results.

    Raises:
        WriterError: there is no writer of a name, it cannot be used, or two of them write one file.
        OutputError: a file cannot be created.
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

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close(None)

    def write(self, result: FrameResult) -> None:
        """Add one frame to all files.

        Raises:
            OutputError: a file cannot be written, the disk is full, say; the message names the file.
        """
        for writer in self._open:
            with self._errors_of(writer, "writing failed"):
                writer.write(result)

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Finish all files; a second call does nothing.

        Raises:
            OutputError: a file cannot be finished, unless `write` has raised for this one already.
        """
        failures: list[OutputError] = []
        while self._open:
            writer = self._open.pop(0)
            has_failed = writer is self._failed
            try:
                with self._errors_of(writer, "writing failed"):
                    writer.close(summary)
            except OutputError as error:
                failures += [] if has_failed else [error]
        if failures:
            raise failures[0]

    @contextmanager
    def _errors_of(self, writer: ResultWriter, what: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._failed = writer
            files = ", ".join(str(self._folder / file) for file in writer.files)
            raise OutputError(f"{files}: {what} ({describe(error)}).") from error
