"""Reader of labels of annotation tools and data sets in JSON, XML and CSV, as one file or one file for each image.

`LAYOUTS` has a row for each layout: the marks in the first 64 kB, and a function that lists its boxes. Boxes
have the corner convention, where the left edge of the image is 0, except in Scalabel (BDD100K) and Supervisely, whose
edges are the first and last pixel. Frames are given by number, or by the last number in the name of the image.

    BDD100K        https://doc.bdd100k.com/format.html, Scalabel's format: images (det_20) and videos (box_track_20)
    LabelMe        https://github.com/wkentaro/labelme, one file for each image; group_id is the identity
    Label Studio   https://labelstud.io/guide/export, in per cent of the image; JSON, JSON-MIN and video labels
    VIA            https://www.robots.ox.ac.uk/~vgg/software/via, version 1 and 2, JSON, project or CSV
    Supervisely    https://docs.supervisely.com, annotations of images and videos
    CreateML, CSV  as Roboflow exports them: the centre and size of boxes; columns filename, class, xmin, ...
    supervision    JSONSink and CSVSink, with the frame number among the custom data
    Pascal VOC     Everingham et al., IJCV 2010, as CVAT, LabelImg and Roboflow write it
    UA-DETRAC      Wen et al., CVIU 2020, frames from 1
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from track_range.detection.boxes import HALF_PIXEL_PX
from track_range.detection.classes import COCO_CLASSES
from track_range.detection.formats.tables import table_checks
from track_range.detection.formats.tables.box_table import BoxTable, VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.label_format import (
    START_BYTES,
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
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.input_files import open_regular, quoted, readable
from track_range.foundation.files.numeric_text import number, plain_number
from track_range.foundation.files.structured_text import parse_json, read_json
from track_range.foundation.files.xml_events import parse_xml

_MAX_BYTES = 250_000_000  # of a file
_MAX_BOXES = 2_000_000  # also of interpolated ones
_MAX_FILES = 200_000  # of a folder with one for each image
_FRAME_NAMES = (
    "frame",
    "frame_index",
    "frame_number",
    "frame_id",
    "frame_idx",
    "frame_no",
    "frame_num",
)
_LABEL_NAMES = ("class", "label", "type", "name", "category", "object", "class_name")
_IDENTITY_NAMES = ("track_id", "track", "instance_id", "id")
_MAX_TEXT = 200  # characters of a label
# that Label Studio puts before the names of uploaded images
_UPLOADED = re.compile(r"^[0-9a-f]{8}-")

_Object = Mapping[str, Any]


class _Box(NamedTuple):
    """One box; `image` is a frame number from 0, or the name of an image."""

    image: int | str
    label: str
    edges: Sequence[float]  # left, top, right, bottom in the corner convention
    identity: object = None
    score: object = None
    is_region: bool = False
    size_px: tuple[object, object] | None = None  # of the image


def _corners(points: Any, border: float = 0.0) -> list[float]:
    """Edges of the box around points; `border` is 1 if the last pixel is stated instead of the edge
    behind it.
    """
    columns = np.array(points, np.float64).reshape(-1, 2)
    return [*columns.min(axis=0).tolist(), *(columns.max(axis=0) + border).tolist()]


def _sized(box: _Object, scale: tuple[float, float] = (1.0, 1.0)) -> list[float]:
    """Edges of a box with x, y, width and height, which are multiplied by `scale`."""
    x, y, width, height = (float(box[key]) for key in ("x", "y", "width", "height"))
    return [x * scale[0], y * scale[1], (x + width) * scale[0], (y + height) * scale[1]]


def _bdd100k(content: Any) -> Iterator[_Box]:
    for index, item in enumerate(
        content.get("frames", [content]) if isinstance(content, dict) else content
    ):
        frame = next(
            (item[key] for key in ("frameIndex", "frame_index", "index") if key in item), None
        )
        image = frame if frame is not None else item.get("name", index)
        for label in item.get("labels") or item.get("objects") or ():
            if box := label.get("box2d"):
                crowd = (label.get("attributes") or {}).get(
                    "crowd", (label.get("attributes") or {}).get("Crowd")
                )
                points = [[box["x1"], box["y1"]], [box["x2"], box["y2"]]]
                identity = label.get("id") if frame is not None else None
                score = label.get("score")
                yield _Box(
                    image, label["category"], _corners(points, 1), identity, score, crowd is True
                )


def _labelme(content: Any) -> Iterator[_Box]:
    size_px = (content.get("imageWidth"), content.get("imageHeight"))
    for shape in content["shapes"]:
        if shape.get("shape_type", "polygon") in ("rectangle", "polygon", "rotation"):
            edges = _corners(shape["points"])
            yield _Box(
                content["imagePath"],
                shape["label"],
                edges,
                shape.get("group_id"),
                shape.get("score"),
                False,
                size_px,
            )


def _label_studio(content: Any) -> Iterator[_Box]:
    for task in content if isinstance(content, list) else [content]:
        data = task.get("data", task)
        done = [done for done in task.get("annotations") or () if not done.get("was_cancelled")]
        results = (done or task.get("predictions") or [_as_predicted(task)])[0]["result"]
        for number_of_result, result in enumerate(results):
            value = result["value"]
            size_px = tuple(
                result.get(k) or value.get(k) or data.get(k)
                for k in ("original_width", "original_height")
            )
            if "sequence" in value:
                yield from _interpolated(value, number_of_result, size_px)
            elif labels := value.get("rectanglelabels"):
                image = _image_of_task(data)
                scale = (float(size_px[0]) / 100, float(size_px[1]) / 100)
                yield _Box(
                    image,
                    labels[0],
                    _sized(value, scale),
                    None,
                    result.get("score"),
                    False,
                    size_px,
                )


def _as_predicted(task: _Object) -> _Object:
    """The boxes of a task in Label Studio's short JSON, as an annotation has them."""
    items = [item for key in ("label", "bbox", "box") for item in task.get(key) or ()]
    return {"result": [{"value": item} for item in items]}


