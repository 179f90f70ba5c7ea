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
score and predicted are optional; CVAT keeps those that the labels of its task declare. It repeats the attributes of a
keyframe until the next one; distances are interpolated between keyframes instead. Tracks with the label dontcare are
regions that are not evaluated.

Written files list every box, and mark as keyframes those from which the others can be interpolated to 1 px or 2 % of
the box, and to 2 % of the distance, so that a person has fewer boxes to correct. (CVAT's documentation, "XML annotation
format", version 1.1; the interpolation is that of CVAT's `TrackManager`.)
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.box_table import HALF_PIXEL_PX, BoxTable, VideoFacts, Written, frames_listed
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.limits import MAX_COORDINATE_PX, MAX_DISTANCE_M, MAX_FRAME, MAX_ID
from track_range.detection.formats.table_checks import check_identities
from track_range.detection.formats.video_labels.csv_labels import DONT_CARE
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.files.input_files import counted, open_regular, quoted, shortened
from track_range.foundation.files.numeric_text import number
from track_range.foundation.files.xml_events import parse_xml

MAX_CVAT_BYTES = 500_000_000
"""Size limit, bytes: about two million boxes."""

MAX_BOXES = 2_000_000
"""Largest number of boxes, including interpolated ones; they take 300 MB."""

_MAX_NAME = 200
"""Largest number of characters of a label or name."""

_MAX_META = 10_000
"""Largest number of elements of `meta` that are used."""

_MAX_SIDE_PX = 65_535
"""Largest width or height of an image."""

_SHAPES = frozenset({"polygon", "polyline", "points", "mask", "cuboid", "ellipse", "skeleton"})
"""Shapes of tracks other than boxes."""

_EDGES = ("xtl", "ytl", "xbr", "ybr")
_FLAGS = {"0": 0.0, "1": 1.0, "false": 0.0, "true": 1.0}

_TOLERANCE_PX, _TOLERANCE_OF_SIZE, _TOLERANCE_OF_DISTANCE = 1.0, 0.02, 0.02
"""Largest difference between a written box and its interpolation: of an edge in px or as a fraction of the box's longer
side, whichever is larger, and of the distance as a fraction of it."""

_MAX_STEP = 50
"""Largest number of boxes from one keyframe to the next, which limits the time to choose them."""

_DECIMALS, _SCORE_DECIMALS = 3, 4

_FRAME, _OUTSIDE, _DISTANCE, _SIGMA, _SCORE, _PREDICTED, _KEYFRAME = 0, 5, 6, 7, 8, 9, 10
"""Columns of the boxes of a track; columns 1 to 4 are the edges."""

_N_COLUMNS = 11

_LIMITS = {
    "distance_m": (_DISTANCE, 0.0, MAX_DISTANCE_M),
    "sigma_m": (_SIGMA, 0.0, MAX_DISTANCE_M),
    "score": (_SCORE, -1e6, 1e6),
}
"""Column, smallest and largest value of each attribute that is a number."""

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML cannot contain."""


@dataclass(slots=True)
class _Track:
    """One track; `boxes` has a row of `_N_COLUMNS` numbers for each box, in the order of the file."""

    track_id: int
    label: str
    line: int
    boxes: list[list[float]] = field(default_factory=list)


def read_cvat(path: Path, video: VideoFacts) -> BoxTable:
    """The boxes of all tracks, with those between two boxes of a track interpolated.

    Raises:
        LabelFileError: the file cannot be read, is larger than `MAX_CVAT_BYTES`, is not in this format (such as "CVAT
            for images"), has a document type or entities, shapes other than upright boxes, or invalid values.
    """
    content = _Content(path)
    with open_regular(path, LabelFileError, "CVAT's annotations", max_bytes=MAX_CVAT_BYTES) as file:
        parse_xml(file, path, content, LabelFileError, "CVAT's annotations")
    content.check()
    tracks = [track for track in content.tracks if track.boxes]
    rows = _interpolated(path, tracks, has_repeated=not content.is_of_track_range)
    counts = [len(part) for part in rows]
    columns = np.concatenate([np.zeros((0, _N_COLUMNS)), *rows])
    table = BoxTable.of(
        columns[:, _FRAME],
        np.repeat(np.array([track.track_id for track in tracks], np.int64), counts),
        [track.label for track, count in zip(tracks, counts, strict=True) for _ in range(count)],
        columns[:, 1:5] - HALF_PIXEL_PX,
        is_region=np.repeat(np.array([track.label.lower() == DONT_CARE for track in tracks], np.bool_), counts),
        score=columns[:, _SCORE],
        observed=columns[:, _PREDICTED] == 0,
        distance_m=columns[:, _DISTANCE],
        sigma_m=columns[:, _SIGMA],
        video=content.video_facts(video),
        notes=content.notes(),
    )
    last = content.integer_of_meta("stop_frame")
    if last is not None and len(table) and table.frame[-1] > last:
        raise LabelFileError(
            f"{path}: expected boxes up to frame {last}, the last of the task, found one in frame {table.frame[-1]}."
        )
    check_identities(table, path)
    return table


class _Content:
    """Receiver of the elements of a file (`xml_events.XmlHandler`)."""

    def __init__(self, path: Path) -> None:
        self.tracks: list[_Track] = []
        self._path = path
        self._meta: dict[str, str] = {}  # by the names of the last two elements
        self._root = ""
        self._tasks: set[str] = set()
        self._ids: set[int] = set()
        self._attribute = ""
        self._n_elements = 0

    def start(self, path: list[str], attributes: Mapping[str, str], line: int) -> None:
        """An element begins."""
        name, depth = path[-1], len(path)
        if depth == 1:
            if name != "annotations":
                raise self._fault(line, "CVAT's annotations", f"the element {quoted(name)}")
        elif depth == 2 and name == "image":
            raise self._fault(
                line, "CVAT for video 1.1 with tracks", "annotations of images; export the task as 'CVAT for video 1.1'"
            )
        elif depth == 2 and name == "track":
            self._add_track(attributes, line)
        elif path[1] == "track" and depth == 3:
            self._add_shape(name, attributes, line)
        elif path[1:3] == ["track", "box"] and name == "attribute":
            self._attribute = attributes.get("name", "")

    def end(self, path: list[str], text: str, line: int) -> None:
        """An element ends."""
        if path[1:3] == ["track", "box"] and path[-1] == "attribute":
            self._set_attribute(self._attribute, text.strip(), line)
        elif path[1:2] == ["meta"] and len(path) >= 4 and len(self._meta) < _MAX_META:
            self._root = self._root or path[2]
            self._meta.setdefault("/".join(path[-2:]), text.strip())

    def _count(self, line: int) -> None:
        """Count a track or a box, before memory is used for it."""
        self._n_elements += 1
        if self._n_elements > MAX_BOXES:
            raise self._fault(line, f"at most {MAX_BOXES} tracks and boxes", "more")

    def _add_track(self, attributes: Mapping[str, str], line: int) -> None:
        self._count(line)
        track_id = self._integer(attributes, "id", MAX_ID, line)
        label = attributes.get("label", "").strip()
        if not 0 < len(label) <= _MAX_NAME:
            raise self._fault(line, f"a label of at most {_MAX_NAME} characters", quoted(label))
        if track_id in self._ids:
            raise self._fault(line, "each track id once", f"the id {track_id} twice")
        self._ids.add(track_id)
        self._tasks |= {attributes["task_id"]} if "task_id" in attributes else set()
        self.tracks.append(_Track(track_id, label, line))

    def _add_shape(self, name: str, attributes: Mapping[str, str], line: int) -> None:
        if name in _SHAPES:
            raise self._fault(line, "tracks of boxes", f"the shape {name} in track {self.tracks[-1].track_id}")
        if name != "box":
            return
        if number(attributes.get("rotation", "0")) != 0:
            raise self._fault(line, "upright boxes", f"the rotation {quoted(attributes['rotation'])}")
        self._count(line)
        frame = self._integer(attributes, "frame", MAX_FRAME, line)
        outside = _FLAGS.get(attributes.get("outside", "0").lower(), math.nan)
        edges = [number(attributes.get(edge, "")) for edge in _EDGES]
        is_box = all(abs(edge) <= MAX_COORDINATE_PX for edge in edges)
        is_box = is_box and edges[0] < edges[2] and edges[1] < edges[3]
        if math.isnan(outside) or not (is_box or outside):
            raise self._fault(
                line,
                f"a box with outside 0 or 1, xtl < xbr, ytl < ybr and edges up to {MAX_COORDINATE_PX:g}",
                shortened(" ".join(f"{key}={attributes.get(key)}" for key in ("outside", *_EDGES)), 100),
            )
        edges = edges if is_box else [math.nan] * 4
        is_keyframe = _FLAGS.get(attributes.get("keyframe", "1").lower(), 1.0)
        self.tracks[-1].boxes.append([float(frame), *edges, outside, math.nan, math.nan, math.nan, 0.0, is_keyframe])

    def _set_attribute(self, name: str, text: str, line: int) -> None:
        box = self.tracks[-1].boxes[-1]
        if name == "predicted":
            box[_PREDICTED] = _FLAGS.get(text.lower(), 0.0)
        elif name in _LIMITS and text:
            column, low, high = _LIMITS[name]
            box[column] = number(text)
            if not low <= box[column] <= high:
                raise self._fault(line, f"a number from {low:g} to {high:g} as {name}, or no text", quoted(text))

    def check(self) -> None:
        """Check what is known at the end of the file.

        Raises:
            LabelFileError: the tracks are of several tasks.
        """
        if len(self._tasks) > 1:
            raise LabelFileError(
                f"{self._path}: expected the tracks of one task, found {len(self._tasks)} tasks of a project; export "
                "each task."
            )

    @property
    def is_of_track_range(self) -> bool:
        """Whether track-range wrote the file, and CVAT did not write it again."""
        return "track_range/pixels" in self._meta

    def integer_of_meta(self, name: str) -> int | None:
        """An integer in `meta`, of the task or job; None if it is missing."""
        value = number(self._meta.get(f"{self._root}/{name}", ""))
        return int(value) if 0 <= value <= MAX_FRAME and value % 1 == 0 else None

    def video_facts(self, video: VideoFacts) -> VideoFacts:
        """Name, number of frames and image size; those of `video` where the file states none.

        Raises:
            LabelFileError: the images of the file have another size than the video.
        """
        sides = [number(self._meta.get(f"original_size/{name}", "")) for name in ("width", "height")]
        is_size = all(1 <= side <= _MAX_SIDE_PX and side % 1 == 0 for side in sides)
        size_px = (int(sides[0]), int(sides[1])) if is_size else None
        if size_px is not None and video.size_px not in (None, size_px):
            width, height = video.size_px or size_px
            raise LabelFileError(
                f"{self._path}: expected boxes in images of {width}x{height} px as in the video, found "
                f"{size_px[0]}x{size_px[1]} px."
            )
        last = self.integer_of_meta("stop_frame")
        return replace(
            video,
            name=video.name or self._meta.get(f"{self._root}/name", "")[:_MAX_NAME],
            n_frames=video.n_frames or (None if last is None else last + 1),
            first_frame=self.integer_of_meta("start_frame") or 0,
            size_px=video.size_px or size_px,
            is_rectified=video.is_rectified or self._meta.get("track_range/pixels") == "rectified",
        )

    def notes(self) -> tuple[str, ...]:
        """Notes for the user on tracks without boxes, open ends, and exports of a part of the video."""
        notes = []
        if empty := sum(not track.boxes for track in self.tracks):
            notes.append(f"{self._path.name}: ignored {counted(empty, 'track')} without boxes.")
        first, last = self.integer_of_meta("start_frame"), self.integer_of_meta("stop_frame")
        if (first and last is not None) or (self._root == "job" and last is not None):
            notes.append(
                f"{self._path.name}: covers frames {first or 0} to {last} only, so tracks in other frames have no "
                "labels; for a task with several jobs, export the task."
            )
        ends = [max(track.boxes, key=lambda box: box[_FRAME]) for track in self.tracks if track.boxes]
        n_open = sum(end[_OUTSIDE] == 0 and last is not None and end[_FRAME] < last for end in ends)
        if n_open:
            notes.append(
                f"{self._path.name}: no box is marked as outside at the end of {counted(n_open, 'track')}; the last "
                "box is taken to be the end."
            )
        return tuple(notes)

    def _integer(self, attributes: Mapping[str, str], key: str, high: int, line: int) -> int:
        value = number(attributes.get(key, ""))
        if not 0 <= value <= high or value % 1:
            raise self._fault(line, f"an integer from 0 to {high} as {key}", quoted(attributes.get(key, "")))
        return int(value)

    def _fault(self, line: int, expected: str, content: str) -> LabelFileError:
        return LabelFileError(f"{self._path}, line {line}: expected {expected}, found {content}.")


def _interpolated(path: Path, tracks: Sequence[_Track], *, has_repeated: bool) -> list[FloatArray]:
    """The visible boxes of each track in every frame, (N, `_N_COLUMNS`) each.

    Args:
        path: the file, for messages.
        tracks: tracks with at least one box.
        has_repeated: whether boxes that are not keyframes repeat the attributes of the keyframe before.

    Raises:
        LabelFileError: a track has two boxes in a frame, or there are more than `MAX_BOXES` boxes.
    """
    parts, n_boxes = [], 0  # the number is checked before memory is used
    for track in tracks:
        boxes = np.array(track.boxes)
        boxes = boxes[np.argsort(boxes[:, _FRAME], kind="stable")]
        steps = np.diff(boxes[:, _FRAME], append=boxes[-1, _FRAME] + 1)
        if (steps == 0).any():
            raise LabelFileError(
                f"{path}, line {track.line}: expected one box for each frame of track {track.track_id}, found two in "
                f"frame {boxes[np.argmin(steps), _FRAME]:.0f}."
            )
        counts = np.where(boxes[:, _OUTSIDE] == 0, steps, 0).astype(np.int64)
        n_boxes += int(counts.sum())
        if n_boxes > MAX_BOXES:
            raise LabelFileError(
                f"{path}: expected at most {MAX_BOXES} boxes, found more, including interpolated ones."
            )
        parts.append((boxes, steps, counts))
    for boxes, _, _ in parts if has_repeated else ():
        _interpolate_repeated(boxes)
    return [_between(*part) for part in parts]


def _interpolate_repeated(boxes: FloatArray) -> None:
    """Interpolate the distances (K, `_N_COLUMNS`) that repeat those of a keyframe, up to the next visible keyframe."""
    keyframes = np.flatnonzero((boxes[:, _KEYFRAME] == 1) | (boxes[:, _OUTSIDE] == 1))
    for first, last in pairwise(keyframes.tolist()):
        between = boxes[first + 1 : last]
        for column in (_DISTANCE, _SIGMA):
            start, end = boxes[first, column], boxes[last, column]
            if (
                len(between)
                and not boxes[last, _OUTSIDE]
                and math.isfinite(end)
                and (between[:, column] == start).all()
            ):
                fraction = (between[:, _FRAME] - boxes[first, _FRAME]) / (boxes[last, _FRAME] - boxes[first, _FRAME])
                between[:, column] = start + fraction * (end - start)


def _between(boxes: FloatArray, steps: FloatArray, counts: IntArray) -> FloatArray:
    """Boxes (K, `_N_COLUMNS`), each with interpolated ones after it: `counts` (K,) boxes for `steps` (K,) frames."""
    before = np.repeat(np.arange(len(boxes)), counts)
    after = np.minimum(before + 1, len(boxes) - 1)
    offset = np.arange(len(before)) - np.repeat(np.cumsum(counts) - counts, counts)
    fraction = (offset / steps[before])[:, None]
    filled = boxes[before]
    columns = [1, 2, 3, 4, _DISTANCE, _SIGMA]
    start, end = filled[:, columns], boxes[after][:, columns]
    filled[:, columns] = np.where((fraction == 0) | np.isnan(end), start, (1 - fraction) * start + fraction * end)
    filled[:, _FRAME] += offset
    return filled


def write_cvat(table: BoxTable, path: Path) -> Written:
    """Write a table as CVAT for video 1.1, where each track has one class; regions have the label dontcare.

    Raises:
        OSError: the file cannot be written.
    """
    frames = frames_listed(table)
    table = replace(table, class_name=np.where(table.is_region, DONT_CARE, table.class_name))
    ids, notes = _identities(table)
    order = np.argsort(ids, kind="stable")
    track_ids, starts = np.unique(ids[order], return_index=True)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write('<?xml version="1.0" encoding="utf-8"?>\n<annotations>\n  <version>1.1</version>\n')
        file.writelines(_meta_lines(table, frames))
        for track_id, rows in zip(track_ids.tolist(), np.split(order, starts[1:]), strict=False):
            file.writelines(_track_lines(table.select(rows), track_id, frames.stop))
        file.write("</annotations>\n")
    return Written(len(table), notes)


def _identities(table: BoxTable) -> tuple[IntArray, tuple[str, ...]]:
    """(N,) identity of each box for tracks of one class, and notes on new identities."""
    ids = table.track_id.copy()
    is_new = ids < 0
    n_new, next_id = int(is_new.sum()), int(ids.max(initial=-1)) + 1
    ids[is_new] = next_id + np.arange(n_new)
    n_boxes = n_new - int(table.is_region.sum())
    notes = [f"Boxes without an identity, each written as a track of one frame: {n_boxes}."] if n_boxes else []
    _, class_number = np.unique(table.class_name, return_inverse=True)
    pairs, first, pair_number = np.unique(np.stack([ids, class_number]), axis=1, return_index=True, return_inverse=True)
    is_other = np.append(False, np.diff(pairs[0]) == 0) if len(first) else np.zeros(0, np.bool_)
    if n_other := int(is_other.sum()):
        notes.append(
            f"Tracks with boxes of several classes are written as one track for each class, with {n_other} new ids."
        )
        new_ids = np.where(is_other, next_id + n_new + np.cumsum(is_other) - 1, pairs[0])
        ids = new_ids[pair_number.reshape(-1)]
    return ids, tuple(notes)


def _meta_lines(table: BoxTable, frames: range) -> Iterator[str]:
    video = table.video
    yield f"  <meta>\n    <task>\n      <name>{_text(video.name or 'track-range')}</name>\n"
    yield f"      <size>{len(frames)}</size>\n      <mode>interpolation</mode>\n      <overlap>0</overlap>\n"
    yield f"      <start_frame>{frames.start}</start_frame>\n      <stop_frame>{max(frames.stop - 1, 0)}</stop_frame>\n"
    yield "      <frame_filter></frame_filter>\n      <labels>\n"
    for name in dict.fromkeys((*ROAD_CLASSES, *sorted({_label(name) for name in table.class_name}))):
        yield f"        <label>\n          <name>{_text(name)}</name>\n          <attributes>\n"
        for attribute, kind, default in CVAT_ATTRIBUTES:
            yield (
                f"            <attribute><name>{attribute}</name><mutable>True</mutable><input_type>{kind}</input_type>"
                f"<default_value>{default}</default_value><values>{default}</values></attribute>\n"
            )
        yield "          </attributes>\n        </label>\n"
    yield "      </labels>\n"
    if video.size_px is not None:
        width, height = video.size_px
        yield f"      <original_size>\n        <width>{width}</width>\n        <height>{height}</height>\n"
        yield "      </original_size>\n"
    yield "    </task>\n    <track_range>\n"
    facts = {"pixels": "rectified" if video.is_rectified else "original", **video.provenance}
    for key, value in facts.items():
        yield f"      <{key}>{_text(str(value))}</{key}>\n"
    yield "    </track_range>\n  </meta>\n"


CVAT_ATTRIBUTES = (
    ("distance_m", "text", ""),
    ("sigma_m", "text", ""),
    ("score", "text", ""),
    ("predicted", "checkbox", "false"),
)
"""Name, input type and default value of the attributes that the labels of a task in CVAT need."""


def _track_lines(rows: BoxTable, track_id: int, n_frames: int) -> Iterator[str]:
    """The element of one track, whose boxes have one class."""
    yield f'  <track id={quoteattr(str(track_id))} label={_quoted(_label(rows.class_name[0]))} source="auto">\n'
    edges = rows.xyxy_px + HALF_PIXEL_PX
    is_last = np.append(np.diff(rows.frame) > 1, True)
    is_keyframe = _keyframes(rows, is_last)
    for row in range(len(rows)):
        frame = int(rows.frame[row])
        is_predicted = not rows.observed[row]
        yield _box_start(frame, edges[row], is_keyframe=bool(is_keyframe[row]), is_occluded=is_predicted) + ">\n"
        for name, value, decimals in (
            ("distance_m", rows.distance_m[row], _DECIMALS),
            ("sigma_m", rows.sigma_m[row], _DECIMALS),
            ("score", rows.score[row], _SCORE_DECIMALS),
        ):
            if math.isfinite(value):
                yield f'      <attribute name="{name}">{value:.{decimals}f}</attribute>\n'
        yield f'      <attribute name="predicted">{"true" if is_predicted else "false"}</attribute>\n    </box>\n'
        if is_last[row] and frame + 1 < n_frames:
            yield _box_start(frame + 1, edges[row], is_keyframe=True, is_outside=True) + "></box>\n"
    yield "  </track>\n"


def _box_start(
    frame: int, edges: FloatArray, *, is_keyframe: bool, is_outside: bool = False, is_occluded: bool = False
) -> str:
    corners = " ".join(f'{name}="{edge:.{_DECIMALS}f}"' for name, edge in zip(_EDGES, edges.tolist(), strict=True))
    flags = f'keyframe="{is_keyframe:d}" outside="{is_outside:d}" occluded="{is_occluded:d}"'
    return f'    <box frame="{frame}" {flags} {corners} z_order="0"'


def _keyframes(rows: BoxTable, is_last: BoolArray) -> BoolArray:
    """(N,) which boxes of a track CVAT needs to interpolate the others; those before and after a gap are needed."""
    values = np.column_stack([rows.xyxy_px, rows.distance_m])
    is_keyframe: BoolArray = is_last.copy()
    is_keyframe[0] = True
    is_keyframe[1:] |= is_last[:-1]
    is_keyframe[1:] |= rows.observed[1:] != rows.observed[:-1]
    is_keyframe[1:] |= np.diff(np.isnan(rows.distance_m))
    is_keyframe[::_MAX_STEP] = True
    starts = np.flatnonzero(is_keyframe)
    size_px = (rows.xyxy_px[:, 2:] - rows.xyxy_px[:, :2]).max(axis=1)
    limit_px = np.maximum(_TOLERANCE_PX, _TOLERANCE_OF_SIZE * size_px)
    limits = np.column_stack([*[limit_px] * 4, _TOLERANCE_OF_DISTANCE * rows.distance_m])
    pending = list(zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True))
    while pending:  # Ramer, Douglas and Peucker: the box with the largest difference becomes a keyframe
        first, last = pending.pop()
        if last - first < 2:
            continue
        between = slice(first + 1, last)
        fraction = (rows.frame[between] - rows.frame[first]) / (rows.frame[last] - rows.frame[first])
        line = values[first] + fraction[:, None] * (values[last] - values[first])
        error = np.fmax.reduce(np.abs(values[between] - line) / limits[between], axis=1)  # ignores unknown distances
        if error.max() > 1:
            middle = first + 1 + int(np.argmax(error))
            is_keyframe[middle] = True
            pending += [(first, middle), (middle, last)]
    return is_keyframe


def _label(name: str) -> str:
    return str(name) or "object"


def _text(text: str) -> str:
    return escape(_NOT_XML.sub("?", text))


def _quoted(text: str) -> str:
    return quoteattr(_NOT_XML.sub("?", text))
