"""Finding the sequences for `track` and `evaluate tracks`: single files or folders of boxes or
tracks.

FILE                        one sequence, named after the file
DIR/NAME.txt                layout of KITTI and RRC
DIR/NAME/det/det.txt        layout of MOTChallenge (gt/gt.txt for ground truth), with seqinfo.ini
DIR/labels/NAME_000000.txt  one sequence of YOLO labels
DIR/settings.yaml           one sequence: the tracks.csv or tracks.parquet of a run
runs/clip=NAME              one sequence: the tracks.parquet of a fleet's clip
"""

import configparser
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from track_range.detection.formats.label_formats import is_label_folder
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.limits import MAX_FRAME
from track_range.foundation.files.input_files import quoted, read_text, readable, real_path
from track_range.foundation.files.numeric_text import number
from track_range.results.folder import clip_rows, rows_file

_SUFFIXES = (".json", ".xml", ".csv")  # of files of sequences in a folder without text files
Kind = Literal["det", "gt"]  # detections or ground truth, as in MOTChallenge's file names
# folders for the results of `track`, one NAME.txt per sequence
MOT_FOLDER, KITTI_FOLDER = "mot", "kitti"


@dataclass(frozen=True, slots=True)
class SequenceInfo:
    """Contents of MOTChallenge's seqinfo.ini; None = not given, or no such file."""

    fps: float | None = None
    n_frames: int | None = None
    size_px: tuple[int, int] | None = None  # width and height of the images


@dataclass(frozen=True, slots=True)
class SequenceFile:
    """One sequence: its name, which its results share, its file of boxes or ground truth, and
    seqinfo.ini.
    """

    name: str
    path: Path
    info: SequenceInfo


def find_sequences(path: Path, kind: Kind) -> list[SequenceFile]:
    """All sequences of a file, a folder of files, a folder in MOTChallenge's layout or one sequence
    of it, by name.

    `kind` selects which of MOTChallenge's files are read. LabelFileError if there is no sequence,
    or two have the same name.
    """
    if os.path.isfile(path):
        return [_sequence(path)]
    if not os.path.isdir(path):
        raise LabelFileError(f"{path}: no such file or folder; check the name.")
    rows = _rows_of_run(path)
    if rows is not None or is_label_folder(path):
        return [SequenceFile(real_path(path).name, rows or path, SequenceInfo())]
    inner = Path(kind) / f"{kind}.txt"
    with readable(path, LabelFileError):
        folders = [path, *sorted(path.iterdir())]
    mot_files = [folder / inner for folder in folders if (folder / inner).is_file()]
    sequences = [
        _sequence(file) for file in mot_files or _text_files(path) or _text_files(path, _SUFFIXES)
    ]
    names = [sequence.name for sequence in sequences]
    if duplicate := next((name for name in names if names.count(name) > 1), None):
        raise LabelFileError(f"{path}: two sequences have the name {duplicate}; rename one.")
    if not sequences:
        raise LabelFileError(
            f"{path}: expected NAME.txt files, or folders NAME with {inner.as_posix()}, found none."
        )
    return sequences


def paired(
    truth: Sequence[SequenceFile], results: Sequence[SequenceFile]
) -> list[tuple[SequenceFile, SequenceFile]]:
    """Pairs of truth and results with equal names; one file of each is a pair even if their names
    differ.

    LabelFileError for truth without results, since ignoring such sequences would raise the score.
    """
    if len(truth) == len(results) == 1:
        return [(truth[0], results[0])]
    by_name = {sequence.name: sequence for sequence in results}
    missing = [sequence.name for sequence in truth if sequence.name not in by_name]
    if missing:
        raise LabelFileError(
            f"expected results for every sequence of the truth, found none for {listed(missing)}; "
            "for a sequence without tracks write an empty NAME.txt."
        )
    return [(sequence, by_name[sequence.name]) for sequence in truth]


