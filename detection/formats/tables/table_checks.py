"""Checks of label files that apply to several formats: identities, frame numbers, names of images,
and notes.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.tables.box_table import BoxTable
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.limits import MAX_FRAME
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.files.input_files import counted, quoted, shortened
from track_range.foundation.files.numeric_text import number

_MOST_NAMED = 5  # labels in a note
_LAST_NUMBER = re.compile(r"(\d+)\D*$")
_MAX_DIGITS = 18  # of a number in a file name


def check_identities(table: BoxTable, path: Path) -> None:
    """LabelFileError if an identity occurs twice in a frame."""
    is_same = (
        (np.diff(table.frame) == 0) & (np.diff(table.track_id) == 0) & (table.track_id[1:] >= 0)
    )
    for row in np.flatnonzero(is_same)[:1].tolist():
        raise LabelFileError(
            f"{path}: expected each track id at most once per frame, got id {table.track_id[row]} "
            f"twice in frame {table.frame[row]}."
        )


def check_upright(rotation: object, where: str) -> None:
    """LabelFileError for a box with a rotation other than 0: neither the box before it nor the hull
    has the size of the object.
    """
    if rotation in (None, "") or number(str(rotation)) == 0:
        return
    raise LabelFileError(
        f"{where}: expected upright boxes, found the rotation {quoted(rotation)}; draw upright "
        "boxes or polygons."
    )


def check_one_video(names: Iterable[object], path: Path) -> None:
    """LabelFileError for boxes in the images of several videos or cameras."""
    videos = sorted({str(name) for name in names if name not in (None, "")})
    if len(videos) > 1:
        raise LabelFileError(
            f"{path}: expected the images of one video, found {len(videos)}: "
            f"{shortened(', '.join(videos), 80)}; split the file."
        )


# of images, and of files that are named after an image
_SUFFIXES = frozenset("jpg jpeg png bmp webp tif tiff pgm ppm json xml txt".split())


def image_stem(name: str) -> str:
    """The name of an image without folder, suffix, and Roboflow's appended `_jpg.rf.` with a
    hash.
    """
    stem = re.split(r"[/\\\\]", name)[-1]
    parts = re.sub(r"(_(jpe?g|png|bmp|webp))?\.rf\.\w+", "", stem).split(".")
    while len(parts) > 1 and parts[-1].lower() in _SUFFIXES:
        parts.pop()
    return ".".join(parts)


def frame_in_name(name: str) -> int | None:
    """The last number in a name without suffix, which is the frame number; None if there is none up
    to `MAX_FRAME`.
    """
    match = _LAST_NUMBER.search(name)
    if match is None or len(match[1]) > _MAX_DIGITS or int(match[1]) > MAX_FRAME:
        return None
    return int(match[1])


def frames_of_names(names: Sequence[str], path: Path) -> tuple[list[int], str]:
    """Frame number from each image name, and its source: the number that differs between names, or
    the order of times.

    LabelFileError unless the names differ only in one number, as the frames of one video do.
    """
    check_one_video((re.split(r"[^/\\]*$", name)[0] for name in names), path)
    stems = [image_stem(name) for name in names]
    fields = [re.findall(r"\d+", stem) for stem in stems]
    for name, texts in zip(names, fields, strict=True):
        if not texts or max(map(len, texts)) > _MAX_DIGITS + 1:
            raise LabelFileError(
                f"{path}: expected a frame number in the name of each image, found {quoted(name)}."
            )
    varying = [column for column in zip(*fields, strict=False) if len(set(column)) > 1]
    if len(varying) == 1 and len({re.sub(r"\d+", "#", stem) for stem in stems}) == 1:
        numbers = [int(text) for text in varying[0]]
    else:
        check_names(stems, path)
        numbers = [int(texts[-1]) for texts in fields]
    if max(numbers, default=0) <= MAX_FRAME:
        return numbers, "numbers"
    if min(numbers) <= MAX_FRAME:
        raise LabelFileError(
            f"{path}: expected frame numbers up to {MAX_FRAME} in names, found {max(numbers)}."
        )
    return np.unique(np.array(numbers, np.uint64), return_inverse=True)[1].reshape(
        -1
    ).tolist(), "order of the times"


def check_names(names: Iterable[str], path: Path) -> None:
    """LabelFileError unless names without suffix differ only in their last number, as the frames of
    one video.
    """
    first: tuple[str, str] | None = None
    for name in names:
        start = name[: match.start()] if (match := _LAST_NUMBER.search(name)) else name
        first = first or (start, name)
        if start != first[0]:
            raise LabelFileError(
                f"{path}: expected images of one video, with names that differ only in the frame "
                f"number, found {quoted(first[1])} and {quoted(name)}."
            )


def first_frame_number(
    frame: FloatArray | IntArray, usual: int, n_frames: int | None = None
) -> int:
    """Number of a video's first frame in a file, 0 or 1, from the file's (N,) frame numbers and the
    number of images.

    A file with a frame 0 starts at 0. A file whose last number is the number of images starts at 1.
    Else `usual` applies.
    """
    low, high = (float(frame.min()), float(frame.max())) if len(frame) else (usual, usual)
    return 0 if low == 0 else 1 if low > 0 and high == n_frames else usual


def is_unpadded(names: Iterable[str]) -> bool:
    """Whether the last numbers in names have no leading zeros, as in NAME_1."""
    digits = [match[1] for name in names if (match := _LAST_NUMBER.search(name))]
    is_plain = all(text == "0" or not text.startswith("0") for text in digits)
    return is_plain and (len(set(map(len, digits))) > 1 or any(len(text) == 1 for text in digits))


def first_frame_note(path: Path, first: int, n_frames: int) -> tuple[str, ...]:
    """A note if the frame numbers of a file start at 1, since the first frame of a video is 0."""
    if first != 1 or n_frames < 2:
        return ()
    return (
        f"{path.name}: frame numbers start at 1, but the first frame of the video is 0; if all "
        "boxes appear one frame late, convert the file with `track-range export --first-frame 1`.",
    )


def other_labels_note(table: BoxTable, path: Path) -> tuple[str, ...]:
    """A note that names the labels of boxes that are not road classes, such as renamed labels."""
    is_other = (table.class_id < 0) & ~table.is_region & (table.class_name != "")
    return other_classes_note(path, table.class_name[is_other])


def other_classes_note(path: Path, names: npt.NDArray[np.str_]) -> tuple[str, ...]:
    """A note that names the classes of (N,) boxes that are not road classes; none if N = 0."""
    if not len(names):
        return ()
    return (
        f"{path.name}: ignored boxes whose labels are not road classes: "
        f"{names_with_counts(names)}; the classes are {', '.join(ROAD_CLASSES)}.",
    )


def names_with_counts(names: npt.NDArray[np.str_]) -> str:
    """The first five different names in words, each with its number; "" for empty names only."""
    kinds, counts = np.unique(names[names != ""], return_counts=True)
    most = [
        f"{shortened(str(name), 30)} ({n})"
        for name, n in zip(kinds[:_MOST_NAMED], counts, strict=False)
    ]
    more = f" and {len(kinds) - _MOST_NAMED} more" if len(kinds) > _MOST_NAMED else ""
    return f"{', '.join(most)}{more}"


def ignored_note(path: Path, n_ignored: int, reason: str) -> tuple[str, ...]:
    """A note on the number of boxes that were ignored for a reason, such as "without width or
    height".
    """
    return (
        (f"{path.name}: ignored {counted(n_ignored, 'box', 'boxes')} {reason}.",)
        if n_ignored
        else ()
    )


def omitted_regions_note(table: BoxTable) -> tuple[str, ...]:
    """A note on the regions of a table that is written in a format without regions."""
    n_regions = int(table.is_region.sum())
    return (
        (
            "Regions that are not evaluated are not written, because this format has none: "
            f"{n_regions}.",
        )
        if n_regions
        else ()
    )
