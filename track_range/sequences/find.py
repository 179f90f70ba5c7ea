"""Finding the sequences for `track` and `evaluate tracks`: single files or folders of boxes or tracks.

FILE                        one sequence, named after the file
DIR/NAME.txt                layout of KITTI and RRC
DIR/NAME/det/det.txt        layout of MOTChallenge (gt/gt.txt for ground truth), with seqinfo.ini
"""

from __future__ import annotations

import configparser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from track_range.detection.formats.detection_files import MAX_FRAME
from track_range.detection.formats.kitti import LabelFileError

Kind = Literal["det", "gt"]
"""Detections or ground truth, as in MOTChallenge's file names."""

MOT_FOLDER, KITTI_FOLDER = "mot", "kitti"
"""Folders for the results of `track`, one NAME.txt per sequence."""


@dataclass(frozen=True, slots=True)
class SequenceInfo:
    """Contents of MOTChallenge's seqinfo.ini; None = not given, or no such file.

    Attributes:
        fps: frame rate.
        n_frames: number of frames.
        size_px: (width, height) of the images.
    """

    fps: float | None = None
    n_frames: int | None = None
    size_px: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class SequenceFile:
    """One sequence.

    Attributes:
        name: name of the sequence and of its results.
        path: file of boxes or ground truth.
        info: contents of seqinfo.ini.
    """

    name: str
    path: Path
    info: SequenceInfo


def find_sequences(path: Path, kind: Kind) -> list[SequenceFile]:
    """All sequences of a file or folder, sorted by name.

    Args:
        path: a file, a folder of files, a folder in MOTChallenge's layout, or one sequence of it.
        kind: which of MOTChallenge's files are read.

    Raises:
        LabelFileError: there is no sequence, or two have the same name.
    """
    if path.is_file():
        return [_sequence(path)]
    if not path.is_dir():
        raise LabelFileError(f"{path}: no such file or folder; check the name.")
    inner = Path(kind) / f"{kind}.txt"
    mot_files = [folder / inner for folder in (path, *sorted(path.iterdir())) if (folder / inner).is_file()]
    sequences = [_sequence(file) for file in mot_files or _text_files(path)]
    names = [sequence.name for sequence in sequences]
    if duplicate := next((name for name in names if names.count(name) > 1), None):
        raise LabelFileError(f"{path}: two sequences have the name {duplicate}; rename one.")
    if not sequences:
        raise LabelFileError(f"{path}: expected NAME.txt files, or folders NAME with {inner.as_posix()}, found none.")
    return sequences


def paired(truth: Sequence[SequenceFile], results: Sequence[SequenceFile]) -> list[tuple[SequenceFile, SequenceFile]]:
    """Pairs of truth and results with equal names; one file of each is a pair even if their names differ.

    Raises:
        LabelFileError: truth without results; ignoring such sequences would raise the score.
    """
    if len(truth) == len(results) == 1:
        return [(truth[0], results[0])]
    by_name = {sequence.name: sequence for sequence in results}
    missing = [sequence.name for sequence in truth if sequence.name not in by_name]
    if missing:
        raise LabelFileError(
            f"expected results for every sequence of the truth, found none for {listed(missing)}; for a sequence "
            "without tracks write an empty NAME.txt."
        )
    return [(sequence, by_name[sequence.name]) for sequence in truth]


def ignored_files_note(path: Path, sequences: Sequence[SequenceFile]) -> tuple[str, ...]:
    """Note about NAME.txt files that were ignored because the folder also has MOTChallenge's layout."""
    used = {sequence.path for sequence in sequences}
    ignored = [file.name for file in _text_files(path) if file not in used] if path.is_dir() else []
    return (f"{path}: read in MOTChallenge's layout; ignored: {listed(ignored)}.",) if ignored else ()


def no_truth_note(truth: Sequence[SequenceFile], results: Sequence[SequenceFile]) -> tuple[str, ...]:
    """Note about results without ground truth."""
    names = {sequence.name for sequence in truth}
    extra = [sequence.name for sequence in results if sequence.name not in names]
    if not extra or len(truth) == len(results) == 1:
        return ()
    return (f"{len(extra)} of {len(results)} sequences have no ground truth and are not evaluated: {listed(extra)}.",)


def listed(names: Sequence[str]) -> str:
    """The first five names, separated by commas; "and more" if there are more."""
    return f"{', '.join(names[:5])}{' and more' if len(names) > 5 else ''}"


def first_line(path: Path) -> str:
    """The first non-blank line of a file; an empty text if there is none.

    Raises:
        LabelFileError: the file is not text.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            return next((line for line in file if line.strip()), "")
    except (OSError, UnicodeDecodeError) as error:
        raise LabelFileError(f"{path}: expected a text file, got {type(error).__name__}; check the path.") from error


def _text_files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.glob("*.txt") if file.is_file() and not file.name.startswith("."))


def _sequence(path: Path) -> SequenceFile:
    is_mot = path.stem in ("det", "gt") and path.parent.name == path.stem
    folder = path.parent.parent if is_mot else path.parent
    name = folder.resolve().name if is_mot else path.stem
    return SequenceFile(name, path, _read_info(folder / "seqinfo.ini") if is_mot else SequenceInfo())


def _read_info(file: Path) -> SequenceInfo:
    """Contents of seqinfo.ini.

    Raises:
        LabelFileError: it cannot be parsed.
    """
    if not file.is_file():
        return SequenceInfo()
    parser = configparser.ConfigParser()
    try:
        parser.read_string(file.read_text(encoding="utf-8-sig"))
        section = parser["Sequence"]
        width, height = section.getint("imWidth"), section.getint("imHeight")
        info = SequenceInfo(section.getfloat("frameRate"), section.getint("seqLength"), _pair(width, height))
    except (OSError, UnicodeDecodeError, configparser.Error, KeyError, ValueError) as error:
        raise LabelFileError(
            f"{file}: expected a section [Sequence] with numbers as in MOTChallenge ({type(error).__name__})."
        ) from error
    if (info.fps is not None and not 0 < info.fps < 10_000) or (
        info.n_frames is not None and not 0 < info.n_frames <= MAX_FRAME
    ):
        raise LabelFileError(
            f"{file}: expected 0 < frameRate < 10000 and 0 < seqLength <= {MAX_FRAME}, got {info.fps} and "
            f"{info.n_frames}."
        )
    return info


def _pair(width: int | None, height: int | None) -> tuple[int, int] | None:
    return None if width is None or height is None else (width, height)
