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
number in `file_name`. Attributes may be texts: CVAT writes those of input type text so. Boxes with a true attribute
outside are left out. (Lin et al., "Microsoft COCO", ECCV 2014, and https://cocodataset.org/#format-data; Dave et al.,
"TAO", ECCV 2020, for videos.)
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.box_table import (
    HALF_PIXEL_PX,
    BoxTable,
    VideoFacts,
    Written,
    file_name_part,
    frames_listed,
)
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.limits import MAX_COORDINATE_PX, MAX_DISTANCE_M, MAX_FRAME, MAX_ID
from track_range.detection.formats.table_checks import (
    check_identities,
    check_names,
    first_frame_note,
    frame_in_name,
    ignored_note,
)
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.numeric_text import number
from track_range.foundation.files.structured_text import read_json

MAX_COCO_BYTES = 250_000_000
"""Size limit, bytes: about 1.2 million boxes, which take 2.5 GB of memory while they are read."""

_DECIMALS = 3
"""Decimals of pixels and metres in written files."""

_SCORE_DECIMALS = 4

_FRAME_KEYS = ("frame_index", "frame_id")
_IDENTITY_KEYS = ("track_id", "instance_id")

_MAX_PATH = 4096
"""Largest number of characters of the path of an image."""

_MAX_TEXT = 200
"""Largest number of characters of a name."""

_MAX_SIDE_PX = 65_535
"""Largest width or height of an image."""

_MAX_FPS = 10_000.0


@dataclass(slots=True)
class CocoRows:
    """Columns of the annotations, with `xyxy` in the corner convention and `frame` the number of the image.

    Annotations without width or height are left out; `n_empty` counts them.
    """

    frame: list[int] = field(default_factory=list)
    track_id: list[int] = field(default_factory=list)
    class_name: list[str] = field(default_factory=list)
    xyxy: list[tuple[float, ...]] = field(default_factory=list)
    is_region: list[bool] = field(default_factory=list)
    score: list[float] = field(default_factory=list)
    observed: list[bool] = field(default_factory=list)
    distance_m: list[float] = field(default_factory=list)
    sigma_m: list[float] = field(default_factory=list)
    n_empty: int = 0


def read_coco(path: Path, video: VideoFacts) -> BoxTable:
    """The boxes of a COCO data set of one video; boxes without width or height are ignored with a note.

    Raises:
        LabelFileError: the file cannot be read, is larger than `MAX_COCO_BYTES`, has several videos, contradictory or
            unknown ids, annotations without a box, or implausible numbers.
    """
    reader = CocoFile.read(path)
    names = reader.category_names()
    frame_of, notes = reader.frames()
    rows = reader.rows(frame_of, names)
    if rows.xyxy and np.max(rows.xyxy) <= 1:
        raise LabelFileError(f"{path}: expected each bbox in pixels, found only fractions of the image size.")
    table = BoxTable.of(
        rows.frame,
        rows.track_id,
        rows.class_name,
        np.array(rows.xyxy, np.float64).reshape(-1, 4) - HALF_PIXEL_PX,
        is_region=rows.is_region,
        score=rows.score,
        observed=rows.observed,
        distance_m=rows.distance_m,
        sigma_m=rows.sigma_m,
        video=reader.video_facts(frame_of, video),
        notes=(*notes, *ignored_note(path, rows.n_empty, "without width or height")),
    )
    check_identities(table, path)
    return table


