"""Reader and writer of "CVAT for video 1.1", the XML files of the annotation tool CVAT.

    <annotations>
      <version>1.1</version>
      <meta><task> name, size, start_frame, stop_frame, labels, original_size </task></meta>
      <track id="0" label="car">
        <box frame="0" keyframe="1" outside="0" occluded="0" xtl="9.5" ytl="20" xbr="50.5" ybr="60" z_order="0">
          <attribute name="distance_m">21.4</attribute>
        </box>

Frames count from 0. Boxes have the corner convention: the left edge of the image is 0, so coordinates are 0.5 px larger
than with pixel centres at integers. `outside="1"` ends the visible part of a track, which has no box in that frame.
Between two boxes of a track, all four edges are interpolated linearly, as in CVAT. The attributes distance_m, sigma_m,
score and predicted are optional; CVAT keeps attributes that the labels of its task declare. It repeats the attributes
of a keyframe until the next one; distances are interpolated between keyframes instead. Tracks with the label dontcare
are regions that are not evaluated.

Written files list every box, and mark as keyframes the boxes from which all others can be interpolated to 1 px or 2 %
of the box, and to 2 % of the distance, so that a person has fewer boxes to correct. (CVAT's documentation, "XML
annotation format", version 1.1; the interpolation follows CVAT's `TrackManager`.)
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import HALF_PIXEL_PX
from track_range.detection.formats.tables.box_table import (
    BoxTable,
    VideoFacts,
    Written,
    frames_listed,
)
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.label_format import LabelFormat
from track_range.detection.formats.tables.limits import (
    MAX_COORDINATE_PX,
    MAX_DISTANCE_M,
    MAX_FRAME,
    MAX_ID,
    MAX_SIDE_PX,
)
from track_range.detection.formats.tables.table_checks import check_identities, check_upright
from track_range.detection.formats.video_labels.csv_labels import DONT_CARE
from track_range.foundation.arrays import BoolArray, IntArray
from track_range.foundation.files.input_files import counted, open_regular, quoted, shortened
from track_range.foundation.files.numeric_text import number
from track_range.foundation.files.xml_events import parse_xml

MAX_CVAT_BYTES = 500_000_000  # size limit, bytes: about two million boxes
MAX_BOXES = 2_000_000  # largest number of boxes, including interpolated ones; they take 300 MB
_MAX_NAME = 200  # characters of a label or name
_MAX_META = 10_000  # elements of `meta` that are used
# not boxes: refused
_SHAPES = frozenset({"polygon", "polyline", "points", "mask", "cuboid", "ellipse", "skeleton"})
_EDGES = ("xtl", "ytl", "xbr", "ybr")
_FLAGS = {"0": False, "1": True, "false": False, "true": True}
# Largest differences between a written box and its interpolation: of an edge (the larger of both),
# of the distance.
_TOLERANCE_PX, _TOLERANCE_OF_SIZE, _TOLERANCE_OF_DISTANCE = 1.0, 0.02, 0.02
# largest number of boxes from one keyframe to the next, which limits the time to choose them
_MAX_STEP = 50
# of numbers
_LIMITS = {
    "distance_m": (0.0, MAX_DISTANCE_M),
    "sigma_m": (0.0, MAX_DISTANCE_M),
    "score": (-1e6, 1e6),
}
_DECIMALS = {"distance_m": 3, "sigma_m": 3, "score": 4}
# characters that XML cannot contain
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class _Track(NamedTuple):
    track_id: int
    label: str
    line: int


# fmt: off
_BOX = np.dtype([
    ("track", np.int64),  # number of the track in the file
    ("frame", np.int64), ("edges", np.float64, 4), ("is_outside", np.bool_), ("is_keyframe", np.bool_),
    ("distance_m", np.float64), ("sigma_m", np.float64), ("score", np.float64), ("is_predicted", np.bool_),
])
# fmt: on
_COLUMN = {name: index for index, name in enumerate(_BOX.names or ())}
_Boxes = npt.NDArray[Any]  # (K,) boxes with the columns of `_BOX`


def read_cvat(path: Path, video: VideoFacts) -> BoxTable:
    """The boxes of all tracks, including interpolated boxes between two boxes of a track.

    LabelFileError: the file cannot be read, is larger than `MAX_CVAT_BYTES`, is not in this format
    (such as "CVAT for images"), has a document type or entities, shapes other than upright boxes,
    or invalid values.
    """
    content = _Content(path)
    with open_regular(path, LabelFileError, "CVAT's annotations", max_bytes=MAX_CVAT_BYTES) as file:
        parse_xml(file, path, content, LabelFileError, "CVAT's annotations")
    if len(content.tasks) > 1:
        raise LabelFileError(
            f"{path}: expected the tracks of one task, found {len(content.tasks)} tasks of a project; export each task."
        )
    boxes = np.array([tuple(box) for box in content.boxes], _BOX)
    boxes = boxes[np.lexsort((boxes["frame"], boxes["track"]))]
    facts, notes = content.video_facts(), content.notes(boxes)
    boxes = _interpolated(
        path, boxes, content.tracks, has_repeated="track_range/pixels" not in content.meta
    )
    labels = [content.tracks[track].label for track in boxes["track"].tolist()]
    table = BoxTable.of(
        boxes["frame"],
        np.array([track.track_id for track in content.tracks], np.int64)[boxes["track"]],
        labels,
        boxes["edges"] - HALF_PIXEL_PX,
        score=boxes["score"],
        observed=~boxes["is_predicted"],
        distance_m=boxes["distance_m"],
        sigma_m=boxes["sigma_m"],
        video=video.completed_by(facts, path),
        notes=notes,
    )
    if facts.n_frames is not None and len(table) and table.frame[-1] >= facts.n_frames:
        raise LabelFileError(
            f"{path}: expected boxes up to frame {facts.n_frames - 1}, the last frame of the task, found a box in "
            f"frame {table.frame[-1]}."
        )
    check_identities(table, path)
    return table


class _Content:
    """Receiver of the elements of a file (`xml_events.XmlHandler`)."""

    def __init__(self, path: Path) -> None:
        self.tracks: list[_Track] = []
        self.boxes: list[list[Any]] = []  # columns of `_BOX`
        self.meta: dict[str, str] = {}  # by the names of the last two elements
        self.tasks: set[str] = set()
        self._path = path
        self._root = ""
        self._ids: set[int] = set()
        self._attribute = ""

    def start(self, path: list[str], attributes: Mapping[str, str], line: int) -> None:
        name, depth = path[-1], len(path)
        if path[0] != "annotations":
            raise self._fault(line, "CVAT's annotations", f"the element {quoted(name)}")
        if depth == 2 and name == "image":
            raise self._fault(
                line,
                "CVAT for video 1.1 with tracks",
                "annotations of images; export the task as 'CVAT for video 1.1'",
            )
        if depth == 2 and name == "track":
            self._add_track(attributes, line)
        elif path[1:2] == ["track"] and depth == 3:
            if name in _SHAPES:
                raise self._fault(
                    line, "tracks of boxes", f"the shape {name} in track {self.tracks[-1].track_id}"
                )
            if name == "box":
                self._add_box(attributes, line)
        elif path[1:3] == ["track", "box"] and name == "attribute":
            self._attribute = attributes.get("name", "")

    def end(self, path: list[str], text: str, line: int) -> None:
        if path[1:3] == ["track", "box"] and path[-1] == "attribute":
            name, text = self._attribute, text.strip()
            if name == "predicted":
                self.boxes[-1][_COLUMN["is_predicted"]] = _FLAGS.get(text.lower(), False)
            elif name in _LIMITS and text:
                value, (low, high) = number(text), _LIMITS[name]
                if not low <= value <= high:
                    raise self._fault(
                        line,
                        f"a number from {low:g} to {high:g} as {name}, or no text",
                        quoted(text),
                    )
                self.boxes[-1][_COLUMN[name]] = value
        elif path[1:2] == ["meta"] and len(path) >= 4 and len(self.meta) < _MAX_META:
            self._root = self._root or path[2]
            self.meta.setdefault("/".join(path[-2:]), text.strip())

    def _add_track(self, attributes: Mapping[str, str], line: int) -> None:
        self._check_number(line)
        numbered = {"id": str(len(self.tracks)), **attributes}  # as of JAAD, without ids
        track_id = self._integer(numbered, "id", MAX_ID, line)
        label = attributes.get("label", "").strip()
        if not 0 < len(label) <= _MAX_NAME:
            raise self._fault(line, f"a label of at most {_MAX_NAME} characters", quoted(label))
        if track_id in self._ids:
            raise self._fault(line, "each track id once", f"the id {track_id} twice")
        self._ids.add(track_id)
        self.tasks.update(value for key, value in attributes.items() if key == "task_id")
        self.tracks.append(_Track(track_id, label, line))

    def _add_box(self, attributes: Mapping[str, str], line: int) -> None:
        check_upright(attributes.get("rotation"), f"{self._path}, line {line}")
        self._check_number(line)
        frame = self._integer(attributes, "frame", MAX_FRAME, line)
        outside = _FLAGS.get(attributes.get("outside", "0").lower())
        edges = [number(attributes.get(edge, "")) for edge in _EDGES]
        is_box = all(abs(edge) <= MAX_COORDINATE_PX for edge in edges)
        is_box = is_box and edges[0] < edges[2] and edges[1] < edges[3]
        if outside is None or not (is_box or outside):
            raise self._fault(
                line,
                f"a box with outside 0 or 1, xtl < xbr, ytl < ybr and edges up to {MAX_COORDINATE_PX:g}",
                shortened(
                    " ".join(f"{key}={attributes.get(key)}" for key in ("outside", *_EDGES)), 100
                ),
            )
        is_keyframe = _FLAGS.get(attributes.get("keyframe", "1").lower(), True)
        edges = edges if is_box else [math.nan] * 4
        figures = (math.nan, math.nan, math.nan, False)
        self.boxes.append([len(self.tracks) - 1, frame, edges, outside, is_keyframe, *figures])

    def video_facts(self) -> VideoFacts:
        sides = [number(self.meta.get(f"original_size/{name}", "")) for name in ("width", "height")]
        is_size = all(1 <= side <= MAX_SIDE_PX and side % 1 == 0 for side in sides)
        last = self._integer_of_meta("stop_frame")
        return VideoFacts(
            name=self.meta.get(f"{self._root}/name", "")[:_MAX_NAME],
            n_frames=None if last is None else last + 1,
            first_frame=self._integer_of_meta("start_frame") or 0,
            size_px=(int(sides[0]), int(sides[1])) if is_size else None,
            is_rectified=self.meta.get("track_range/pixels") == "rectified",
        )

    def notes(self, boxes: _Boxes) -> list[str]:
        """Notes on tracks without boxes, open ends, and exports of a part of the video; `boxes` are
        in order.
        """
        name, notes = self._path.name, []
        is_end = np.append(np.diff(boxes["track"]) != 0, np.ones(len(boxes[:1]), np.bool_))
        if empty := len(self.tracks) - int(is_end.sum()):
            notes.append(f"{name}: ignored {counted(empty, 'track')} without boxes.")
        first, last = self._integer_of_meta("start_frame"), self._integer_of_meta("stop_frame")
        if last is None:
            return notes
        if first or self._root == "job":
            notes.append(
                f"{name}: covers frames {first or 0} to {last} only, so tracks in other frames have no labels; if the "
                "task has several jobs, export the whole task."
            )
        ends = boxes[is_end]
        if n_open := int((~ends["is_outside"] & (ends["frame"] < last)).sum()):
            notes.append(
                f"{name}: no box is marked as outside at the end of {counted(n_open, 'track')}; each of them is taken "
                "to end at the last box."
            )
        return notes

    def _check_number(self, line: int) -> None:
        """Check the number of tracks and boxes before memory is used for another track or box."""
        if len(self.tracks) + len(self.boxes) >= MAX_BOXES:
            raise self._fault(line, f"at most {MAX_BOXES} tracks and boxes", "more")

    def _integer_of_meta(self, name: str) -> int | None:
        value = number(self.meta.get(f"{self._root}/{name}", ""))
        return int(value) if 0 <= value <= MAX_FRAME and value % 1 == 0 else None

    def _integer(self, attributes: Mapping[str, str], key: str, high: int, line: int) -> int:
        value = number(attributes.get(key, ""))
        if not 0 <= value <= high or value % 1:
            raise self._fault(
                line, f"an integer from 0 to {high} as {key}", quoted(attributes.get(key, ""))
            )
        return int(value)

    def _fault(self, line: int, expected: str, content: str) -> LabelFileError:
        return LabelFileError(f"{self._path}, line {line}: expected {expected}, found {content}.")


def _interpolated(
    path: Path, boxes: _Boxes, tracks: Sequence[_Track], *, has_repeated: bool
) -> _Boxes:
    """The visible boxes of each track in every frame, from the boxes of the file, sorted by track
    and frame.

    If it `has_repeated` attributes, boxes that are not keyframes repeat the attributes of the
    keyframe before.
    """
    steps = np.append(np.where(np.diff(boxes["track"]) == 0, np.diff(boxes["frame"]), 1), 1)[
        : len(boxes)
    ]
    for box in boxes[steps == 0][:1]:
        track = tracks[box["track"]]
        raise LabelFileError(
            f"{path}, line {track.line}: expected one box for each frame of track {track.track_id}, found two in "
            f"frame {box['frame']}."
        )
    counts = np.where(boxes["is_outside"], 0, steps)
    if counts.sum() > MAX_BOXES:  # before memory is used for them
        raise LabelFileError(
            f"{path}: expected at most {MAX_BOXES} boxes, found more, including interpolated boxes."
        )
    if has_repeated:
        _interpolate_repeated(boxes)
    before = np.repeat(np.arange(len(boxes)), counts)
    after = np.minimum(before + 1, len(boxes) - 1)
    offset = np.arange(len(before)) - np.repeat(np.cumsum(counts) - counts, counts)
    fraction = offset / steps[before]  # 0 at the last box of a track
    filled = boxes[before]
    filled["frame"] += offset
    for name in ("edges", "distance_m", "sigma_m"):
        start, end = boxes[name][before], boxes[name][after]
        f = fraction[:, None] if name == "edges" else fraction
        filled[name] = np.where((f == 0) | np.isnan(end), start, (1 - f) * start + f * end)
    return filled


def _interpolate_repeated(boxes: _Boxes) -> None:
    """Interpolate distances that repeat the distance of a keyframe, up to the next visible
    keyframe.
    """
    keyframes = np.flatnonzero(boxes["is_keyframe"] | boxes["is_outside"])
    for first, last in pairwise(keyframes.tolist()):
        between, start, end = boxes[first + 1 : last], boxes[first], boxes[last]
        if not len(between) or end["is_outside"] or start["track"] != end["track"]:
            continue
        fraction = (between["frame"] - start["frame"]) / (end["frame"] - start["frame"])
        for name in ("distance_m", "sigma_m"):
            if math.isfinite(end[name]) and (between[name] == start[name]).all():
                between[name] = start[name] + fraction * (end[name] - start[name])


def write_cvat(table: BoxTable, path: Path) -> Written:
    """Write a table as CVAT for video 1.1, where each track has one class; regions have the label
    dontcare.
    """
    frames = np.asarray(frames_listed(table), np.int64)
    table = replace(table, class_name=np.where(table.is_region, DONT_CARE, table.class_name))
    ids, notes = _identities(table)
    order = np.argsort(ids, kind="stable")
    track_ids, starts = np.unique(ids[order], return_index=True)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(
            '<?xml version="1.0" encoding="utf-8"?>\n<annotations>\n  <version>1.1</version>\n'
        )
        file.writelines(_meta_lines(table, frames))
        for track_id, rows in zip(track_ids.tolist(), np.split(order, starts[1:]), strict=False):
            file.writelines(_track_lines(table.select(rows), track_id, frames))
        file.write("</annotations>\n")
    return Written(len(table), notes)


def _identities(table: BoxTable) -> tuple[IntArray, tuple[str, ...]]:
    """(N,) identity of each box for tracks of one class, and notes on new identities."""
    ids = table.track_id.copy()
    is_new = ids < 0
    n_new, next_id = int(is_new.sum()), int(ids.max(initial=-1)) + 1
    ids[is_new] = next_id + np.arange(n_new)
    n_boxes = n_new - int(table.is_region.sum())
    notes = (
        [f"Boxes without an identity are each written as a track of one frame: {n_boxes}."]
        if n_boxes
        else []
    )
    _, class_number = np.unique(table.class_name, return_inverse=True)
    pairs, pair_number = np.unique(np.stack([ids, class_number]), axis=1, return_inverse=True)
    is_other = np.diff(pairs[0], prepend=-1) == 0
    if n_other := int(is_other.sum()):
        notes.append(
            f"Tracks with boxes of several classes are written as one track for each class, with {n_other} new ids."
        )
        new_ids = np.where(is_other, next_id + n_new + np.cumsum(is_other) - 1, pairs[0])
        ids = new_ids[pair_number.reshape(-1)]
    return ids, tuple(notes)


def _meta_lines(table: BoxTable, frames: IntArray) -> Iterator[str]:
    video, size = table.video, int(np.ptp(frames)) + 1 if len(frames) else 0
    first, last = (int(frames[0]), int(frames[-1])) if size else (video.first_frame, 0)
    yield f"  <meta>\n    <task>\n      <name>{_text(video.name or 'track-range')}</name>\n"
    yield (
        f"      <size>{size}</size>\n      <mode>interpolation</mode>\n      <overlap>0</overlap>\n"
    )
    yield f"      <start_frame>{first}</start_frame>\n      <stop_frame>{last}</stop_frame>\n"
    yield "      <frame_filter></frame_filter>\n      <labels>\n"
    for name in table.all_labels:
        yield f"        <label>\n          <name>{_text(name)}</name>\n          <attributes>\n"
        for attribute, input_type, default in CVAT_ATTRIBUTES:
            yield (
                f"            <attribute><name>{attribute}</name><mutable>True</mutable>"
                f"<input_type>{input_type}</input_type>"
                f"<default_value>{default}</default_value><values>{default}</values></attribute>\n"
            )
        yield "          </attributes>\n        </label>\n"
    yield "      </labels>\n"
    if video.size_px is not None:
        width, height = video.size_px
        yield (
            f"      <original_size>\n        <width>{width}</width>\n        <height>{height}</height>\n"
        )
        yield "      </original_size>\n"
    yield "    </task>\n    <track_range>\n"
    for key, value in {"pixels": video.pixels, **video.provenance}.items():
        yield f"      <{key}>{_text(str(value))}</{key}>\n"
    yield "    </track_range>\n  </meta>\n"


# name, input type and default value of the attributes that the labels of a task in CVAT need
CVAT_ATTRIBUTES = (
    ("distance_m", "text", ""),
    ("sigma_m", "text", ""),
    ("score", "text", ""),
    ("predicted", "checkbox", "false"),
)


def _track_lines(rows: BoxTable, track_id: int, frames: IntArray) -> Iterator[str]:
    """A track, which ends in front of each gap: a listed frame without its box."""
    label = quoteattr(_NOT_XML.sub("?", rows.label[0]))
    yield f'  <track id={quoteattr(str(track_id))} label={label} source="auto">\n'
    edges = rows.xyxy_px + HALF_PIXEL_PX
    is_last = np.append(np.diff(np.searchsorted(frames, rows.frame)) > 1, True)
    is_keyframe = _keyframes(rows, is_last)
    for row, frame in enumerate(rows.frame.tolist()):
        corners = " ".join(
            f'{name}="{edge:.3f}"' for name, edge in zip(_EDGES, edges[row].tolist(), strict=True)
        )
        is_predicted = not rows.observed[row]
        flags = f'keyframe="{is_keyframe[row]:d}" outside="0" occluded="{is_predicted:d}"'
        yield f'    <box frame="{frame}" {flags} {corners} z_order="0">\n'
        for name, decimals in _DECIMALS.items():
            if math.isfinite(value := getattr(rows, name)[row]):
                yield f'      <attribute name="{name}">{value:.{decimals}f}</attribute>\n'
        yield (
            f'      <attribute name="predicted">{"true" if is_predicted else "false"}</attribute>\n    </box>\n'
        )
        if is_last[row] and frame < frames[-1]:
            flags = 'keyframe="1" outside="1" occluded="0"'
            yield f'    <box frame="{frame + 1}" {flags} {corners} z_order="0"></box>\n'
    yield "  </track>\n"


def _keyframes(rows: BoxTable, is_last: BoolArray) -> BoolArray:
    """(N,) whether CVAT needs a box of a track to interpolate the others; boxes before and after a
    gap are needed.
    """
    values = np.column_stack([rows.xyxy_px, rows.distance_m])
    is_keyframe: BoolArray = is_last.copy()
    is_keyframe[1:] |= is_last[:-1] | np.diff(rows.observed) | np.diff(np.isnan(rows.distance_m))
    is_keyframe[::_MAX_STEP] = True
    starts = np.flatnonzero(is_keyframe)
    size_px = (rows.xyxy_px[:, 2:] - rows.xyxy_px[:, :2]).max(axis=1)
    limit_px = np.maximum(_TOLERANCE_PX, _TOLERANCE_OF_SIZE * size_px)
    limits = np.column_stack([*[limit_px] * 4, _TOLERANCE_OF_DISTANCE * rows.distance_m])
    pending = list(zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True))
    # Ramer, Douglas and Peucker: the box with the largest difference becomes a keyframe
    while pending:
        first, last = pending.pop()
        if last - first < 2:
            continue
        between = slice(first + 1, last)
        fraction = (rows.frame[between] - rows.frame[first]) / (
            rows.frame[last] - rows.frame[first]
        )
        line = values[first] + fraction[:, None] * (values[last] - values[first])
        # ignores unknown distances
        error = np.fmax.reduce(np.abs(values[between] - line) / limits[between], axis=1)
        if error.max() > 1:
            middle = first + 1 + int(np.argmax(error))
            is_keyframe[middle] = True
            pending += [(first, middle), (middle, last)]
    return is_keyframe


def _text(text: str) -> str:
    return escape(_NOT_XML.sub("?", text))


CVAT = LabelFormat(
    name="cvat",
    title="CVAT for video 1.1",
    recognises=lambda start: start.first.startswith("<"),
    priority=-10,  # any XML
    read=read_cvat,
    write=write_cvat,
    precision_px=0.0005,
)