def _image_of_task(data: _Object) -> str:
    """The name of a task's image, without the address and Label Studio's prefix of uploads."""
    texts = (data.get(key) for key in ("image", "img", "ocr"))
    name = next(text for text in texts if isinstance(text, str))
    return _UPLOADED.sub("", name.partition("?")[0].rpartition("/")[2])


def _interpolated(value: _Object, identity: int, size_px: tuple[Any, Any]) -> Iterator[_Box]:
    """The boxes of a track in a video, including boxes interpolated between two keyframes; frames
    count from 1.
    """
    if None in size_px:
        raise LabelFileError("expected original_width and original_height of the video, found none")
    scale = (float(size_px[0]) / 100, float(size_px[1]) / 100)
    keys = sorted(value["sequence"], key=lambda key: int(key["frame"]))
    last = int(value.get("framesCount") or 0)
    for key, after in pairwise([*keys, None]):
        start, edges = int(key["frame"]), np.array(_sized(key, scale))
        end = start + 1 if after is None or not key.get("enabled", True) else int(after["frame"])
        end = last + 1 if after is None and key.get("enabled", True) and last >= start else end
        if end - start > MAX_FRAME:
            raise ValueError("frames")
        target = edges if after is None else np.array(_sized(after, scale))
        for frame in range(start, end):
            between = edges + (target - edges) * (frame - start) / (end - start) * (
                after is not None
            )
            yield _Box(
                frame - 1, value["labels"][0], between.tolist(), identity, None, False, size_px
            )


def _via_region(image: str, shape: _Object, attributes: _Object) -> Iterator[_Box]:
    name = next(
        (attributes[key] for key in _LABEL_NAMES if key in attributes),
        next(iter(attributes.values()), ""),
    )
    label = (
        next((key for key, chosen in name.items() if chosen), "")
        if isinstance(name, dict)
        else str(name)
    )
    identity = next((attributes[key] for key in _IDENTITY_NAMES if key in attributes), None)
    if shape.get("name") == "rect":
        yield _Box(image, label, _sized(shape), identity)
    elif "all_points_x" in shape:
        yield _Box(
            image,
            label,
            _corners(list(zip(shape["all_points_x"], shape["all_points_y"], strict=True))),
            identity,
        )