@dataclass(frozen=True, slots=True)
class CocoFile:
    """Sections of one file, which are checked when they are read."""

    path: Path
    document: Any

    @classmethod
    def read(cls, path: Path) -> CocoFile:
        """The content of a file.

        Raises:
            LabelFileError: the file cannot be read, is larger than `MAX_COCO_BYTES`, or is not JSON.
        """
        return cls(path, read_json(path, LabelFileError, "a COCO data set", max_bytes=MAX_COCO_BYTES))

    def section(self, key: str) -> list[dict[str, Any]]:
        """The objects of a list at the top of the file.

        Raises:
            LabelFileError: there is no such list, or it has other values.
        """
        if isinstance(self.document, list):
            raise LabelFileError(
                f"{self.path}: expected a COCO data set with images, annotations and categories, found a list, as of "
                "detection results; add its boxes to a data set."
            )
        values = self.document.get(key) if isinstance(self.document, dict) else None
        if not isinstance(values, list) or not all(isinstance(value, dict) for value in values):
            raise LabelFileError(f"{self.path}: expected a COCO data set with a list of {key}, found none.")
        return values

    def fault(self, where: str, expected: str, value: object) -> LabelFileError:
        """An exception about a value, that the caller raises."""
        text = "none" if value is None else quoted(value)
        return LabelFileError(f"{self.path}, {where}: expected {expected}, found {text}.")

    def integer(self, item: Mapping[str, Any], key: str, where: str, low: int, high: int) -> int:
        """An integer of an object; raises LabelFileError if it is missing or out of range."""
        value = item.get(key)
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self.fault(where, f"an integer from {low} to {high} as {key}", value)
        return value

    def key(self, item: Mapping[str, Any], name: str, where: str) -> int | str:
        """An id, an integer or a text."""
        value = item.get(name)
        if isinstance(value, bool) or not isinstance(value, int | str):
            raise self.fault(where, f"an integer as {name}", value)
        return value

    def text(self, item: Mapping[str, Any], key: str, where: str) -> str:
        """A text of an object."""
        value = item.get(key)
        limit = _MAX_PATH if key == "file_name" else _MAX_TEXT
        if not isinstance(value, str) or not 0 < len(value.strip()) <= limit:
            raise self.fault(where, f"a text of at most {limit} characters as {key}", value)
        return value.strip()

    def number(self, item: Mapping[str, Any], key: str, where: str, low: float, high: float) -> float:
        """A number of an object; NaN if it is missing or null."""
        value = item.get(key)
        return math.nan if value is None else self._in_range(value, key, where, low, high)

    def attribute(self, item: Mapping[str, Any], key: str, where: str, low: float, high: float) -> float:
        """A number of an object with its attributes, which may be a text; NaN if it is missing, null or empty."""
        value = item.get(key)
        if isinstance(value, str):
            value = number(value) if value.strip() else None
        return math.nan if value is None else self._in_range(value, key, where, low, high)

    def _in_range(self, value: object, key: str, where: str, low: float, high: float) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise self.fault(where, f"a number from {low:g} to {high:g} as {key}", value)
        return float(value)

    def category_names(self) -> dict[int | str, str]:
        """Name by category id.

        Raises:
            LabelFileError: an id has two names.
        """
        names: dict[int | str, str] = {}
        for index, category in enumerate(self.section("categories")):
            where = f"categories[{index}]"
            number, name = self.key(category, "id", where), self.text(category, "name", where)
            if names.setdefault(number, name) != name:
                raise LabelFileError(
                    f"{self.path}, {where}: expected one name for each category id, found {quoted(names[number])} and "
                    f"{quoted(name)} for the id {quoted(number)}."
                )
        return names

    def images(self) -> dict[int | str, dict[str, Any]]:
        """Images by id, in the order of the file.

        Raises:
            LabelFileError: an id occurs twice, or is not an id.
        """
        images: dict[int | str, dict[str, Any]] = {}
        for index, image in enumerate(self.section("images")):
            where = f"images[{index}]"
            number = self.key(image, "id", where)
            if images.setdefault(number, image) is not image:
                raise LabelFileError(
                    f"{self.path}, {where}: expected each image id once, found {quoted(number)} twice."
                )
        return images

    def frames(self) -> tuple[dict[int | str, int], tuple[str, ...]]:
        """Frame number by image id, and notes for the user.

        Raises:
            LabelFileError: an image id or a frame occurs twice, there are several videos, or no frame numbers.
        """
        images, notes = self.images(), []
        self._check_one_video(list(images.values()))
        key = next((key for key in _FRAME_KEYS if any(key in image for image in images.values())), None)
        frame_of = {
            number: self._number_in_name(image, f"images[{index}]")
            if key is None
            else self.integer(image, key, f"images[{index}]", 0, MAX_FRAME)
            for index, (number, image) in enumerate(images.items())
        }
        if key is None:
            check_names((str(Path(image["file_name"]).with_suffix("")) for image in images.values()), self.path)
        numbers = sorted(frame_of.values())
        for frame, after in pairwise(numbers):
            if frame == after:
                raise LabelFileError(f"{self.path}: expected one image for each frame, found two for frame {frame}.")
        if numbers and key is None:
            notes.append(
                f"{self.path.name}: frame numbers are the numbers in the names of the images, {numbers[0]} to "
                f"{numbers[-1]}."
            )
        return frame_of, (*notes, *first_frame_note(self.path, numbers[0] if numbers else 0, len(numbers)))

    def _check_one_video(self, images: list[dict[str, Any]]) -> None:
        ids = {self.key(image, "video_id", "images") for image in images if image.get("video_id") is not None}
        if len(ids) > 1:
            raise LabelFileError(
                f"{self.path}: expected the images of one video, found {len(ids)} videos; split the file."
            )

    def _number_in_name(self, image: Mapping[str, Any], where: str) -> int:
        name = self.text(image, "file_name", where)
        frame = frame_in_name(Path(name).stem)
        if frame is None:
            raise self.fault(where, "a frame_index, or a file_name with a frame number", name)
        return frame

    def video_facts(self, frame_of: Mapping[int | str, int], video: VideoFacts) -> VideoFacts:
        """Name, number of frames, image size and frame rate; those of `video` where the file states none.

        Raises:
            LabelFileError: the images of the file have another size than the video.
        """
        images = self.section("images")
        sizes = {
            (
                self.integer(image, "width", where, 1, _MAX_SIDE_PX),
                self.integer(image, "height", where, 1, _MAX_SIDE_PX),
            )
            for image, where in ((image, f"images[{index}]") for index, image in enumerate(images))
            if image.get("width") and image.get("height")  # some programs write 0 for an unknown size
        }
        size_px = next(iter(sizes)) if len(sizes) == 1 else None
        if size_px is not None and video.size_px not in (None, size_px):
            raise LabelFileError(
                f"{self.path}: expected boxes in images of {_size(video.size_px)} px as in the video, found "
                f"{_size(size_px)} px."
            )
        described = self.document.get("videos")
        first = described[0] if isinstance(described, list) and described and isinstance(described[0], dict) else {}
        fps = self.number(first, "fps", "videos[0]", 0.001, _MAX_FPS)
        info = self.document.get("info")
        is_rectified = isinstance(info, dict) and info.get("pixels") == "rectified"
        return replace(
            video,
            name=video.name or str(first.get("name") or "")[:_MAX_TEXT],
            n_frames=video.n_frames or (max(frame_of.values()) + 1 if frame_of else None),
            first_frame=min(frame_of.values(), default=0),
            size_px=video.size_px or size_px,
            fps=video.fps or (None if math.isnan(fps) else fps),
            is_rectified=video.is_rectified or is_rectified,
        )

    def rows(self, frame_of: Mapping[int | str, int], names: Mapping[int | str, str]) -> CocoRows:
        """Columns of all annotations.

        Args:
            frame_of: number by image id.
            names: name by category id.

        Raises:
            LabelFileError: an annotation is invalid, or refers to an unknown image or category.
        """
        rows = CocoRows()
        for index, item in enumerate(self.section("annotations")):
            where = f"annotations[{index}]"
            image, category = self.key(item, "image_id", where), self.key(item, "category_id", where)
            if image not in frame_of:
                raise self.fault(where, "the id of one of the images as image_id", image)
            if category not in names:
                raise self.fault(where, "the id of one of the categories as category_id", category)
            x, y, width, height = self._bbox(item, where)
            if width <= 0 or height <= 0:
                rows.n_empty += 1
                continue
            attributes = item.get("attributes")
            both = attributes | item if isinstance(attributes, dict) else item
            if both.get("outside") is True:
                continue
            rows.frame.append(frame_of[image])
            rows.track_id.append(self._identity(item, both, where))
            rows.class_name.append(names[category])
            rows.xyxy.append((x, y, x + width, y + height))
            rows.is_region.append(item.get("iscrowd") in (1, True))
            rows.score.append(self.attribute(both, "score", where, -1e6, 1e6))
            rows.observed.append(str(both.get("predicted")).lower() != "true")
            rows.distance_m.append(self.attribute(both, "distance_m", where, 0.0, MAX_DISTANCE_M))
            rows.sigma_m.append(self.attribute(both, "sigma_m", where, 0.0, MAX_DISTANCE_M))
        return rows

    def _identity(self, item: Mapping[str, Any], both: Mapping[str, Any], where: str) -> int:
        """The identity of an annotation; -1 = none."""
        for source in (item, both):
            for key in _IDENTITY_KEYS:
                if source.get(key) is not None:
                    return self.integer(source, key, where, -1, MAX_ID)
        return -1

    def _bbox(self, item: Mapping[str, Any], where: str) -> tuple[float, ...]:
        bbox = item.get("bbox")
        if bbox is None and item.get("segmentation"):
            kind = "an RLE mask" if isinstance(item["segmentation"], dict) else "a polygon"
            raise LabelFileError(f"{self.path}, {where}: expected a bbox, found only {kind}; export boxes.")
        if not isinstance(bbox, list) or len(bbox) != 4 or not all(map(_is_coordinate, bbox)) or min(bbox[2:]) < 0:
            raise self.fault(where, f"a bbox of four numbers x, y, w, h up to {MAX_COORDINATE_PX:g}", bbox)
        return tuple(map(float, bbox))


