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

If an entry is another data.yaml, its images of the same split are used; they count as unlabelled for classes that this
data.yaml does not name. Names that are not road classes are ignored. A pseudo-label that does not overlap a label is an
object if its score is at least 0.5 (cars: 0.4) and its class is not completely labelled in the image; otherwise the box
is ignored, so that a detection there is neither a true nor a false positive. With `pseudo_scores: probabilities`, each
pseudo-label of a class that is not completely labelled is an object whose confidence is the score, and the classes that
the detector knows count as completely labelled. `detection.training.ensemble` makes such pseudo-labels.
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
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.formats.image_labels.labelled_images import (
    LabelledImage,
    images_in,
    of_split,
    read_labelled,
    read_manifest,
)
from track_range.detection.formats.image_labels.yolo_labels import (
    YoloLabelReader,
    YoloLabels,
)
from track_range.detection.formats.tables.class_names import names_in
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.training.errors import TrainingError
from track_range.foundation.arrays import BoolArray, IntArray
from track_range.foundation.files.input_files import (
    MAX_TABLE_BYTES,
    quoted,
    read_text,
    real_path,
    shortened,
)
from track_range.foundation.files.structured_text import read_yaml
from track_range.foundation.schemas.validation import validated

_MAX_PATH, _MAX_SHOWN = 1000, 200  # characters of a path in a data.yaml, and in a message


def _printable(path: str) -> str:
    if not path.isprintable() or len(path) > _MAX_PATH:
        raise ValueError(
            f"expected a path of at most {_MAX_PATH} printable characters, found {quoted(path)}"
        )
    return path


def _listed(entry: object) -> object:
    entries = entry if isinstance(entry, list) else [entry]
    if not entries or not all(isinstance(part, str) and part for part in entries):
        raise ValueError(
            "expected a folder, a list of folders, a .txt file or another data.yaml, found "
            f"{quoted(entry)}"
        )
    return entries


_Path = Annotated[str, AfterValidator(_printable)]
_Entries = Annotated[list[_Path], BeforeValidator(_listed)]


class _DataYaml(BaseModel):
    """Content of a data.yaml; test, nc, download (Ultralytics) and video (`video_labels.yolo_tracks`)
    are not used.
    """

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


_KITTI_NAMES = ("person", "bicycle", "car", "truck")  # road classes that KITTI labels
# of pseudo-labels that are used: for most classes, and for cars
_MIN_SCORE, _MIN_CAR_SCORE = 0.5, 0.4
_SAME_OBJECT_IOU = 0.5  # minimum IoU between a pseudo-label and a label of the same object
_PERSON, _CAR = ROAD_CLASSES.index("person"), ROAD_CLASSES.index("car")
_BACKGROUND_NOTE = "no label file: background"


@dataclass(frozen=True, slots=True)
class TrainingData:
    """The data set of a data.yaml; the truth of its images lists which classes are completely
    labelled.
    """

    road_class_id: IntArray  # (C,) road class of each of the network's classes
    train: list[LabelledImage]
    val: list[LabelledImage]
    notes: tuple[str, ...]  # notes for the user on clipped boxes, ignored images and assumptions

    def fingerprint(self) -> str:
        """Identifier of the data: numbers of images, and a checksum of all file names and
        labels.
        """
        crc = 0
        for item in (*self.train, *self.val):
            crc = zlib.crc32(item.path.name.encode(), crc)
            truth = item.truth
            for values in (
                truth.xyxy_px,
                truth.class_id,
                truth.is_ignored,
                truth.is_complete,
                truth.confidence,
            ):
                crc = zlib.crc32(np.ascontiguousarray(values).tobytes(), crc)
        return f"{len(self.train)} and {len(self.val)} images, {crc:08x}"

    def check_trainable(self, path: Path, model: str) -> None:
        """LabelFileError or TrainingError unless the data of the data.yaml at `path` can train a
        `model`.
        """
        if not any((~item.truth.is_ignored).any() for item in self.train):
            raise LabelFileError(
                f"{path}: expected labelled objects in the training images, found none."
            )
        if model != "road" and any((item.truth.confidence < 1).any() for item in self.train):
            raise TrainingError(
                f"--model {model}: expected `pseudo_scores: thresholds` in {path.name}; only the "
                "loss of --model road uses pseudo-labels with probabilities."
            )