def _via(content: Any) -> Iterator[_Box]:
    for item in content.get("_via_img_metadata", content).values():
        regions = item["regions"]
        for region in regions.values() if isinstance(regions, dict) else regions:
            yield from _via_region(
                item["filename"], region["shape_attributes"], region["region_attributes"]
            )


def _supervisely(content: Any) -> Iterator[_Box]:
    size_px = (content["size"]["width"], content["size"]["height"])
    if "frames" in content:
        labels = {
            item.get("key", item.get("id")): item["classTitle"] for item in content["objects"]
        }
        keys = list(labels)
        for frame in content["frames"]:
            for figure in frame["figures"]:
                key = figure.get("objectKey", figure.get("objectId"))
                points = figure["geometry"].get("points")
                if points:
                    edges = _corners(points["exterior"], 1)
                    yield _Box(
                        frame["index"], labels[key], edges, keys.index(key), None, False, size_px
                    )
    else:
        for item in content["objects"]:
            if (points := item.get("points")) and item.get("geometryType", "rectangle") in (
                "rectangle",
                "polygon",
            ):
                yield _Box(
                    "",
                    item["classTitle"],
                    _corners(points["exterior"], 1),
                    None,
                    None,
                    False,
                    size_px,
                )


def _createml(content: Any) -> Iterator[_Box]:
    for item in content:
        for label in item["annotations"]:
            x, y, width, height = (
                float(label["coordinates"][key]) for key in ("x", "y", "width", "height")
            )
            # x, y are the centre
            edges = [x - width / 2, y - height / 2, x + width / 2, y + height / 2]
            yield _Box(item.get("image", item.get("imagefilename")), label["label"], edges)


def _supervision(content: Any) -> Iterator[_Box]:
    for row in content:
        key = next((key for key in _FRAME_NAMES if key in row), None)
        if key is None:
            raise LabelFileError(
                "expected the frame number among the custom data of supervision's sink, found "
                "none; write it with sink.append(detections, custom_data={'frame_index': index})"
            )
        label = row.get("class_name") or COCO_CLASSES[int(float(row["class_id"]))]
        edges = [float(row[name]) for name in ("x_min", "y_min", "x_max", "y_max")]
        yield _Box(
            int(float(row[key])), str(label), edges, row.get("tracker_id"), row.get("confidence")
        )


def _filename_rows(content: Any) -> Iterator[_Box]:
    for row in content:
        edges = [float(row[name]) for name in ("xmin", "ymin", "xmax", "ymax")]
        yield _Box(
            row["filename"], row["class"], edges, size_px=(row.get("width"), row.get("height"))
        )


def _via_rows(content: Any) -> Iterator[_Box]:
    for row in content:
        cells = {kind: row[f"region_{kind}attributes"] or "{}" for kind in ("shape_", "")}
        shape, attributes = (
            parse_json(cells[kind], kind, LabelFileError, "attributes") for kind in cells
        )
        yield from _via_region(row.get("filename") or row["#filename"], shape, attributes)


class _Element(NamedTuple):
    name: str
    path: str
    attributes: Mapping[str, str]
    text: list[str]  # one text, known when the element ends


def _voc(content: Any) -> Iterator[_Box]:
    image, size = "", dict[str, str]()
    objects = list[dict[str, str]]()
    for element in content:
        if element.path == "annotation/filename":
            image = element.text[0]
        elif element.path.startswith("annotation/size/"):
            size[element.name] = element.text[0]
        elif element.path == "annotation/object":
            objects.append({})
        elif element.path.startswith("annotation/object/") and objects:
            objects[-1].setdefault(element.path.removeprefix("annotation/object/"), element.text[0])
    for item in objects:
        edges = [float(item[f"bndbox/{name}"]) for name in ("xmin", "ymin", "xmax", "ymax")]
        identity = item.get("track_id")
        yield _Box(
            image, item["name"], edges, identity, size_px=(size.get("width"), size.get("height"))
        )


