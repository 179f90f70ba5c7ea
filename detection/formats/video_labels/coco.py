"""Reader and writer of COCO data sets with the images of one video.

    videos       [{id, name, width, height, fps}]                   as in COCO-VID and TAO; optional when reading
    images       [{id, file_name, width, height, video_id, frame_index}]
    annotations  [{id, image_id, category_id, bbox: [x, y, w, h], area, segmentation, iscrowd, track_id, score,
                   attributes}]
    categories   [{id, name}]

Ids count from 1, `frame_index` from 0. `bbox` has the corner convention: the left edge of the image is 0, so
coordinates are 0.5 px larger than with pixel centres at integers. `attributes` has distance_m, sigma_m and predicted.
`iscrowd` marks regions of many objects, which are not evaluated. When reading, the identity is `track_id` or
`instance_id`, also in `attributes` (as CVAT writes it); the frame number is `frame_index`, `frame_id`, or the last
number in `file_name`. Attributes may be texts, as CVAT writes attributes of the input type text. Boxes with a true
attribute outside are left out. (Lin et al., "Microsoft COCO", ECCV 2014, and https://cocodataset.org/#format-data; Dave
et al., "TAO", ECCV 2020, for videos.)
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from track_range.detection.boxes import HALF_PIXEL_PX
from track_range.detection.formats.tables import table_checks
from track_range.detection.formats.tables.box_table import (
    BoxTable,
    VideoFacts,
    Written,
    frames_listed,
    image_name,
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
from track_range.detection.formats.video_labels.json_kinds import kind_of_json
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.numeric_text import number
from track_range.foundation.files.structured_text import read_json

# about 1.2 million boxes, which take 2.5 GB of memory while they are read
MAX_COCO_BYTES = 250_000_000
_DECIMALS, _SCORE_DECIMALS = 3, 4  # of pixels and metres, and of scores, in written files
_FRAME_KEYS = ("frame_index", "frame_id")
_IDENTITY_KEYS = ("track_id", "instance_id")
_MAX_PATH, _MAX_TEXT = 4096, 200  # characters of the path of an image, and of a name
_MAX_FPS = 10_000.0

_Object = Mapping[str, Any]  # an object of the file


class CocoBox(NamedTuple):
    """One annotation: `frame` is the number of its image, `xyxy` has the corner convention."""

    frame: int
    track_id: int
    class_name: str
    xyxy: tuple[float, ...]
    is_region: bool
    score: float
    observed: bool
    distance_m: float
    sigma_m: float


def read_coco(path: Path, video: VideoFacts) -> BoxTable:
    """The boxes of a COCO data set of one video; boxes without width or height are ignored with a
    note.

    LabelFileError: the file cannot be read, is larger than `MAX_COCO_BYTES`, has several videos,
    contradictory or unknown ids, annotations without a box, or implausible numbers.
    """
    coco = CocoFile(path)
    frame_of, notes = coco.frames()
    boxes, n_empty = coco.boxes(frame_of)
    columns: dict[str, Any] = {key: [getattr(box, key) for box in boxes] for key in CocoBox._fields}
    xyxy = np.array(columns.pop("xyxy"), np.float64).reshape(-1, 4)
    if boxes and xyxy.max() <= 1:
        raise LabelFileError(
            f"{path}: expected each bbox in pixels, found only fractions of the image size."
        )
    facts = video.completed_by(coco.video_facts(frame_of), path)
    notes = (*notes, *table_checks.ignored_note(path, n_empty, "without width or height"))
    table = BoxTable.of(**columns, xyxy_px=xyxy - HALF_PIXEL_PX, video=facts, notes=notes)
    table_checks.check_identities(table, path)
    return table


class CocoFile:
    """The objects of one file, checked when read, and `images` by id, in its order; methods raise
    LabelFileError.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._document = read_json(
            path, LabelFileError, "a COCO data set", max_bytes=MAX_COCO_BYTES
        )
        self._names: dict[int | str, str] = {}  # by category id
        self._identities: dict[str, int] = {}  # by the names of objects
        self._has_numbers = False  # whether objects have numbers instead
        for where, category in self._section("categories"):
            number, name = self._id(category, "id", where), self._text(category, "name", where)
            if (other := self._names.setdefault(number, name)) != name:
                raise LabelFileError(
                    f"{path}, {where}: expected one name for each category id, found "
                    f"{quoted(other)} and {quoted(name)} for the id {quoted(number)}."
                )
        self.images: dict[int | str, _Object] = {}
        for where, image in self._section("images"):
            number = self._id(image, "id", where)
            if self.images.setdefault(number, image) is not image:
                raise LabelFileError(
                    f"{path}, {where}: expected each image id once, found {quoted(number)} twice."
                )

    def _section(self, key: str) -> Iterator[tuple[str, dict[str, Any]]]:
        """The objects of a list of the file, each with its place for messages."""
        if kind := kind_of_json(self._document):
            raise LabelFileError(
                f"{self.path}: expected a COCO data set with images, annotations and categories, "
                f"found {kind}."
            )
        values = self._document.get(key) if isinstance(self._document, dict) else None
        if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
            raise LabelFileError(
                f"{self.path}: expected a COCO data set with a list of {key}, found none."
            )
        return ((f"{key}[{index}]", value) for index, value in enumerate(values))

    def file_name(self, image: _Object, index: int) -> str:
        """Path of the image with an index."""
        return self._text(image, "file_name", f"images[{index}]")

    def frames(self) -> tuple[dict[int | str, int], tuple[str, ...]]:
        """Frame number by image id, and notes for the user."""
        images = self.images
        for name in ("video_id", "video"):
            table_checks.check_one_video((image.get(name) for image in images.values()), self.path)
        key = next(
            (key for key in _FRAME_KEYS if any(key in image for image in images.values())), None
        )
        if key is None:
            names = [self.file_name(image, index) for index, image in enumerate(images.values())]
            frames, source = table_checks.frames_of_names(names, self.path)
        else:
            frames = [
                self._integer(image, key, f"images[{index}]", 0, MAX_FRAME)
                for index, image in enumerate(images.values())
            ]
        frame_of = dict(zip(images, frames, strict=True))
        numbers = sorted(frames)
        notes = list(
            table_checks.first_frame_note(self.path, numbers[0] if numbers else 0, len(numbers))
        )
        if numbers and key is None:
            span = f"{numbers[0]} to {numbers[-1]}"
            notes.insert(
                0,
                f"{self.path.name}: frame numbers are the {source} in the names of the "
                f"images, {span}.",
            )
        for frame, after in pairwise(numbers):
            if frame == after:
                raise LabelFileError(
                    f"{self.path}: expected one image of one camera for each frame, found two for "
                    f"frame {frame}."
                )
        return frame_of, tuple(notes)

    def video_facts(self, frame_of: Mapping[int | str, int]) -> VideoFacts:
        """Name, number of frames, image size and frame rate of the video."""
        sizes = {
            tuple(
                self._integer(image, key, f"images[{index}]", 1, MAX_SIDE_PX)
                for key in ("width", "height")
            )
            for index, image in enumerate(self.images.values())
            # some programs write 0 for an unknown size
            if image.get("width") and image.get("height")
        }
        width, height = next(iter(sizes)) if len(sizes) == 1 else (0, 0)
        videos, info = self._document.get("videos"), self._document.get("info")
        first = (
            videos[0] if isinstance(videos, list) and videos and isinstance(videos[0], dict) else {}
        )
        fps = first.get("fps")
        return VideoFacts(
            name=str(first.get("name") or "")[:_MAX_TEXT],
            n_frames=max(frame_of.values()) + 1 if frame_of else None,
            first_frame=min(frame_of.values(), default=0),
            size_px=(width, height) if width else None,
            fps=None if fps is None else self._in_range(fps, "fps", "videos[0]", 0.001, _MAX_FPS),
            is_rectified=isinstance(info, dict) and info.get("pixels") == "rectified",
        )

    def boxes(self, frame_of: Mapping[int | str, int]) -> tuple[list[CocoBox], int]:
        """All annotations with width and height, and how many have neither; `frame_of` has the
        frame by image id.
        """
        boxes, n_empty = [], 0
        for where, item in self._section("annotations"):
            image, category = (
                self._id(item, "image_id", where),
                self._id(item, "category_id", where),
            )
            if image not in frame_of:
                raise self._fault(where, "the id of one of the images as image_id", image)
            if category not in self._names:
                raise self._fault(where, "the id of one of the categories as category_id", category)
            x, y, width, height = self._bbox(item, where)
            if width <= 0 or height <= 0:
                n_empty += 1
                continue
            attributes = item.get("attributes")
            both: dict[str, Any] = {**attributes, **item} if isinstance(attributes, dict) else item
            if both.get("outside") is True:
                continue
            table_checks.check_upright(both.get("rotation"), f"{self.path}, {where}")
            given = [
                (source, key)
                for source in (item, both)
                for key in _IDENTITY_KEYS
                if source.get(key) is not None
            ]
            boxes.append(
                CocoBox(
                    frame_of[image],
                    self._identity(*given[0], where) if given else -1,
                    self._names[category],
                    (x, y, x + width, y + height),
                    1 in (item.get("iscrowd"), both.get("ignore")),  # True is 1
                    self._attribute(both, "score", where, -1e6, 1e6),
                    str(both.get("predicted")).lower() != "true",
                    self._attribute(both, "distance_m", where, 0.0, MAX_DISTANCE_M),
                    self._attribute(both, "sigma_m", where, 0.0, MAX_DISTANCE_M),
                )
            )
        return boxes, n_empty

    def _fault(self, where: str, expected: str, value: object) -> LabelFileError:
        shown = "none" if value is None else quoted(value)
        return LabelFileError(f"{self.path}, {where}: expected {expected}, found {shown}.")

    def _integer(self, item: _Object, key: str, where: str, low: int, high: int) -> int:
        value = item.get(key)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self._fault(where, f"an integer from {low} to {high} as {key}", value)
        return value

    def _identity(self, item: _Object, key: str, where: str) -> int:
        """The number of an object; if ids are names, as Waymo's are, the number of the first
        occurrence of the name.
        """
        name = item[key]
        is_named = isinstance(name, str) and 0 < len(name) <= _MAX_TEXT
        if is_named and not self._has_numbers:
            return self._identities.setdefault(name, len(self._identities))
        self._has_numbers = True
        if self._identities:
            raise self._fault(where, f"a text as {key}, as in the earlier objects", name)
        return self._integer(item, key, where, -1, MAX_ID)

    def _id(self, item: _Object, key: str, where: str) -> int | str:
        value = item.get(key)
        if isinstance(value, bool) or not isinstance(value, int | str):
            raise self._fault(where, f"an integer as {key}", value)
        return value

    def _text(self, item: _Object, key: str, where: str) -> str:
        value = item.get(key)
        limit = _MAX_PATH if key == "file_name" else _MAX_TEXT
        if not isinstance(value, str) or not 0 < len(value.strip()) <= limit:
            raise self._fault(where, f"a text of at most {limit} characters as {key}", value)
        return value.strip()

    def _attribute(self, item: _Object, key: str, where: str, low: float, high: float) -> float:
        """A number, given as a number or a text; NaN if the value is missing, null or empty."""
        value = item.get(key)
        if isinstance(value, str):
            value = number(value) if value.strip() else None
        return math.nan if value is None else self._in_range(value, key, where, low, high)

    def _in_range(self, value: object, key: str, where: str, low: float, high: float) -> float:
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not low <= value <= high
        ):
            raise self._fault(where, f"a number from {low:g} to {high:g} as {key}", value)
        return float(value)

    def _bbox(self, item: _Object, where: str) -> tuple[float, ...]:
        bbox: Any = item.get("bbox")
        if bbox is None and item.get("segmentation"):
            shape = "an RLE mask" if isinstance(item["segmentation"], dict) else "a polygon"
            raise LabelFileError(
                f"{self.path}, {where}: expected a bbox, found only {shape}; export boxes."
            )
        is_box = isinstance(bbox, list) and len(bbox) == 4
        is_box = is_box and not any(
            isinstance(v, bool) or not isinstance(v, int | float) for v in bbox
        )
        if not is_box or max(map(abs, bbox)) > MAX_COORDINATE_PX or min(bbox[2:]) < 0:
            raise self._fault(
                where, f"a bbox of four numbers x, y, w, h up to {MAX_COORDINATE_PX:g}", bbox
            )
        return tuple(map(float, bbox))


