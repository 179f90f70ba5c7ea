"""Reader of the labels of annotation tools, as one file or one file for each image.

Frames are given by number, or by the last number in the name of the image.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import numpy as np

from track_range.detection.boxes import HALF_PIXEL_PX
from track_range.detection.classes import COCO_CLASSES
from track_range.detection.formats.tables import table_checks
from track_range.detection.formats.tables.box_table import BoxTable, VideoFacts
from track_range.detection.formats.tables.class_names import names_for_folder
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.label_format import (
    LabelFormat,
    LabelStart,
    label_files,
)
from track_range.detection.formats.tables.limits import (
    MAX_COORDINATE_PX,
    MAX_FRAME,
    MAX_ID,
    MAX_SIDE_PX,
)
from track_range.detection.formats.tool_labels.annotation_tools import TOOLS
from track_range.detection.formats.tool_labels.content import content_of
from track_range.detection.formats.tool_labels.tool import MAX_BOXES, Tool, ToolBox
from track_range.foundation.arrays import BoolArray
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.numeric_text import number, numbers, plain_number

_MAX_FILES = 200_000  # of a folder with one for each image
# what access to values of unknown types raises
_OTHER_CONTENT = (
    ArithmeticError,
    AttributeError,
    LookupError,
    TypeError,
    ValueError,
    StopIteration,
    RuntimeError,
)


def read_tool(path: Path, tool: Tool, video: VideoFacts) -> BoxTable:
    """The boxes in a file, or in a folder with one file for each image.

    LabelFileError: a file cannot be read, is invalid or is too large.
    """
    is_folder = path.is_dir()
    files = label_files(path) if is_folder else [path]
    if len(files) > _MAX_FILES:
        raise LabelFileError(f"{path}: expected at most {_MAX_FILES} files, found {len(files)}.")
    every_box = (box for file in files for box in _boxes_in(file, tool, path, is_folder=is_folder))
    boxes = list(islice(every_box, MAX_BOXES + 1))
    table_checks.check_one_video((box.video for box in boxes), path)
    images = dict.fromkeys(box.image for box in boxes)
    if is_folder and all(isinstance(image, str) for image in images):
        images = dict.fromkeys(file.name for file in files)  # also those without boxes
    sizes = {size for box in boxes if (size := _size_px(box.size_px)) is not None}
    facts = VideoFacts(size_px=next(iter(sizes)) if len(sizes) == 1 else None)
    return table_of_boxes(path, boxes, list(images), video, facts)


def table_of_boxes(
    path: Path,
    boxes: Sequence[ToolBox],
    images: Sequence[int | str],
    video: VideoFacts,
    stated: VideoFacts,
) -> BoxTable:
    """The boxes of a file in the given images; `stated` are the facts in the file. LabelFileError:
    too many, or invalid values.
    """
    if len(boxes) > MAX_BOXES:
        raise LabelFileError(f"{path}: expected at most {MAX_BOXES} boxes, found more.")
    frame_of, notes = _frames(path, images, video)
    edges = np.array([box.edges for box in boxes], np.float64).reshape(-1, 4)
    if not (np.abs(edges) <= MAX_COORDINATE_PX).all():
        raise LabelFileError(
            f"{path}: expected box coordinates of at most {MAX_COORDINATE_PX:g} pixels, found "
            "larger or invalid values."
        )
    is_box = np.asarray((edges[:, 2:] > edges[:, :2]).all(axis=1))
    kept = [boxes[row] for row in np.flatnonzero(is_box).tolist()]
    labels, label_notes = _labels([box.label for box in kept], path, video)
    table = BoxTable.of(
        [frame_of[box.image] for box in kept],
        _identities([box.identity for box in kept]),
        labels,
        edges[is_box] - HALF_PIXEL_PX,
        is_region=np.array([box.is_region for box in kept], np.bool_),
        score=[_number(box.score) for box in kept],
        observed=np.array([not box.is_predicted for box in kept], np.bool_),
        distance_m=[_number(box.distance_m) for box in kept],
        sigma_m=[_number(box.sigma_m) for box in kept],
        video=video.completed_by(stated, path),
        notes=(*notes, *label_notes, *_empty_note(boxes, is_box, path)),
    )
    table_checks.check_identities(table, path)
    return table


def _empty_note(boxes: Sequence[ToolBox], is_box: BoolArray, path: Path) -> tuple[str, ...]:
    """A note on the shapes that are no boxes."""
    shapes = [boxes[row].shape for row in np.flatnonzero(~is_box).tolist()]
    kinds = table_checks.names_with_counts(np.array(shapes, np.str_))
    return (f"{path.name}: ignored shapes without width and height: {kinds}.",) if kinds else ()


def _boxes_in(file: Path, tool: Tool, path: Path, *, is_folder: bool) -> Iterator[ToolBox]:
    """The boxes of a file of labels at `path`, each with an image; raises LabelFileError."""
    with understood(file, tool.title):
        for item in tool.objects(content_of(file, tool.title)):
            box = tool.box(item)
            table_checks.check_upright(box.rotation, str(file))
            # a file has the name of its image; tools may repeat a wrong name in the file
            is_of_file = box.image == "" or (is_folder and isinstance(box.image, str))
            yield box._replace(image=file.name) if is_of_file else box


@contextmanager
def understood(file: Path, title: str) -> Iterator[None]:
    """Context that reads the labels of `title`; its errors are LabelFileErrors that name the file."""
    try:
        yield
    except LabelFileError as error:
        text = str(error).removesuffix(".")
        raise LabelFileError(f"{text}." if str(file) in text else f"{file}: {text}.") from error
    except _OTHER_CONTENT as error:
        raise LabelFileError(
            f"{file}: expected labels of {title}, found other content ({quoted(error)})."
        ) from error


def _labels(
    labels: Sequence[str], path: Path, video: VideoFacts
) -> tuple[Sequence[str], tuple[str, ...]]:
    """Names of the classes, and a note if a file has their numbers only, without a list."""
    if not labels or not np.isfinite(numbers(set(labels))).all():
        return labels, ()
    names = video.names or names_for_folder(path if path.is_dir() else path.parent)
    name_of = dict(enumerate(names or COCO_CLASSES))
    named = [name_of.get(int(float(label)), label) for label in labels]
    note = (
        f"{path.name}: classes are numbers without names, which are read as COCO's, 0 person to 7 "
        "truck; --names or a classes.txt beside the file gives others."
    )
    return named, () if names else (note,)


def _frames(
    path: Path, images: Sequence[int | str], video: VideoFacts
) -> tuple[dict[int | str, int], list[str]]:
    """Frame number by number or name of the images, and notes."""
    is_named = any(isinstance(image, str) for image in images)
    if is_named:
        numbers, source = table_checks.frames_of_names([str(image) for image in images], path)
    else:
        numbers, source = [int(image) for image in images], "frame numbers"
    for value in numbers:
        if not 0 <= value <= MAX_FRAME:
            raise LabelFileError(
                f"{path}: expected a frame number from 0 to {MAX_FRAME}, found {quoted(value)}."
            )
    if len(set(numbers)) < len(numbers):
        raise LabelFileError(
            f"{path}: expected each frame once, found two images with the same "
            "number in their names."
        )
    frames = np.array(numbers, np.int64)
    first = 0 if video.first_frame else table_checks.first_frame_number(frames, 0, video.n_frames)
    notes = (
        [
            f"{path.name}: frame numbers start at 1, since the last frame number is the number of "
            "images."
        ]
        if first
        else []
    )
    if is_named and not first:
        span = f"{frames.min()} to {frames.max()}"
        notes.append(
            f"{path.name}: frame numbers are the {source} in the names of the images, {span}."
        )
        notes += table_checks.first_frame_note(path, int(frames.min()), len(frames))
    return dict(zip(images, (frames - first).tolist(), strict=True)), notes


def _identities(values: Sequence[object]) -> list[int]:
    """Identity of each box: its number, or for a text the number of its first occurrence; -1 = no
    identity.
    """
    numbers = [_number(value) for value in values]
    if all(
        value in (None, "") or (0 <= n <= MAX_ID and n % 1 == 0)
        for value, n in zip(values, numbers, strict=True)
    ):
        return [int(n) if n >= 0 else -1 for n in numbers]
    order = {
        value: index for index, value in enumerate(dict.fromkeys(str(value) for value in values))
    }
    return [-1 if value in (None, "") else order[str(value)] for value in values]


def _number(value: object) -> float:
    return number(value) if isinstance(value, str) else plain_number(value)


def _size_px(size_px: Sequence[object]) -> tuple[int, int] | None:
    sides = [_number(side) for side in size_px]
    is_size = all(math.isfinite(side) and 1 <= side <= MAX_SIDE_PX for side in sides)
    return (int(sides[0]), int(sides[1])) if sides and is_size else None


def _format_of(tool: Tool) -> LabelFormat:
    def recognises(start: LabelStart) -> bool:
        is_possible = tool.is_folder or not start.is_folder
        return is_possible and tool.mark.match(start.text) is not None

    return LabelFormat(
        name=tool.name,
        title=tool.title,
        recognises=recognises,
        read=lambda path, video: read_tool(path, tool, video),
        is_folder=tool.is_folder,
    )


FORMATS = tuple(_format_of(tool) for tool in TOOLS)