def _detrac(content: Any) -> Iterator[_Box]:
    regions, frames, frame, target, edges = [], [], 0, None, None
    for element in content:
        if element.name == "frame":
            frame = int(element.attributes["num"]) - 1
            frames.append(frame)
        elif element.name == "target":
            target = element.attributes["id"]
        elif element.name == "box":
            left, top, width, height = (
                float(element.attributes[key]) for key in ("left", "top", "width", "height")
            )
            edges = [left, top, left + width, top + height]
            if element.path == "sequence/ignored_region/box":
                regions.append(edges)
        elif element.name == "attribute" and edges is not None:
            yield _Box(frame, element.attributes.get("vehicle_type", "vehicle"), edges, target)
    if len(regions) * len(frames) > _MAX_BOXES:
        raise ValueError("regions")
    yield from (
        _Box(number_of, "dontcare", edges, None, None, True)
        for number_of in frames
        for edges in regions
    )


class Layout(NamedTuple):
    """A layout: its title, the marks of its files in their first 64 kB, and a function that lists
    the boxes.
    """

    title: str
    mark: re.Pattern[str]
    boxes: Callable[[Any], Iterator[_Box]]
    is_folder: bool = False  # whether a folder with one file for each image is read, too


def _mark(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern, re.DOTALL)


LAYOUTS: Mapping[str, Layout] = {
    "createml": Layout("CreateML", _mark(r'^\s*\[.*"coordinates"\s*:'), _createml),
    "bdd100k": Layout("BDD100K", _mark(r'^\s*[\[{].*"(box2d|frameIndex|videoName)"\s*:'), _bdd100k),
    "labelme": Layout("LabelMe", _mark(r'^\s*\{.*"(shape_type|shapes)"\s*:'), _labelme, True),
    "labelstudio": Layout(
        "Label Studio",
        _mark(r'^\s*[\[{].*"(rectanglelabels|videorectangle|original_width)"'),
        _label_studio,
    ),
    "via": Layout("VIA", _mark(r'^\s*\{.*"(shape_attributes|_via_img_metadata)"\s*:'), _via),
    "supervisely": Layout(
        "Supervisely", _mark(r'^\s*\{.*"(classTitle|objectKey|objectId)"\s*:'), _supervisely, True
    ),
    "supervision": Layout(
        "supervision", _mark(r'^\s*\[\s*\{[^}]{0,2000}"x_min"\s*:|^"?x_min"?,"?y_min'), _supervision
    ),
    "csv_filename": Layout(
        "CSV of Roboflow", _mark(r"^[^\n]{0,300}\bfilename\b[^\n]{0,300}\bxmin\b"), _filename_rows
    ),
    "via_csv": Layout(
        "CSV of VIA", _mark(r"^#?filename,[^\n]{0,300}region_shape_attributes"), _via_rows
    ),
    "voc": Layout("Pascal VOC", _mark(r"^\s*<(\?xml[^>]*>\s*<)?annotation[\s>]"), _voc, True),
    "detrac": Layout("UA-DETRAC", _mark(r"^\s*<(\?xml[^>]*>\s*<)?sequence[\s>]"), _detrac),
}
"""Layouts by name; their order has no meaning, since at most one layout fits a file."""


def _read(path: Path, layout: Layout, video: VideoFacts) -> BoxTable:
    is_folder = path.is_dir()
    files = label_files(path) if is_folder else [path]
    if len(files) > _MAX_FILES:
        raise LabelFileError(f"{path}: expected at most {_MAX_FILES} files, found {len(files)}.")
    boxes: list[_Box] = []
    for file in files:
        for box in _boxes_in(file, layout, path, is_folder=is_folder):
            boxes.append(box)
            if len(boxes) > _MAX_BOXES:
                raise LabelFileError(f"{path}: expected at most {_MAX_BOXES} boxes, found more.")
    images = dict.fromkeys(box.image for box in boxes)
    if is_folder and all(isinstance(image, str) for image in images):
        images = dict.fromkeys(file.name for file in files)  # also those without boxes
    frame_of, notes = _frames(path, list(images), video)
    edges = np.array([box.edges for box in boxes], np.float64).reshape(-1, 4)
    if not (np.abs(edges) <= MAX_COORDINATE_PX).all():
        raise LabelFileError(
            f"{path}: expected box coordinates of at most {MAX_COORDINATE_PX:g} pixels, found "
            "larger or invalid values."
        )
    is_box = (edges[:, 2:] > edges[:, :2]).all(axis=1)
    kept = [boxes[row] for row in np.flatnonzero(is_box).tolist()]
    sizes = {size for box in boxes if (size := _size_px(box.size_px)) is not None}
    facts = VideoFacts(size_px=next(iter(sizes)) if len(sizes) == 1 else None)
    n_empty = len(boxes) - len(kept)
    table = BoxTable.of(
        [frame_of[box.image] for box in kept],
        _identities([box.identity for box in kept]),
        [box.label for box in kept],
        edges[is_box] - HALF_PIXEL_PX,
        is_region=np.array([box.is_region for box in kept], np.bool_),
        score=[_number(box.score) for box in kept],
        video=video.completed_by(facts, path),
        notes=(*notes, *table_checks.ignored_note(path, n_empty, "without width or height")),
    )
    table_checks.check_identities(table, path)
    return table