def write_coco(table: BoxTable, path: Path) -> Written:
    """Write a table as a COCO data set, with all frames of the video as images."""
    video = table.video
    width, height = video.size_px or (None, None)
    info = {
        "description": "Road users tracked by track-range",
        "version": "1",
        "pixels": video.pixels,
    }
    facts = _known(
        {"id": 1, "name": video.name or "video", "width": width, "height": height, "fps": video.fps}
    )
    category_ids = {name: number for number, name in enumerate(table.all_labels, start=1)}
    categories = ({"id": number, "name": name} for name, number in category_ids.items())
    images = (
        _known(
            {
                "id": frame + 1,
                "file_name": image_name(video, frame),
                "width": width,
                "height": height,
            }
        )
        | {"video_id": 1, "frame_index": frame}
        for frame in frames_listed(table)
    )
    lists = {
        "categories": categories,
        "images": images,
        "annotations": _annotations(table, category_ids),
    }
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(
            f'{{\n"info": {_json(info | dict(video.provenance))},\n"licenses": '
            f'[],\n"videos": [{_json(facts)}]'
        )
        for key, items in lists.items():
            file.write(f',\n"{key}": [\n')
            file.writelines(_lines(items))
            file.write("]")
        file.write("\n}\n")
    return Written(len(table))