@dataclass(frozen=True, slots=True)
class OwnLabels:
    """The images that the entries of a data.yaml list, with their own labels only, as fractions of
    the image size.
    """

    path: Path
    root: Path  # folder that paths in the file are relative to
    names: tuple[str, ...]  # class names, in the order of the numbers in label files
    # each once, without pseudo-labels and without those of another data.yaml; so is `val`
    train: list[LabelledImage]
    val: list[LabelledImage]  # may be empty
    # of training images; None = the file names no folder of detections
    labels_pseudo: dict[Path, YoloLabels] | None
    notes: tuple[str, ...]  # notes for the user on clipped boxes, ignored images and assumptions

    @property
    def image_files(self) -> list[Path]:
        """Files of all images, each once."""
        return list(dict.fromkeys(item.path for item in (*self.train, *self.val)))

    @property
    def is_named(self) -> BoolArray:
        """(8,) road classes that have a name."""
        return np.isin(np.arange(len(ROAD_CLASSES)), map_to_road_classes(self.names))


def read_own_labels(path: Path) -> OwnLabels:
    """The images and labels of a data.yaml to which pseudo-labels can be added; pixels are not
    read.

    LabelFileError, ImageFileError: as for `read_data_yaml`; also if the labels are KITTI's, the
    pseudo-labels are already probabilities, there are no training images, or two images have the
    same name.
    """
    reader = _Reader(path, frozenset(), is_alone=True)
    if reader.document.format == "kitti":
        raise LabelFileError(
            f"{path}: expected labels in YOLO's format for pseudo-labels, found 'format: kitti'."
        )
    if reader.document.labels_pseudo and reader.document.pseudo_scores == "probabilities":
        raise LabelFileError(
            f"{path}: expected detections of a detector in labels_pseudo, found 'pseudo_scores: "
            "probabilities', which are pseudo-labels already; remove these keys, or name a folder "
            "of detections."
        )
    train, val = (
        _first_of_each(reader.split(key, may_be_empty=key == "val")) for key in ("train", "val")
    )
    stems = [item.path.stem for item in train]
    if len(set(stems)) < len(stems):
        name = next(name for i, name in enumerate(stems) if name in stems[:i])
        raise LabelFileError(
            f"{path}: expected training images with different names, as pseudo-labels are files "
            f"NAME.txt in one folder, found {quoted(name)} twice."
        )
    pseudo = (
        {item.path: reader.pseudo_labels_of(item)[1] for item in train}
        if reader.document.labels_pseudo
        else None
    )
    return OwnLabels(
        path, reader.root, tuple(reader.names), train, val, pseudo, reader.all_notes(train, val)
    )


def read_data_yaml(path: Path, *, within: frozenset[Path] = frozenset()) -> TrainingData:
    """The images and labels of a data.yaml; pixels are not read. LabelFileError or ImageFileError
    if a file is invalid.

    `within` are the files that refer to this file, directly or indirectly, to detect circular
    references.
    """
    reader = _Reader(path, within)
    road = map_to_road_classes(reader.names)
    classes: IntArray = np.array(list(dict.fromkeys(road[road >= 0].tolist())), np.int64)
    train, val = reader.split("train"), reader.split("val")
    unknown = [name for name, class_id in zip(reader.names, road, strict=True) if class_id < 0]
    notes = (
        (f"Ignored classes that are not road classes: {', '.join(unknown)}.",) if unknown else ()
    )
    return TrainingData(classes, train, val, (*notes, *reader.all_notes(train, val)))