def ignored_files_note(path: Path, sequences: Sequence[SequenceFile]) -> tuple[str, ...]:
    """Note about NAME.txt files that were ignored because the folder also has MOTChallenge's
    layout.
    """
    used = {sequence.path for sequence in sequences}
    is_plain = path.is_dir() and not _rows_of_run(path)
    ignored = [file.name for file in _text_files(path) if file not in used] if is_plain else []
    return (
        (f"{path}: MOTChallenge's layout is used; ignored files: {listed(ignored)}.",)
        if ignored
        else ()
    )


def no_truth_note(
    truth: Sequence[SequenceFile], results: Sequence[SequenceFile]
) -> tuple[str, ...]:
    """Note about results without ground truth."""
    names = {sequence.name for sequence in truth}
    extra = [sequence.name for sequence in results if sequence.name not in names]
    if not extra or len(truth) == len(results) == 1:
        return ()
    return (
        f"{len(extra)} of {len(results)} sequences have no ground truth and are not evaluated: "
        f"{listed(extra)}.",
    )


def listed(names: Sequence[str]) -> str:
    """The first five names, separated by commas; "and more" if there are more."""
    return f"{', '.join(names[:5])}{' and more' if len(names) > 5 else ''}"


def _rows_of_run(folder: Path) -> Path | None:
    """The file with the rows of a run, which has the classes that mot.txt lacks; None if this is
    not a run's folder.
    """
    path = clip_rows(folder)
    if path is None and not os.path.isfile(folder / "settings.yaml"):
        return None
    rows = rows_file(folder, is_rounded=True)
    if rows is not None and rows.suffix != ".arrows":
        return rows
    if path is not None or (os.path.isfile(folder / "summary.json") and not _text_files(folder)):
        expected = path or folder / "tracks.csv"
        raise LabelFileError(
            f"{folder}: expected the rows of the run in {expected}, found no such file."
        )
    return None


def _text_files(folder: Path, suffixes: Sequence[str] = (".txt",)) -> list[Path]:
    files = (file for suffix in suffixes for file in folder.glob(f"*{suffix}"))
    return sorted(file for file in files if file.is_file() and not file.name.startswith("."))


def _sequence(path: Path) -> SequenceFile:
    is_mot = path.stem in ("det", "gt") and path.parent.name == path.stem
    folder = path.parent.parent if is_mot else path.parent
    name = real_path(folder).name if is_mot else path.stem
    return SequenceFile(
        name, path, _read_info(folder / "seqinfo.ini") if is_mot else SequenceInfo()
    )


def _read_info(file: Path) -> SequenceInfo:
    if not os.path.lexists(file):
        return SequenceInfo()
    text = read_text(file, LabelFileError, "MOTChallenge's seqinfo.ini")
    parser = configparser.ConfigParser(interpolation=None)
    try:
        parser.read_string(text)
        section = parser["Sequence"]
    except (configparser.Error, KeyError, ValueError) as error:
        raise LabelFileError(
            f"{file}: expected a section [Sequence] as in MOTChallenge ({type(error).__name__})."
        ) from error
    fps, n_frames, width, height = (
        _value_of(section, key, limits, file) for key, limits in _INFO_LIMITS.items()
    )
    size_px = None if width is None or height is None else (int(width), int(height))
    return SequenceInfo(fps, None if n_frames is None else int(n_frames), size_px)


def _value_of(
    section: Mapping[str, str], key: str, limits: tuple[float, float], file: Path
) -> float | None:
    if key not in section:
        return None
    value, (low, high) = number(section[key]), limits
    if not low <= value <= high or (key != "frameRate" and value % 1):
        kind = "a number" if key == "frameRate" else "an integer"
        raise LabelFileError(
            f"{file}: expected {kind} from {low:g} to {high:.10g} as {key}, got "
            f"{quoted(section[key])}."
        )
    return value


_INFO_LIMITS = {  # smallest and largest value of each key of seqinfo.ini
    "frameRate": (0.001, 10_000.0),
    "seqLength": (1.0, float(MAX_FRAME)),
    "imWidth": (1.0, 65535.0),
    "imHeight": (1.0, 65535.0),
}
