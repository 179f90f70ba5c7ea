"""LabelFormat: one format of label files; `LABEL_FORMATS` has all."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from track_range.detection.formats.tables.box_table import BoxTable, VideoFacts, Written
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.files.input_files import open_regular, readable

PARQUET_MARK = "PAR1"  # first bytes of a Parquet file
START_BYTES = 65_536  # read to recognise a file
# in which tools put one file for each image
_FOLDERS = ("", "ann", "Annotations", "annotations", "labels")


@dataclass(frozen=True)
class LabelStart:
    """What formats are recognised by: a file's first line and first 64 kB, never its name."""

    path: Path
    first: str  # first line that is not blank; "" = a folder, `PARQUET_MARK` = Parquet
    is_folder: bool

    @cached_property
    def text(self) -> str:
        """The first 64 kB of a file, or of the first file in a folder with one JSON or XML file for
        each image; "" if there is none, or for Parquet.
        """
        files = label_files(self.path) if self.is_folder else [self.path]
        if not files or self.first == PARQUET_MARK:
            return ""
        with (
            open_regular(files[0], LabelFileError, "labels") as file,
            readable(files[0], LabelFileError),
        ):
            return file.read(START_BYTES).decode("utf-8-sig", errors="replace")


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelFormat:
    """One format of label files, with its name on the command line and its title in messages."""

    name: str
    title: str
    # whether a file has the format; formats of higher priority are asked first
    recognises: Callable[[LabelStart], bool]
    # facts about the video fill in what the file does not state
    read: Callable[[Path, VideoFacts], BoxTable]
    # writes a table to a path; None = not written
    write: Callable[[BoxTable, Path], Written] | None = None
    # 0 = `recognises` asks for a mark that no other format has, see `foundation.registry.Registry`
    priority: int = 0
    has_classes: bool = True  # whether a box has a class
    # whether detections and ground truth are read with `read`, without rules of a benchmark, which
    # only our own formats have
    is_general: bool = True
    is_folder: bool = False  # whether it is a folder with one file per frame
    is_of_run: bool = False  # whether it has the rows of a run, and so no ground truth
    # largest difference of an edge read again; None = depends on the image size
    precision_px: float | None = None


def label_files(folder: Path) -> list[Path]:
    """The JSON or XML files of a folder, or of its subfolder for annotations, sorted by name."""
    for name in _FOLDERS:
        with readable(folder, LabelFileError):
            inside = folder / name
            entries = sorted(inside.iterdir()) if inside.is_dir() else []
        files = [
            file
            for file in entries
            if file.suffix in (".json", ".xml") and file.name != "meta.json"
        ]
        if files:
            return files
    return []
