"""Reader of data.yaml: the images to train and validate on, and the classes of their labels.

    path: /data/road            # root of the other paths; default: the folder of data.yaml
    train: images/train         # folder of images, .txt with one image per line, another data.yaml, or a list of these
    val: images/val
    names: [person, car, ...]   # in the order of the class numbers
    format: yolo                # or kitti (object labels with KITTI's classes)
    labels: labels              # folder of label files; default: the folder with `images` replaced by `labels`
    manifest: manifest.csv      # columns file, split, labels_complete (which classes are labelled)
    labels_pseudo: teacher      # detections `class cx cy w h score`, used for classes that are not completely labelled
    pseudo_scores: thresholds   # use of their scores, or `probabilities`
    pseudo_names: [person, ...] # with probabilities: the classes that the detector knows; default: all names

If an entry is another data.yaml, its images of the same split are used; they count as unlabelled for the classes that
it does not name. Names that are not road classes are ignored. A pseudo-label that does not overlap a label is an object
if its score is at least 0.5 (cars: 0.4) and its class is not completely labelled in the image; otherwise the box is
ignored, so that a detection there is neither a true nor a false positive. With `pseudo_scores: probabilities`, each
one of a class that is not completely labelled is an object whose confidence is its score, and the classes that the
detector knows count as completely labelled. `detection.training.ensemble` makes such pseudo-labels.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict

from track_range.detection.boxes import are_valid_boxes, iou
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.formats.image_labels.labelled_images import (
    LabelledImage,
    images_in,
    of_split,
    read_labelled,
    read_manifest,
)
from track_range.detection.formats.image_labels.yolo_labels import YoloLabelReader, YoloLabels, names_in
from track_range.foundation.arrays import BoolArray, IntArray
from track_range.foundation.files.input_files import MAX_TABLE_BYTES, quoted, read_text, real_path, shortened
from track_range.foundation.files.structured_text import read_yaml
from track_range.foundation.validation import validated

_MAX_PATH = 1000
"""Largest number of characters of a path in a data.yaml."""

_MAX_SHOWN = 200
"""Largest number of characters of a path in a message."""


def _printable(path: str) -> str:
    if not path.isprintable() or len(path) > _MAX_PATH:
        raise ValueError(f"expected a path of at most {_MAX_PATH} printable characters, found {quoted(path)}")
    return path


_Path = Annotated[str, AfterValidator(_printable)]


def _listed(entry: object) -> object:
    """The entries of a split as a list."""
    entries = entry if isinstance(entry, list) else [entry]
    if not entries or not all(isinstance(part, str) and part for part in entries):
        raise ValueError(
            f"expected a folder, a list of folders, a .txt file or another data.yaml, found {quoted(entry)}"
        )
    return entries


_Entries = Annotated[list[_Path], BeforeValidator(_listed)]


class _DataYaml(BaseModel):
    """Content of a data.yaml; test, nc, download (Ultralytics) and video (`formats.yolo_tracks`) are not used."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    path: _Path = "."
    train: _Entries
    val: _Entries
    names: Any = None
    format: Literal["yolo", "kitti"] = "yolo"
    labels: _Path | None = None
    manifest: _Path | None = None
    labels_pseudo: _Path | None = None
    pseudo_scores: Literal["thresholds", "probabilities"] = "thresholds"
    pseudo_names: list[str] | None = None
    test: Any = None
    nc: Any = None
    download: Any = None
    video: Any = None


_KITTI_NAMES = ("person", "bicycle", "car", "truck")
"""Road classes that KITTI labels."""

_MIN_SCORE, _MIN_CAR_SCORE = 0.5, 0.4
"""Minimum score of a pseudo-label that is used as an object: for most classes, and for cars."""

_SAME_OBJECT_IOU = 0.5
"""Minimum IoU between a pseudo-label and a label of the same object."""

_BACKGROUND_NOTE = "no label file: background"
"""Note for an image without a label file."""

