"""Labelled images: which images there are, and what is to be found in each, from YOLO, KITTI or COCO labels.

    yolo   one NAME.txt per image: `class cx cy w h`, shares of the image
    kitti  one NAME.txt per image (object labels), or one file of a sequence (tracking labels), by frame number
    coco   one JSON: images, annotations (bbox x y w h in pixels, iscrowd), categories

Labels use the corner convention (the image's left edge is 0), ours has pixel centres at whole numbers: minus half a
pixel. KITTI's are taken as they are (`detection.formats.kitti`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.formats.image_truth import ImageTruth, truth_of_kitti
from track_range.detection.formats.kitti import LabelFileError, read_kitti, read_kitti_image
from track_range.detection.formats.yolo_labels import YoloLabelReader
from track_range.foundation.arrays import BoolArray, Image
from track_range.foundation.csv_tables import read_csv_table
from track_range.foundation.errors import UserError

LabelFormat = Literal["yolo", "kitti", "coco"]

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"})


class ImageFileError(UserError):
    """An image that cannot be read; the message names it."""


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """One image and its labels.

    Attributes:
        path: the image's file.
        truth: its labels; boxes are shares of the image where `is_normalised`.
        notes: sentences on labels that were cut or left out.
    """

    path: Path
    truth: ImageTruth
    is_normalised: bool
    notes: tuple[str, ...] = ()

    def truth_in(self, image: Image) -> ImageTruth:
        """The labels in the image's pixels."""
        if not self.is_normalised:
            return self.truth
        height, width = image.shape[:2]
        return replace(self.truth, xyxy_px=self.truth.xyxy_px * np.array([width, height, width, height]) - 0.5)


@dataclass(frozen=True, slots=True)
class ManifestRow:
    """What a manifest says of one image: its split, and which classes are labelled completely."""

    split: str
    is_complete: BoolArray


def read_image(path: Path) -> Image:
    """An image as (H, W, 3) uint8 BGR: grey becomes grey colours, 16 bits their upper 8; upright as its EXIF says.

    Raises:
        ImageFileError: missing, empty, or no image.
    """
    try:
        encoded = np.fromfile(path, np.uint8)
    except OSError as error:
        raise ImageFileError(f"{path}: cannot be read ({error.strerror or error}).") from error
    try:
        image = cv2.imdecode(encoded, cv2.IMREAD_COLOR) if len(encoded) else None
    except cv2.error:
        image = None
    if image is None:
        raise ImageFileError(f"{path}: not an image, or a damaged one.")
    return np.asarray(image, np.uint8)


def images_in(folder: Path) -> list[Path]:
    """The images of a folder, by name.

    Raises:
        ImageFileError: no such folder, or no image in it.
    """
    if not folder.is_dir():
        raise ImageFileError(f"{folder}: no such folder of images.")
    try:
        found = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    except OSError as error:
        raise ImageFileError(f"{folder}: cannot be read ({error.strerror or error}).") from error
    if not found:
        raise ImageFileError(f"{folder}: no images ({', '.join(sorted(IMAGE_SUFFIXES))}) in it.")
    return found


def read_labelled(
    images: Path, labels: Path, label_format: LabelFormat, *, names: Sequence[str] | None = None
) -> list[LabelledImage]:
    """The images of a folder that have labels, in the order of their names.

    Args:
        images: folder of images.
        labels: folder of label files, or the one file of a COCO set or a KITTI sequence.
        label_format: what they are.
        names: class names of YOLO's numbers; None = from classes.txt or data.yaml there, else the 8 road classes.

    Raises:
        ImageFileError: no images.
        LabelFileError: labels cannot be read, or belong to none of the images.
    """
    paths = images_in(images)
    if label_format == "coco":
        found = _coco(paths, labels)
    elif label_format == "kitti" and labels.is_file():
        by_frame = read_sequence(labels)
        found = [LabelledImage(p, by_frame(number), False) for p in paths if (number := _number(p)) is not None]
    else:
        read = _yolo_reader(labels, names) if label_format == "yolo" else _kitti_object
        found = [read(path, file) for path in paths if (file := labels / f"{path.stem}.txt").is_file()]
    if not found:
        raise LabelFileError(f"{labels}: no labels for any image of {images}; is it the right folder, or --format?")
    return found


