"""data.yaml: which images to train and validate on, and what their labels mean.

    path: /data/road            # root of the rest; default: the folder of data.yaml
    train: images/train         # folder of images, .txt with one image per line, another data.yaml, or a list of such
    val: images/val
    names: [person, car, ...]   # in the order of the labels' numbers
    format: yolo                # or kitti (object labels; classes are known)
    labels: labels              # folder of label files; default: `images` in the folder's path replaced by `labels`
    manifest: manifest.csv      # columns file, split, labels_complete: splits, and which classes are complete
    labels_pseudo: teacher      # boxes of a detector, `class cx cy w h score`, where classes are incomplete

Another data.yaml gives the images of its own split; classes that it does not name count as not labelled in it. Names
that are no road classes are left out. A pseudo-label that no label overlaps counts as an object from a score of 0.5 on
(cars: 0.4) where its class is not labelled completely, and is ignored otherwise: neither right nor wrong to find.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from track_range.detection.boxes import are_valid_boxes, iou
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.formats.image_truth import ImageTruth
from track_range.detection.formats.kitti import LabelFileError
from track_range.detection.formats.labelled_images import (
    LabelledImage,
    images_in,
    of_split,
    read_labelled,
    read_manifest,
)
from track_range.detection.formats.yolo_labels import YoloLabelReader
from track_range.detection.models.metadata import names_of
from track_range.foundation.arrays import IntArray

_KEYS = frozenset("path train val test names nc format labels manifest labels_pseudo download".split())
_KITTI_NAMES = ("person", "bicycle", "car", "truck")
_MIN_SCORE, _MIN_CAR_SCORE = 0.5, 0.4
_SAME_OBJECT_IOU = 0.5
"""Overlap from which a pseudo-label is of an object that has a label."""


@dataclass(frozen=True, slots=True)
class TrainingData:
    """What a data.yaml names.

    Attributes:
        road_class_id: (C,) the road classes to be learnt, in the network's order.
        train, val: the images; classes that are not labelled completely are marked in their truth.
        notes: sentences on what was cut, left out or taken for granted.
    """

    road_class_id: IntArray
    train: list[LabelledImage]
    val: list[LabelledImage]
    notes: tuple[str, ...]

    def fingerprint(self) -> str:
        """Tells this data from other data: names and labels of all images in one number."""
        crc = 0
        for item in (*self.train, *self.val):
            crc = zlib.crc32(item.truth.xyxy_px.tobytes(), zlib.crc32(item.path.name.encode(), crc))
        return f"{len(self.train)} and {len(self.val)} images, {crc:08x}"


def read_data_yaml(path: Path, *, within: frozenset[Path] = frozenset()) -> TrainingData:
    """Read a data set's labels; images are read when they are wanted.

    Args:
        path: the file.
        within: files that name this one, directly or not.

    Raises:
        LabelFileError, ImageFileError: the file, a folder or labels cannot be used; the message names what and why.
    """
    if path.resolve() in within:
        raise LabelFileError(f"{path}: names itself as a part of itself.")
    document = _document(path)
    form = document.get("format", "yolo")
    if form not in ("yolo", "kitti"):
        raise LabelFileError(f"{path}: format is yolo or kitti, not {form!r}.")
    names = _KITTI_NAMES if form == "kitti" else _names(path, document)
    road = map_to_road_classes(names)
    classes: IntArray = np.array(list(dict.fromkeys(road[road >= 0].tolist())), np.int64)
    if not len(classes):
        raise LabelFileError(f"{path}: none of its names is a road class ({', '.join(ROAD_CLASSES)}).")
    root = path.parent / str(document.get("path", "."))
    reader = _Reader(path, root, document, form, names, within | {path.resolve()})
    train, val = reader.split("train"), reader.split("val")
    unknown = [name for name, each in zip(names, road, strict=True) if each < 0]
    notes = [f"Left out, since no road classes: {', '.join(unknown)}."] if unknown else []
    return TrainingData(classes, train, val, (*notes, *dict.fromkeys(reader.notes), *_summed_up([*train, *val])))


@dataclass(frozen=True, slots=True)
class _Reader:
    """Reads the splits of one data.yaml; `notes` gathers what was left out on the way."""

    path: Path
    root: Path
    document: Mapping[str, Any]
    form: str
    names: Sequence[str]
    within: frozenset[Path]
    notes: list[str] = field(default_factory=list)

    def split(self, key: str) -> list[LabelledImage]:
        """The images of one split with their labels."""
        if key not in self.document:
            raise LabelFileError(f"{self.path}: no '{key}' in it; folders of train and val images are wanted.")
        entry = self.document[key]
        if not entry or not isinstance(entry, str | list) or not all(isinstance(each, str) for each in entry):
            raise LabelFileError(
                f"{self.path}: '{key}' names a folder, a list of folders, a .txt or another data.yaml."
            )
        items = [item for each in (entry if isinstance(entry, list) else [entry]) for item in self._of(str(each), key)]
        if not items:
            split = f" (the manifest has none of the split '{key}')" if "manifest" in self.document else ""
            raise LabelFileError(f"{self.path}: no labelled images for '{key}'{split}.")
        return items

    def _of(self, entry: str, split: str) -> list[LabelledImage]:
        """The images of one entry, with what the manifest and pseudo-labels say of them."""
        place = self.root / entry
        if place.suffix == ".txt":
            return self._listed(place, split)
        if place.suffix in (".yaml", ".yml"):
            return self._nested(place, split)
        images = self._folder(entry)
        labels = self._labels_of(images)
        found = read_labelled(images, labels, "kitti" if self.form == "kitti" else "yolo", names=self.names)
        if self.form == "kitti":
            n_unlabelled = len(images_in(images)) - len(found)
            if n_unlabelled:
                self.notes.append(f"{n_unlabelled} images of {images} have no label file: left out.")
            return [_with_who_sits(item) for item in found]
        return self._completed([*found, *_background(images, {item.path for item in found})], split)

    def _nested(self, place: Path, split: str) -> list[LabelledImage]:
        """The same split of another data set; classes that it does not name are not labelled in it."""
        data = read_data_yaml(place, within=self.within)
        named = np.isin(np.arange(len(ROAD_CLASSES)), data.road_class_id)
        return [
            replace(item, truth=replace(item.truth, is_complete=item.truth.is_complete & named))
            for item in (data.train if split == "train" else data.val)
        ]

    def _completed(self, items: list[LabelledImage], split: str) -> list[LabelledImage]:
        """Those of the split, with pseudo-labels where they are for training."""
        if "manifest" in self.document:
            manifest = read_manifest(self.root / str(self.document["manifest"]))
            n_unlisted = sum(item.path.name not in manifest for item in items)
            if n_unlisted:
                self.notes.append(f"{n_unlisted} images for '{split}' are not in the manifest: left out.")
            items = of_split(items, manifest, split)
        if "labels_pseudo" in self.document and split == "train":
            folder = self._folder(str(self.document["labels_pseudo"]))
            reader = YoloLabelReader(self.names)
            items = [_with_pseudo_labels(item, folder / f"{item.path.stem}.txt", reader) for item in items]
        return items

    def _listed(self, file: Path, split: str) -> list[LabelledImage]:
        """The images that a text file names, relative to it or to the root."""
        try:
            lines = [line.strip() for line in file.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
        except (OSError, UnicodeDecodeError, ValueError) as error:
            raise LabelFileError(f"{file}: not readable as a list of images ({error}).") from error
        places = [file.parent / line if (file.parent / line).is_file() else self.root / line for line in lines]
        missing = [line for line, place in zip(lines, places, strict=True) if not place.is_file()]
        if missing:
            raise LabelFileError(f"{file}: {len(missing)} of its images are not there, the first: {missing[0]}.")
        wanted = {place.resolve() for place in places}
        folders = list(dict.fromkeys(place.parent for place in places))
        found = [item for folder in folders for item in self._of(str(folder.absolute()), split)]
        return [item for item in found if item.path.resolve() in wanted]

    def _labels_of(self, images: Path) -> Path:
        if "labels" in self.document:
            return self._folder(str(self.document["labels"]))
        parts = list(images.parts)
        if "images" in parts:
            last = len(parts) - 1 - parts[::-1].index("images")
            parts[last] = "labels"
        folder = Path(*parts)
        if not folder.is_dir():
            raise LabelFileError(f"{folder}: no such folder of labels; name one with 'labels:' in {self.path.name}.")
        return folder

    def _folder(self, entry: str) -> Path:
        folder = self.root / entry
        if not folder.is_dir():
            raise LabelFileError(f"{self.path}: no such folder: {folder}.")
        return folder


def _document(path: Path) -> Mapping[str, Any]:
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise LabelFileError(f"{path}: cannot be read ({error.strerror or error}).") from error
    except (UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise LabelFileError(f"{path}: not readable as YAML ({type(error).__name__}).") from error
    if not isinstance(document, dict) or document.get("train") is None:
        raise LabelFileError(f"{path}: keys train, val and names are wanted in it.")
    if unknown := sorted(str(key) for key in document.keys() - _KEYS):
        raise LabelFileError(f"{path}: unknown key '{unknown[0]}'; known are {', '.join(sorted(_KEYS))}.")
    return {key: value for key, value in document.items() if value is not None}


def _names(path: Path, document: Mapping[str, Any]) -> tuple[str, ...]:
    try:
        return names_of(document["names"])
    except (KeyError, ValueError, TypeError) as error:
        why = "" if isinstance(error, KeyError) else f" ({error})"
        raise LabelFileError(f"{path}: 'names' wanted, the class names in the order of their numbers{why}.") from error


def _with_who_sits(item: LabelledImage) -> LabelledImage:
    """KITTI's Person_sitting, ignored by its evaluation, as persons to be learnt (as the monocular paper does).

    Raises:
        LabelFileError: a box is turned inside out, or not a number.
    """
    truth = item.truth
    if not are_valid_boxes(truth.xyxy_px).all():
        raise LabelFileError(f"labels of {item.path}: a box without width or height, or whose edges are no numbers.")
    is_sitting = (truth.class_id == ROAD_CLASSES.index("person")) & truth.is_ignored & ~truth.is_region
    return replace(item, truth=replace(truth, is_ignored=truth.is_ignored & ~is_sitting))


def _background(images: Path, labelled: set[Path]) -> list[LabelledImage]:
    """Images without a label file: nothing is in them."""
    nothing = ImageTruth.of([], [])
    return [
        LabelledImage(path, nothing, True, ("no label file: background",))
        for path in images_in(images)
        if path not in labelled
    ]


def _with_pseudo_labels(item: LabelledImage, file: Path, reader: YoloLabelReader) -> LabelledImage:
    if not file.is_file():
        return item
    found, truth = reader.read(file), item.truth
    is_new = iou(found.xyxy, truth.xyxy_px).max(axis=1, initial=0.0) < _SAME_OBJECT_IOU
    found = replace(found, xyxy=found.xyxy[is_new], class_id=found.class_id[is_new], score=found.score[is_new])
    enough = np.where(found.class_id == ROAD_CLASSES.index("car"), _MIN_CAR_SCORE, _MIN_SCORE)
    is_object = (found.score >= enough) & ~truth.is_complete[found.class_id]
    boxes = np.concatenate([truth.xyxy_px, found.xyxy])
    joined = ImageTruth(
        boxes,
        np.concatenate([truth.class_id, found.class_id]),
        np.concatenate([truth.is_ignored, ~is_object]),
        np.concatenate([truth.is_region, np.zeros(len(is_object), np.bool_)]),
        truth.is_complete,
    )
    return replace(item, truth=joined)


def _summed_up(items: Sequence[LabelledImage]) -> list[str]:
    """A sentence for each kind of note, with the first of its kind."""
    n_background = sum("no label file: background" in item.notes for item in items)
    other = [note for item in items for note in item.notes if note != "no label file: background"]
    notes = []
    if n_background:
        notes.append(f"{n_background} images have no label file and are taken for background.")
    if other:
        notes.append(f"{len(other)} labelled boxes reach out of their image or are empty, the first: {other[0]}")
    return notes