_NO_LABELS = YoloLabels(np.zeros((0, 4)), np.zeros(0, np.int64), np.zeros(0), ())
"""Content of a file of pseudo-labels that does not exist."""


@dataclass(frozen=True, slots=True)
class TrainingData:
    """The data set of a data.yaml.

    Attributes:
        road_class_id: (C,) road class of each of the network's classes.
        train, val: the images; their truth lists which classes are completely labelled.
        notes: notes for the user on clipped boxes, ignored images and assumptions.
    """

    road_class_id: IntArray
    train: list[LabelledImage]
    val: list[LabelledImage]
    notes: tuple[str, ...]

    def fingerprint(self) -> str:
        """Identifier of the data: numbers of images, and a checksum of all file names and labels."""
        crc = 0
        for item in (*self.train, *self.val):
            crc = zlib.crc32(item.path.name.encode(), crc)
            truth = item.truth
            for values in (truth.xyxy_px, truth.class_id, truth.is_ignored, truth.is_complete, truth.confidence):
                crc = zlib.crc32(np.ascontiguousarray(values).tobytes(), crc)
        return f"{len(self.train)} and {len(self.val)} images, {crc:08x}"


@dataclass(frozen=True, slots=True)
class OwnLabels:
    """The images that the entries of a data.yaml list, with their labels alone.

    Attributes:
        path: the data.yaml.
        root: folder that paths in the file are relative to.
        names: class names, in the order of the numbers in label files.
        train, val: the images, each once, without pseudo-labels and without those of another data.yaml; the boxes are
            fractions of the image size. `val` may be empty.
        labels_pseudo: detections of each training image by its path; None = the file names no folder of detections.
        notes: notes for the user on clipped boxes, ignored images and assumptions.
    """

    path: Path
    root: Path
    names: tuple[str, ...]
    train: list[LabelledImage]
    val: list[LabelledImage]
    labels_pseudo: dict[Path, YoloLabels] | None
    notes: tuple[str, ...]

    @property
    def image_files(self) -> list[Path]:
        """Files of all images, each once."""
        return list(dict.fromkeys(item.path for item in (*self.train, *self.val)))

    @property
    def is_named(self) -> BoolArray:
        """(8,) road classes that have a name."""
        return np.isin(np.arange(len(ROAD_CLASSES)), map_to_road_classes(self.names))


def read_own_labels(path: Path) -> OwnLabels:
    """The images and labels of a data.yaml to which pseudo-labels can be added; pixels are not read.

    Raises:
        LabelFileError, ImageFileError: as for `read_data_yaml`; or the labels are KITTI's, the pseudo-labels are
            probabilities already, there are no training images, or two of them have the same name.
    """
    document, names = _document(path)
    if document.format == "kitti":
        raise LabelFileError(f"{path}: expected labels in YOLO's format for pseudo-labels, found 'format: kitti'.")
    if document.labels_pseudo and document.pseudo_scores == "probabilities":
        raise LabelFileError(
            f"{path}: expected detections of a detector in labels_pseudo, found 'pseudo_scores: probabilities', which "
            "are pseudo-labels already; remove these keys, or name a folder of detections."
        )
    root = path.parent / document.path
    reader = _Reader(path, root, document, names, frozenset({real_path(path)}), [], is_alone=True)
    train = _first_of_each(reader.split("train"))
    val = _first_of_each(reader.listed_in("val"))
    stems = [item.path.stem for item in train]
    if len(set(stems)) < len(stems):
        name = next(name for i, name in enumerate(stems) if name in stems[:i])
        raise LabelFileError(
            f"{path}: expected training images with different names, as pseudo-labels are files NAME.txt in one "
            f"folder, found {quoted(name)} twice."
        )
    notes = (*dict.fromkeys(reader.notes), *_summarised([*train, *val]))
    return OwnLabels(path, root, tuple(names), train, val, reader.pseudo_labels(train), notes)