def read_sequence(labels: Path) -> Callable[[int], ImageTruth]:
    """Truth by frame number, from KITTI tracking labels.

    Raises:
        LabelFileError: the file cannot be read.
    """
    rows = read_kitti(labels)
    return lambda frame: truth_of_kitti(rows.select(rows.frame == frame))


def read_manifest(path: Path) -> dict[str, ManifestRow]:
    """Split and completely labelled classes of each file: a CSV with columns file, split, labels_complete.

    `labels_complete` is eight flags such as 10111100, in the order of the road classes.

    Raises:
        LabelFileError: unreadable, or columns are missing or wrong.
    """
    table = read_csv_table(path, LabelFileError, "columns file, split, labels_complete")
    table.require(("file", "split", "labels_complete"))
    manifest = {}
    columns = (table.texts("file"), table.texts("split"), table.texts("labels_complete"))
    for row, (file, split, flags) in enumerate(zip(*columns, strict=True)):
        if len(flags) != len(ROAD_CLASSES) or set(flags) - {"0", "1"}:
            raise table.fault(row, f"expected {len(ROAD_CLASSES)} flags 0 or 1 for labels_complete, got '{flags}'.")
        manifest[file] = ManifestRow(split, np.array([flag == "1" for flag in flags]))
    return manifest


def of_split(labelled: Sequence[LabelledImage], manifest: Mapping[str, ManifestRow], split: str) -> list[LabelledImage]:
    """The images of one split, each with the classes that are complete in it; empty if there are none."""
    rows = [(item, manifest[item.path.name]) for item in labelled if item.path.name in manifest]
    return [
        replace(item, truth=replace(item.truth, is_complete=row.is_complete))
        for item, row in rows
        if row.split == split
    ]


def _number(path: Path) -> int | None:
    """The last number in a file's name."""
    digits = "".join(c if c.isdigit() else " " for c in path.stem).split()
    return int(digits[-1]) if digits else None


def _kitti_object(image: Path, file: Path) -> LabelledImage:
    return LabelledImage(image, truth_of_kitti(read_kitti_image(file)), False)


def _yolo_reader(folder: Path, names: Sequence[str] | None) -> Callable[[Path, Path], LabelledImage]:
    """A reader of one label file, which knows what the numbers mean."""
    reader = YoloLabelReader(names, folder)

    def read(image: Path, file: Path) -> LabelledImage:
        labels = reader.read(file)
        return LabelledImage(image, ImageTruth.of(labels.xyxy, labels.class_id), True, labels.notes)

    return read


def _coco(paths: Sequence[Path], file: Path) -> list[LabelledImage]:
    """Images that a COCO set knows, by file name."""
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        road_of = _road_of_categories(document["categories"])
        labels: dict[Any, list[dict[str, Any]]] = {image["id"]: [] for image in document["images"]}
        for label in document["annotations"]:
            if label["category_id"] in road_of:
                labels[label["image_id"]].append(label)
        by_name = {Path(image["file_name"]).name: labels[image["id"]] for image in document["images"]}
        return [
            LabelledImage(path, _coco_truth(by_name[path.name], road_of), False)
            for path in paths
            if path.name in by_name
        ]
    except OSError as error:
        raise LabelFileError(f"{file}: cannot be read ({error.strerror or error}).") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise LabelFileError(
            f"{file}: COCO's images, annotations and categories wanted ({type(error).__name__}: {error})."
        ) from error


def _road_of_categories(categories: Sequence[Mapping[str, Any]]) -> dict[Any, int]:
    road = map_to_road_classes([str(each["name"]) for each in categories])
    return {each["id"]: int(i) for each, i in zip(categories, road, strict=True) if i >= 0}


def _coco_truth(labels: Sequence[Mapping[str, Any]], road_of: Mapping[Any, int]) -> ImageTruth:
    xywh = np.array([label["bbox"] for label in labels], np.float64).reshape(-1, 4)
    boxes = np.concatenate([xywh[:, :2], xywh[:, :2] + xywh[:, 2:]], axis=1) - 0.5
    class_id = [road_of[label["category_id"]] for label in labels]
    return ImageTruth.of(boxes, class_id, is_region=[bool(label.get("iscrowd", 0)) for label in labels])