def _is_coordinate(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= MAX_COORDINATE_PX


def _size(size_px: tuple[int, ...] | None) -> str:
    return "x".join(map(str, size_px or ()))


def write_coco(table: BoxTable, path: Path) -> Written:
    """Write a table as a COCO data set, with all frames of the video as images.

    Raises:
        OSError: the file cannot be written.
    """
    categories = _categories(table)
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("{\n")
        file.write(f'"info": {_json(_info(table.video))},\n"licenses": [],\n')
        file.write(f'"videos": [{_json(_video(table.video))}],\n"categories": [\n')
        file.writelines(_lines({"id": number, "name": name} for name, number in categories.items()))
        file.write('],\n"images": [\n')
        file.writelines(_lines(_image(table.video, frame) for frame in frames_listed(table)))
        file.write('],\n"annotations": [\n')
        file.writelines(_lines(_annotations(table, categories)))
        file.write("]\n}\n")
    return Written(len(table))


def image_name(video: VideoFacts, frame: int) -> str:
    """File name of a frame's image, also for the images of other formats: NAME_000000.jpg, without a folder."""
    return f"{file_name_part(video.name) or 'frame'}_{frame:06}.jpg"


def _categories(table: BoxTable) -> dict[str, int]:
    """Category id by name: the road classes, then other names of the table."""
    names = dict.fromkeys((*ROAD_CLASSES, *sorted({str(name) or "object" for name in table.class_name})))
    return {name: number for number, name in enumerate(names, start=1)}


def _info(video: VideoFacts) -> dict[str, Any]:
    pixels = "rectified" if video.is_rectified else "original"
    return {"description": "Road users tracked by track-range", "version": "1", "pixels": pixels, **video.provenance}


def _video(video: VideoFacts) -> dict[str, Any]:
    width, height = video.size_px or (None, None)
    facts = {"id": 1, "name": video.name or "video", "width": width, "height": height, "fps": video.fps}
    return {key: value for key, value in facts.items() if value is not None}


def _image(video: VideoFacts, frame: int) -> dict[str, Any]:
    size = {} if video.size_px is None else {"width": video.size_px[0], "height": video.size_px[1]}
    return {"id": frame + 1, "file_name": image_name(video, frame), **size, "video_id": 1, "frame_index": frame}


def _annotations(table: BoxTable, categories: Mapping[str, int]) -> Iterator[dict[str, Any]]:
    edges, is_region = np.round(table.xyxy_px + HALF_PIXEL_PX, _DECIMALS), table.is_region
    for row in range(len(table)):
        x, y, right, bottom = edges[row].tolist()
        width, height = round(right - x, _DECIMALS), round(bottom - y, _DECIMALS)
        track_id, score = int(table.track_id[row]), float(table.score[row])
        measured = {"distance_m": float(table.distance_m[row]), "sigma_m": float(table.sigma_m[row])}
        attributes: dict[str, Any] = {key: round(m, _DECIMALS) for key, m in measured.items() if math.isfinite(m)}
        attributes |= {} if table.observed[row] else {"predicted": True}
        yield {
            "id": row + 1,
            "image_id": int(table.frame[row]) + 1,
            "category_id": categories[str(table.class_name[row]) or "object"],
            "bbox": [x, y, width, height],
            "area": round(width * height, _DECIMALS),
            "segmentation": [],
            "iscrowd": int(is_region[row]),
            **({"track_id": track_id} if track_id >= 0 else {}),
            **({"score": round(score, _SCORE_DECIMALS)} if math.isfinite(score) else {}),
            "attributes": attributes,
        }


def _lines(items: Iterator[dict[str, Any]]) -> Iterator[str]:
    """One line of JSON for each object, separated by commas."""
    before = ""
    for item in items:
        yield before + _json(item)
        before = ",\n"
    yield "\n" if before else ""


def _json(value: object) -> str:
    return json.dumps(value, allow_nan=False, ensure_ascii=False)