def read_data_yaml(path: Path, *, within: frozenset[Path] = frozenset()) -> TrainingData:
    """The images and labels of a data.yaml; pixels are not read.

    Args:
        path: the file.
        within: files that refer to this one, directly or indirectly, to detect circular references.

    Raises:
        LabelFileError, ImageFileError: the file, a folder or labels cannot be read or are invalid.
    """
    document, names = _document(path, within)
    road = map_to_road_classes(names)
    classes: IntArray = np.array(list(dict.fromkeys(road[road >= 0].tolist())), np.int64)
    reader = _Reader(path, path.parent / document.path, document, names, within | {real_path(path)}, [])
    train, val = reader.split("train"), reader.split("val")
    unknown = [name for name, class_id in zip(names, road, strict=True) if class_id < 0]
    notes = [f"Ignored classes that are not road classes: {', '.join(unknown)}."] if unknown else []
    return TrainingData(classes, train, val, (*notes, *dict.fromkeys(reader.notes), *_summarised([*train, *val])))


def _document(path: Path, within: frozenset[Path] = frozenset()) -> tuple[_DataYaml, Sequence[str]]:
    """Content of a data.yaml, and its class names.

    Raises:
        LabelFileError: the file cannot be read, is invalid, has no road class, or is one of `within`.
    """
    content = _content(path)  # first, since `resolve` fails on a loop of links
    if real_path(path) in within:
        raise LabelFileError(f"{path}: refers to itself, directly or through another data.yaml.")
    document = validated(_DataYaml, content, path, LabelFileError)
    names = _KITTI_NAMES if document.format == "kitti" else names_in(content, path)
    if (map_to_road_classes(names) < 0).all():
        raise LabelFileError(f"{path}: names: expected at least one road class ({', '.join(ROAD_CLASSES)}).")
    return document, names