class _Reader:
    """Reader of the splits of one data.yaml, which collects notes for the user.

    If `is_alone`, images are read without pseudo-labels, and the images of another data.yaml are
    left out.
    """

    def __init__(self, path: Path, within: frozenset[Path], *, is_alone: bool = False) -> None:
        content = read_yaml(path, LabelFileError, "a data.yaml with the keys train, val and names")
        if not isinstance(content, dict):
            raise LabelFileError(
                f"{path}: expected the keys train, val and names, found {quoted(content)}."
            )
        if real_path(path) in within:  # after reading, since `resolve` fails on a loop of links
            raise LabelFileError(
                f"{path}: refers to itself, directly or through another data.yaml."
            )
        content = {key: value for key, value in content.items() if value is not None}
        self.document = validated(_DataYaml, content, path, LabelFileError)
        self.names: Sequence[str] = (
            _KITTI_NAMES if self.document.format == "kitti" else names_in(content, path)
        )
        if (map_to_road_classes(self.names) < 0).all():
            raise LabelFileError(
                f"{path}: names: expected at least one road class ({', '.join(ROAD_CLASSES)})."
            )
        self.root = path.parent / self.document.path
        self._path, self._within, self._is_alone = path, within | {real_path(path)}, is_alone
        self._notes: list[str] = []
        self._labels = YoloLabelReader(self.names)

    def split(self, key: str, *, may_be_empty: bool = False) -> list[LabelledImage]:
        entries = self.document.train if key == "train" else self.document.val
        items = [item for part in entries for item in self._entry(part, key)]
        if not items and not may_be_empty:
            split = (
                f" (the manifest has no images of the split '{key}')"
                if self.document.manifest
                else ""
            )
            raise LabelFileError(f"{self._path}: there are no labelled images for '{key}'{split}.")
        return items

    def all_notes(self, train: list[LabelledImage], val: list[LabelledImage]) -> tuple[str, ...]:
        """The notes so far, and one note with the first example for each kind of problem in the
        images.
        """
        listed = [note for item in (*train, *val) for note in item.notes]
        other = [note for note in listed if note != _BACKGROUND_NOTE]
        notes = list(dict.fromkeys(self._notes))
        if n_background := len(listed) - len(other):
            notes.append(f"{n_background} images have no label file and are used as background.")
        if other:
            notes.append(
                f"{len(other)} labelled boxes are empty or extend beyond their image; the "
                f"first: {other[0]}"
            )
        return tuple(notes)

    def _entry(self, entry: str, split: str) -> list[LabelledImage]:
        """The images of one entry, with the manifest and the pseudo-labels applied."""
        path = self.root / entry
        if path.suffix == ".txt":
            return self._listed_in(path, split)
        if path.suffix in (".yaml", ".yml"):
            return self._nested(path, split)
        images = self._folder(entry)
        labelled = read_labelled(
            images, self._labels_of(images), self.document.format, names=self.names
        )
        with_labels = {item.path for item in labelled}
        others = [image for image in images_in(images) if image not in with_labels]
        if self.document.format == "kitti":
            if others:
                self._notes.append(f"{images}: ignored {len(others)} images without a label file.")
            return [_with_sitting_persons(item) for item in labelled]
        background = ImageTruth.of([], [])
        items = [
            *labelled,
            *(LabelledImage(image, background, True, (_BACKGROUND_NOTE,)) for image in others),
        ]
        if self.document.manifest:
            manifest = read_manifest(self.root / self.document.manifest)
            if n_unlisted := sum(item.path.name not in manifest for item in items):
                self._notes.append(
                    f"Ignored {n_unlisted} images for '{split}' that are not in the manifest."
                )
            items = of_split(items, manifest, split)
        if self.document.labels_pseudo and split == "train" and not self._is_alone:
            known = self._known_classes()
            items = [self._with_pseudo_labels(item, known) for item in items]
        return items

    def _listed_in(self, file: Path, split: str) -> list[LabelledImage]:
        """The images listed in a text file, with paths relative to the file or to the root."""
        text = read_text(file, LabelFileError, "a list of images", max_bytes=MAX_TABLE_BYTES)
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        paths = [
            file.parent / line if os.path.isfile(file.parent / line) else self.root / line
            for line in lines
        ]
        missing = [
            line for line, path in zip(lines, paths, strict=True) if not os.path.isfile(path)
        ]
        if missing:
            raise LabelFileError(
                f"{file}: {len(missing)} images do not exist; the first: {shortened(missing[0])}."
            )
        listed = {real_path(path) for path in paths}
        folders = list(dict.fromkeys(path.parent for path in paths))
        items = [item for folder in folders for item in self._entry(str(folder.absolute()), split)]
        return [item for item in items if real_path(item.path) in listed]

    def _nested(self, path: Path, split: str) -> list[LabelledImage]:
        """The same split of another data.yaml; classes that this data.yaml does not name are marked
        as not labelled.
        """
        if self._is_alone:
            self._notes.append(
                f"Images of {path} for '{split}' that have separate pseudo-labels are left out."
            )
            return []
        data = read_data_yaml(path, within=self._within)
        named = np.isin(np.arange(len(ROAD_CLASSES)), data.road_class_id)
        return [
            replace(item, truth=replace(item.truth, is_complete=item.truth.is_complete & named))
            for item in (data.train if split == "train" else data.val)
        ]

    def _labels_of(self, images: Path) -> Path:
        if self.document.labels:
            return self._folder(self.document.labels)
        parts = list(images.parts)
        if "images" in parts:
            parts[len(parts) - 1 - parts[::-1].index("images")] = "labels"
        folder = Path(*parts)
        if not os.path.isdir(folder):
            raise LabelFileError(
                f"{folder}: expected a folder of labels, found none; specify it with 'labels:' in "
                f"{self._path.name}."
            )
        return folder

    def _folder(self, entry: str) -> Path:
        folder = self.root / entry
        if not os.path.isdir(folder):
            raise LabelFileError(
                f"{self._path}: expected a folder {shortened(str(folder), _MAX_SHOWN)}, found none."
            )
        return folder

    def _known_classes(self) -> BoolArray | None:
        """(8,) road classes of the detector that made the pseudo-labels; None = their scores are no
        probabilities.
        """
        pseudo_names = self.document.pseudo_names
        if self.document.pseudo_scores != "probabilities":
            if pseudo_names is not None:
                raise LabelFileError(
                    f"{self._path}: pseudo_names: requires `pseudo_scores: probabilities`, found "
                    "none."
                )
            return None
        names = self.names if pseudo_names is None else pseudo_names
        road = map_to_road_classes(names)
        if pseudo_names is not None and (road < 0).any():
            name = names[int((road < 0).argmax())]
            raise LabelFileError(
                f"{self._path}: pseudo_names: expected road classes, found {quoted(name)}."
            )
        return np.isin(np.arange(len(ROAD_CLASSES)), road)

    def pseudo_labels_of(self, item: LabelledImage) -> tuple[Path, YoloLabels]:
        """The file of an image's pseudo-labels and its content, which is empty if the file does not
        exist.
        """
        file = self._folder(self.document.labels_pseudo or "") / f"{item.path.stem}.txt"
        if not file.is_file():
            return file, YoloLabels(np.zeros((0, 4)), np.zeros(0, np.int64), np.zeros(0), ())
        return file, self._labels.read(file)

    def _with_pseudo_labels(self, item: LabelledImage, known: BoolArray | None) -> LabelledImage:
        """The image with its pseudo-labels added to its labels.

        `known` (8,) are the classes that count as completely labelled with pseudo-labels, whose
        scores are probabilities; None = scores are compared with thresholds.
        """
        truth, is_soft = item.truth, known is not None
        file, pseudo = self.pseudo_labels_of(item)
        if is_soft and (pseudo.score > 1).any():
            raise LabelFileError(
                f"{file}: expected probabilities of at most 1, found {pseudo.score.max():g}."
            )
        is_new = iou(pseudo.xyxy, truth.xyxy_px).max(axis=1, initial=0.0) < _SAME_OBJECT_IOU
        class_id, score = pseudo.class_id[is_new], pseudo.score[is_new]
        min_score = np.where(class_id == _CAR, _MIN_CAR_SCORE, _MIN_SCORE)
        is_object = (is_soft | (score >= min_score)) & ~truth.is_complete[class_id]
        combined = ImageTruth(
            np.concatenate([truth.xyxy_px, pseudo.xyxy[is_new]]),
            np.concatenate([truth.class_id, class_id]),
            np.concatenate([truth.is_ignored, ~is_object]),
            np.concatenate([truth.is_region, np.zeros(len(is_object), np.bool_)]),
            truth.is_complete if known is None else truth.is_complete | known,
            np.concatenate([truth.confidence, score if is_soft else np.ones(len(is_object))]),
        )
        return replace(item, truth=combined)


def _first_of_each(items: Sequence[LabelledImage]) -> list[LabelledImage]:
    """The images without the repetitions by which lists of images draw rare images more often."""
    return list({real_path(item.path): item for item in reversed(items)}.values())[::-1]


def _with_sitting_persons(item: LabelledImage) -> LabelledImage:
    """The image with KITTI's Person_sitting as persons, although KITTI's evaluation ignores this
    type.
    """
    truth = item.truth
    if not are_valid_boxes(truth.xyxy_px).all():
        raise LabelFileError(
            f"{item.path}: labels: expected finite boxes with a positive width and height."
        )
    is_sitting = (truth.class_id == _PERSON) & truth.is_ignored & ~truth.is_region
    return replace(item, truth=replace(truth, is_ignored=truth.is_ignored & ~is_sitting))