def _known(values: _Object) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _annotations(table: BoxTable, category_ids: Mapping[str, int]) -> Iterator[dict[str, Any]]:
    edges, is_region, labels = (
        np.round(table.xyxy_px + HALF_PIXEL_PX, _DECIMALS),
        table.is_region,
        table.label,
    )
    for row in range(len(table)):
        x, y, right, bottom = edges[row].tolist()
        width, height = round(right - x, _DECIMALS), round(bottom - y, _DECIMALS)
        track_id, score = int(table.track_id[row]), float(table.score[row])
        measured = {
            "distance_m": float(table.distance_m[row]),
            "sigma_m": float(table.sigma_m[row]),
        }
        attributes: dict[str, Any] = {
            key: round(m, _DECIMALS) for key, m in measured.items() if math.isfinite(m)
        }
        yield {
            "id": row + 1,
            "image_id": int(table.frame[row]) + 1,
            "category_id": category_ids[labels[row]],
            "bbox": [x, y, width, height],
            "area": round(width * height, _DECIMALS),
            "segmentation": [],
            "iscrowd": int(is_region[row]),
            **({"track_id": track_id} if track_id >= 0 else {}),
            **({"score": round(score, _SCORE_DECIMALS)} if math.isfinite(score) else {}),
            "attributes": attributes | ({} if table.observed[row] else {"predicted": True}),
        }


def _lines(items: Iterable[_Object]) -> Iterator[str]:
    """One line of JSON for each object, separated by commas."""
    before = ""
    for item in items:
        yield before + _json(item)
        before = ",\n"
    yield "\n" if before else ""


def _json(value: object) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


COCO = LabelFormat(
    name="coco",
    title="COCO",
    recognises=lambda start: start.first.startswith(("{", "[")),
    priority=-10,  # any JSON
    read=read_coco,
    write=write_coco,
    precision_px=0.0005,
)