@dataclass(frozen=True, slots=True)
class _Reader:
    """Reader of the splits of one data.yaml.

    Attributes:
        notes: collects the notes for the user.
        is_alone: images are read without pseudo-labels, and those of another data.yaml are left out.
    """

    path: Path
    root: Path
    document: _DataYaml
    names: Sequence[str]
    within: frozenset[Path]
    notes: list[str]
    is_alone: bool = False

    def listed_in(self, key: str) -> list[LabelledImage]:
        """The images of one split with their labels; there may be none."""
        entries = self.document.train if key == "train" else self.document.val
        return [item for part in entries for item in self._of(part, key)]

    def split(self, key: str) -> list[LabelledImage]:
        """The images of one split with their labels.

        Raises:
            LabelFileError: there are none.
        """
        items = self.listed_in(key)
        if not items:
            split = f" (the manifest has no images of the split '{key}')" if self.document.manifest else ""
            raise LabelFileError(f"{self.path}: no labelled images for '{key}'{split}.")
        return items

    def pseudo_labels(self, items: Sequence[LabelledImage]) -> dict[Path, YoloLabels] | None:
        """Detections of the images in the folder of pseudo-labels, by path; None without such a folder."""
        if not self.document.labels_pseudo:
            return None
        folder, reader = self._folder(self.document.labels_pseudo), YoloLabelReader(self.names)
        files = ((item.path, folder / f"{item.path.stem}.txt") for item in items)
        return {path: reader.read(file) if file.is_file() else _NO_LABELS for path, file in files}

    def _of(self, entry: str, split: str) -> list[LabelledImage]:
        """The images of one entry, with the manifest and the pseudo-labels applied."""
        path = self.root / entry
        if path.suffix == ".txt":
            return self._listed(path, split)
        if path.suffix in (".yaml", ".yml"):
            return self._nested(path, split)
        images = self._folder(entry)
        labels = self._labels_of(images)
        labelled = read_labelled(images, labels, self.document.format, names=self.names)
        if self.document.format == "kitti":
            n_unlabelled = len(images_in(images)) - len(labelled)
            if n_unlabelled:
                self.notes.append(f"{images}: ignored {n_unlabelled} images without a label file.")
            return [_with_sitting_persons(item) for item in labelled]
        return self._completed([*labelled, *_background(images, {item.path for item in labelled})], split)

    def _nested(self, path: Path, split: str) -> list[LabelledImage]:
        """The same split of another data.yaml; classes that it does not name are marked as not labelled."""
        if self.is_alone:
            self.notes.append(f"Left out the images of {path} for '{split}', which have separate pseudo-labels.")
            return []
        data = read_data_yaml(path, within=self.within)
        named = np.isin(np.arange(len(ROAD_CLASSES)), data.road_class_id)
        return [
            replace(item, truth=replace(item.truth, is_complete=item.truth.is_complete & named))
            for item in (data.train if split == "train" else data.val)
        ]

    def _completed(self, items: list[LabelledImage], split: str) -> list[LabelledImage]:
        """The images of the split in the manifest, with pseudo-labels if the split is train."""
        if self.document.manifest:
            manifest = read_manifest(self.root / self.document.manifest)
            n_unlisted = sum(item.path.name not in manifest for item in items)
            if n_unlisted:
                self.notes.append(f"Ignored {n_unlisted} images for '{split}' that are not in the manifest.")
            items = of_split(items, manifest, split)
        if self.document.labels_pseudo and split == "train" and not self.is_alone:
            folder = self._folder(self.document.labels_pseudo)
            reader, known = YoloLabelReader(self.names), self._known_classes()
            items = [_with_pseudo_labels(item, folder / f"{item.path.stem}.txt", reader, known) for item in items]
        return items

    def _known_classes(self) -> BoolArray | None:
        """(8,) road classes of the detector that made the pseudo-labels; None = their scores are no probabilities.

        Raises:
            LabelFileError: a name is not one of the road classes.
        """
        if self.document.pseudo_scores != "probabilities":
            if self.document.pseudo_names is not None:
                raise LabelFileError(f"{self.path}: pseudo_names: expected `pseudo_scores: probabilities` with it.")
            return None
        names = self.names if self.document.pseudo_names is None else self.document.pseudo_names
        road = map_to_road_classes(names)
        if self.document.pseudo_names is not None and (road < 0).any():
            name = names[int((road < 0).argmax())]
            raise LabelFileError(f"{self.path}: pseudo_names: expected road classes, found {quoted(name)}.")
        return np.isin(np.arange(len(ROAD_CLASSES)), road)

    def _listed(self, file: Path, split: str) -> list[LabelledImage]:
        """The images listed in a text file, with paths relative to the file or to the root."""
        text = read_text(file, LabelFileError, "a list of images", max_bytes=MAX_TABLE_BYTES)
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        paths = [file.parent / line if os.path.isfile(file.parent / line) else self.root / line for line in lines]
        missing = [line for line, path in zip(lines, paths, strict=True) if not os.path.isfile(path)]
        if missing:
            raise LabelFileError(f"{file}: {len(missing)} images do not exist; the first: {shortened(missing[0])}.")
        listed = {real_path(path) for path in paths}
        folders = list(dict.fromkeys(path.parent for path in paths))
        items = [item for folder in folders for item in self._of(str(folder.absolute()), split)]
        return [item for item in items if real_path(item.path) in listed]

    def _labels_of(self, images: Path) -> Path:
        """Folder of the label files for a folder of images."""
        if self.document.labels:
            return self._folder(self.document.labels)
        parts = list(images.parts)
        if "images" in parts:
            last = len(parts) - 1 - parts[::-1].index("images")
            parts[last] = "labels"
        folder = Path(*parts)
        if not os.path.isdir(folder):
            raise LabelFileError(
                f"{folder}: expected a folder of labels, found none; specify it with 'labels:' in {self.path.name}."
            )
        return folder

    def _folder(self, entry: str) -> Path:
        folder = self.root / entry
        if not os.path.isdir(folder):
            raise LabelFileError(f"{self.path}: expected a folder {shortened(str(folder), _MAX_SHOWN)}, found none.")
        return folder


def _first_of_each(items: Sequence[LabelledImage]) -> list[LabelledImage]:
    """The images without repetitions, which lists of images use to draw rare ones more often."""
    return list({real_path(item.path): item for item in reversed(items)}.values())[::-1]