def _boxes_in(file: Path, layout: Layout, path: Path, *, is_folder: bool) -> Iterator[_Box]:
    """The boxes of a file of labels at `path`, each with an image; raises LabelFileError."""
    try:
        for box in layout.boxes(_content(file, layout.title)):
            # a file has the name of its image; tools may repeat a wrong name in the file
            is_of_file = box.image == "" or (is_folder and isinstance(box.image, str))
            image = file.name if is_of_file else box.image
            if not isinstance(image, int | str) or isinstance(image, bool):
                raise TypeError(type(image).__name__)
            yield box._replace(image=image, label=str(box.label)[:_MAX_TEXT])
    except LabelFileError as error:
        text = str(error)
        raise LabelFileError(text if str(path) in text else f"{file}: {text}.") from error
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        TypeError,
        ValueError,
        StopIteration,
        RuntimeError,
    ) as error:
        raise LabelFileError(
            f"{file}: expected labels of {layout.title}, found other content ({quoted(error)})."
        ) from error


def _content(file: Path, title: str) -> Any:
    """The content of a file: plain values of JSON, rows of a CSV by name of the column, or elements
    of XML.
    """
    with (
        open_regular(file, LabelFileError, f"labels of {title}") as opened,
        readable(file, LabelFileError),
    ):
        first = opened.read(START_BYTES).decode("utf-8-sig", errors="replace").lstrip()[:1]
    if first in ("{", "["):
        return read_json(file, LabelFileError, f"labels of {title}", max_bytes=_MAX_BYTES)
    if first == "<":
        elements = _Elements()
        with open_regular(
            file, LabelFileError, f"labels of {title}", max_bytes=_MAX_BYTES
        ) as opened:
            parse_xml(opened, file, elements, LabelFileError, f"labels of {title}")
        return elements.elements
    table = read_csv_table(file, LabelFileError, f"labels of {title}")
    return [dict(zip(table.header, row, strict=False)) for row in table.rows]


class _Elements:
    """Receiver of the elements of a file (`xml_events.XmlHandler`)."""

    def __init__(self) -> None:
        self.elements: list[_Element] = []
        self._open: list[_Element] = []

    def start(self, path: list[str], attributes: Mapping[str, str], line: int) -> None:
        if len(self.elements) > 10 * _MAX_BOXES:
            raise LabelFileError(
                f"expected at most {10 * _MAX_BOXES} elements, found more in line {line}"
            )
        element = _Element(path[-1], "/".join(path), dict(attributes), [""])
        self.elements.append(element)
        self._open.append(element)

    def end(self, path: list[str], text: str, line: int) -> None:
        self._open.pop().text[0] = text.strip()


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


def _size_px(size: tuple[object, object] | None) -> tuple[int, int] | None:
    sides = [_number(side) for side in size or ()]
    is_size = len(sides) == 2 and all(
        math.isfinite(side) and 1 <= side <= MAX_SIDE_PX for side in sides
    )
    return (int(sides[0]), int(sides[1])) if is_size else None


def _format(name: str, layout: Layout) -> LabelFormat:
    def recognises(start: LabelStart) -> bool:
        is_possible = layout.is_folder or not start.is_folder
        return is_possible and layout.mark.match(start.text) is not None

    return LabelFormat(
        name=name,
        title=layout.title,
        recognises=recognises,
        read=lambda path, video: _read(path, layout, video),
        is_general=True,
        is_folder=layout.is_folder,
    )


FORMATS = tuple(_format(name, layout) for name, layout in LAYOUTS.items())
