"""Sequences for `track` and `evaluate tracks`: files of boxes or tracks, one by one or a folder of them.

FILE                        one sequence, named after the file
DIR/NAME.txt                KITTI's and RRC's way
DIR/NAME/det/det.txt        MOTChallenge's way (gt/gt.txt for truth), with seqinfo.ini
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

MOT_FOLDER, KITTI_FOLDER = "mot", "kitti"
"""Where `track` writes its results, a NAME.txt per sequence."""


@dataclass(frozen=True, slots=True)
class SequenceInfo:
    """Contents of MOTChallenge's seqinfo.ini; None = not given, or there is no such file.

    Attributes:
        fps: frames per second.
        n_frames: length.
        size_px: (width, height) of the images.
    """

    fps: float | None = None
    n_frames: int | None = None
    size_px: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class SequenceFile:
    """One sequence.

    Attributes:
        name: of its results.
        path: file of boxes or ground truth.
        info: of seqinfo.ini.
    """

    name: str
    path: Path
    info: SequenceInfo


def find_sequences(place: Path, kind: Kind) -> list[SequenceFile]:
    """All sequences of a file or folder, by name.

    Args:
        place: a file, a folder of files, a folder of MOTChallenge's folders, or one of those.
        kind: "det" or "gt", which of MOTChallenge's files.

    Raises:
        LabelFileError: there is none.
    """
    if place.is_file():
        return [_sequence(place)]
    if not place.is_dir():
        raise LabelFileError(f"{place}: no such file or folder.")
    inner = Path(kind) / f"{kind}.txt"
    folders = [folder / inner for folder in (place, *sorted(place.iterdir())) if (folder / inner).is_file()]
    found = [_sequence(path) for path in folders or _text_files(place)]
    names = [each.name for each in found]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise LabelFileError(f"{place}: two sequences are called {twice}: their results would be one file.")
    if not found:
        expected = f"NAME.txt files, or folders NAME with {inner.as_posix()}"
        raise LabelFileError(f"{place}: no sequences: expected {expected}.")
    return found


def paired(truth: Sequence[SequenceFile], results: Sequence[SequenceFile]) -> list[tuple[SequenceFile, SequenceFile]]:
    """Truth and results of equal names; a single file of each is a pair whatever its name.

    Raises:
        LabelFileError: truth without results, since leaving out sequences would raise the score.
    """
    if len(truth) == len(results) == 1:
        return [(truth[0], results[0])]
    by_name = {each.name: each for each in results}
    missing = [each.name for each in truth if each.name not in by_name]
    if missing:
        raise LabelFileError(f"no results for {listed(missing)}; an empty file NAME.txt means that nothing was found.")
    return [(each, by_name[each.name]) for each in truth]


def ignored_files_note(place: Path, found: Sequence[SequenceFile]) -> tuple[str, ...]:
    """A note on a folder's NAME.txt files that are none of its sequences, since MOTChallenge's folders go first."""
    taken = {each.path for each in found}
    left = [file.name for file in _text_files(place) if file not in taken] if place.is_dir() else []
    return (f"{place}: read as MOTChallenge's folders; ignored: {listed(left)}.",) if left else ()


def no_truth_note(truth: Sequence[SequenceFile], results: Sequence[SequenceFile]) -> tuple[str, ...]:
    """A note on results that have no truth."""
    names = {each.name for each in truth}
    extra = [each.name for each in results if each.name not in names]
    if not extra or len(truth) == len(results) == 1:
        return ()
    return (f"{len(extra)} of {len(results)} sequences of results have no truth and do not count: {listed(extra)}.",)


def listed(names: Sequence[str]) -> str:
    """The first five, and whether there are more."""
    return f"{', '.join(names[:5])}{' and more' if len(names) > 5 else ''}"


def first_line(path: Path) -> str:
    """The first line with anything in it; empty where there is none.

    Raises:
        LabelFileError: the file is no text.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            return next((line for line in file if line.strip()), "")
    except (OSError, UnicodeDecodeError) as error:
        raise LabelFileError(f"{path}: cannot be read as text ({type(error).__name__}).") from error


def _text_files(place: Path) -> list[Path]:
    return sorted(file for file in place.glob("*.txt") if file.is_file() and not file.name.startswith("."))


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
        raise LabelFileError(f"{file}: not MOTChallenge's [Sequence] with numbers ({type(error).__name__}).") from error
    if (info.fps is not None and not 0 < info.fps < 10_000) or (
        info.n_frames is not None and not 0 < info.n_frames <= MAX_FRAME
    ):
        raise LabelFileError(f"{file}: frameRate and seqLength must be positive, and no more than {MAX_FRAME} frames.")
    return info


def _pair(width: int | None, height: int | None) -> tuple[int, int] | None:
    return None if width is None or height is None else (width, height)