def _content(path: Path) -> dict[Any, Any]:
    """Keys of a data.yaml with values; keys without a value are left out.

    Raises:
        LabelFileError: the file cannot be read, or has no keys.
    """
    content = read_yaml(path, LabelFileError, "a data.yaml with the keys train, val and names")
    if not isinstance(content, dict):
        raise LabelFileError(f"{path}: expected the keys train, val and names, found {quoted(content)}.")
    return {key: value for key, value in content.items() if value is not None}


def _with_sitting_persons(item: LabelledImage) -> LabelledImage:
    """The image with KITTI's Person_sitting, which its evaluation ignores, as persons.

    Raises:
        LabelFileError: a box is empty or has values that are not finite.
    """
    truth = item.truth
    if not are_valid_boxes(truth.xyxy_px).all():
        raise LabelFileError(f"{item.path}: labels: expected finite boxes with a positive width and height.")
    is_sitting = (truth.class_id == ROAD_CLASSES.index("person")) & truth.is_ignored & ~truth.is_region
    return replace(item, truth=replace(truth, is_ignored=truth.is_ignored & ~is_sitting))


def _background(images: Path, labelled: set[Path]) -> list[LabelledImage]:
    """The images of a folder that have no label file, as images without objects."""
    empty = ImageTruth.of([], [])
    return [LabelledImage(path, empty, True, (_BACKGROUND_NOTE,)) for path in images_in(images) if path not in labelled]


def _with_pseudo_labels(
    item: LabelledImage, file: Path, reader: YoloLabelReader, known: BoolArray | None
) -> LabelledImage:
    """The image with the pseudo-labels of a file added to its labels.

    Args:
        item: the image.
        file: the pseudo-labels; if it does not exist, there are none.
        reader: reader of the file.
        known: (8,) classes that count as completely labelled with them, whose scores are probabilities; None = scores
            are compared with thresholds.
    """
    truth, is_soft = item.truth, known is not None
    is_complete = truth.is_complete if known is None else truth.is_complete | known
    if not file.is_file():
        return replace(item, truth=replace(truth, is_complete=is_complete))
    pseudo = reader.read(file)
    if is_soft and (pseudo.score > 1).any():
        raise LabelFileError(f"{file}: expected probabilities of at most 1, found {pseudo.score.max():g}.")
    is_new = iou(pseudo.xyxy, truth.xyxy_px).max(axis=1, initial=0.0) < _SAME_OBJECT_IOU
    pseudo = replace(pseudo, xyxy=pseudo.xyxy[is_new], class_id=pseudo.class_id[is_new], score=pseudo.score[is_new])
    min_score = np.where(pseudo.class_id == ROAD_CLASSES.index("car"), _MIN_CAR_SCORE, _MIN_SCORE)
    is_object = (is_soft | (pseudo.score >= min_score)) & ~truth.is_complete[pseudo.class_id]
    boxes = np.concatenate([truth.xyxy_px, pseudo.xyxy])
    combined = ImageTruth(
        boxes,
        np.concatenate([truth.class_id, pseudo.class_id]),
        np.concatenate([truth.is_ignored, ~is_object]),
        np.concatenate([truth.is_region, np.zeros(len(is_object), np.bool_)]),
        is_complete,
        np.concatenate([truth.confidence, pseudo.score if is_soft else np.ones(len(is_object))]),
    )
    return replace(item, truth=combined)


def _summarised(items: Sequence[LabelledImage]) -> list[str]:
    """One note for each kind of note of the images, with the first example."""
    n_background = sum(_BACKGROUND_NOTE in item.notes for item in items)
    other = [note for item in items for note in item.notes if note != _BACKGROUND_NOTE]
    notes = []
    if n_background:
        notes.append(f"{n_background} images have no label file and are used as background.")
    if other:
        notes.append(f"{len(other)} labelled boxes are empty or extend beyond their image; the first: {other[0]}")
    return notes
