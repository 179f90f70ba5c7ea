"""Reader of labelled images with YOLO, KITTI or COCO labels.

    yolo   one NAME.txt per image: `class cx cy w h` as fractions of the image size
    kitti  one NAME.txt per image (object labels), or one file per sequence (tracking labels), by frame number
    coco   one JSON file: images, annotations (bbox x y w h in pixels, iscrowd), categories

YOLO and COCO labels use the corner convention (the image's left edge is 0); half a pixel is subtracted, so that pixel
centres are at integers. KITTI labels are used without change (`detection.formats.video_labels.kitti`).
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from track_range.detection.boxes import HALF_PIXEL_PX
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.formats.image_labels.image_truth import ImageTruth, truth_of_kitti
from track_range.detection.formats.image_labels.yolo_labels import YoloLabelReader
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.tables.table_checks import frame_in_name, ignored_note
from track_range.detection.formats.video_labels.coco import CocoFile
from track_range.detection.formats.video_labels.kitti import read_kitti, read_kitti_image
from track_range.foundation.arrays import BoolArray, Image
from track_range.foundation.errors import UserError
from track_range.foundation.files import images as image_files
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.images import IMAGE_SUFFIXES
from track_range.foundation.files.input_files import quoted, readable


class ImageFileError(UserError):
    """An image or folder of images that cannot be read; the message has its path."""


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """One image and its labels."""

    path: Path  # the image file
    truth: ImageTruth  # its labels
    # the boxes of `truth` are fractions of the image size, in the corner convention
    is_normalised: bool
    notes: tuple[str, ...] = ()  # notes for the user on labels that were clipped or ignored

    def truth_in(self, image: Image) -> ImageTruth:
        """The labels in pixels of `image`."""
        if not self.is_normalised:
            return self.truth
        height, width = image.shape[:2]
        return replace(
            self.truth, xyxy_px=self.truth.xyxy_px * np.array([width, height, width, height]) - 0.5
        )


def read_image(path: Path) -> Image:
    """An image as BGR, from colour or grey of 8 or 16 bits, rotated according to EXIF;
    ImageFileError if invalid.
    """
    return np.asarray(image_files.read_image(path, ImageFileError), np.uint8)


def images_in(folder: Path) -> list[Path]:
    """The paths of the images in a folder, sorted by name; ImageFileError if there are none."""
    if not folder.is_dir():
        raise ImageFileError(f"{folder}: expected a folder of images, found none.")
    with readable(folder, ImageFileError):
        paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    if not paths:
        raise ImageFileError(
            f"{folder}: expected images ({', '.join(sorted(IMAGE_SUFFIXES))}), found none."
        )
    return paths


def read_labelled(
    images: Path, labels: Path, label_format: str, *, names: Sequence[str] | None = None
) -> list[LabelledImage]:
    """The images of a folder that have labels, sorted by name; LabelFileError if there are none or
    they are invalid.

    `labels` is a folder of label files, or the file of a COCO data set or a KITTI sequence;
    `label_format` is a name in `IMAGE_LABELS`; `names` are class names for the numbers in YOLO
    labels, by default the names for the folder.
    """
    labelled = IMAGE_LABELS[label_format](images_in(images), labels, names)
    if not labelled:
        raise LabelFileError(
            f"{labels}: no labels for any image in {images}; check the folders and --format."
        )
    return labelled


def read_sequence(labels: Path) -> Callable[[int], ImageTruth]:
    """Function that returns the truth of a frame number, from KITTI tracking labels."""
    rows = read_kitti(labels)
    return lambda frame: truth_of_kitti(rows.select(rows.frame == frame))


def read_manifest(path: Path) -> dict[str, tuple[str, BoolArray]]:
    """The split and the (8,) mask of completely labelled road classes of each file in a CSV. Raises
    LabelFileError.

    Its columns are file, split, and labels_complete: eight flags such as 10111100, in the order of
    the road classes.
    """
    table = read_csv_table(path, LabelFileError, "columns file, split, labels_complete")
    table.require(("file", "split", "labels_complete"))
    manifest = {}
    columns = (table.texts("file"), table.texts("split"), table.texts("labels_complete"))
    for row, (file, split, flags) in enumerate(zip(*columns, strict=True)):
        if len(flags) != len(ROAD_CLASSES) or set(flags) - {"0", "1"}:
            raise table.fault(
                row,
                f"labels_complete: expected {len(ROAD_CLASSES)} flags 0 or 1, got {quoted(flags)}.",
            )
        manifest[file] = (split, np.array([flag == "1" for flag in flags]))
    return manifest


def of_split(
    labelled: Sequence[LabelledImage], manifest: Mapping[str, tuple[str, BoolArray]], split: str
) -> list[LabelledImage]:
    """The images of one split of a manifest, with the manifest's completely labelled classes."""
    complete_by_name = {
        name: is_complete for name, (listed, is_complete) in manifest.items() if listed == split
    }
    return [
        replace(item, truth=replace(item.truth, is_complete=complete_by_name[item.path.name]))
        for item in labelled
        if item.path.name in complete_by_name
    ]


def _with_files(paths: Sequence[Path], folder: Path) -> Iterator[tuple[Path, Path]]:
    return ((path, file) for path in paths if (file := folder / f"{path.stem}.txt").is_file())


def _yolo(paths: Sequence[Path], folder: Path, names: Sequence[str] | None) -> list[LabelledImage]:
    reader = YoloLabelReader(names, folder)
    read = ((path, reader.read(file)) for path, file in _with_files(paths, folder))
    return [
        LabelledImage(path, ImageTruth.of(of.xyxy, of.class_id), True, of.notes)
        for path, of in read
    ]


def _kitti(paths: Sequence[Path], labels: Path, names: Sequence[str] | None) -> list[LabelledImage]:
    if not labels.is_file():
        files = _with_files(paths, labels)
        return [
            LabelledImage(path, truth_of_kitti(read_kitti_image(file)), False)
            for path, file in files
        ]
    by_frame = read_sequence(labels)
    numbers = ((path, frame_in_name(path.stem)) for path in paths)
    return [
        LabelledImage(path, by_frame(number), False)
        for path, number in numbers
        if number is not None
    ]


def _coco(paths: Sequence[Path], file: Path, names: Sequence[str] | None) -> list[LabelledImage]:
    """The images that a COCO file has labels for, by file name without folder."""
    coco = CocoFile(file)
    boxes, n_empty = coco.boxes({image_id: number for number, image_id in enumerate(coco.images)})
    boxes_of = defaultdict(list)
    for box, road in zip(
        boxes, map_to_road_classes([box.class_name for box in boxes]).tolist(), strict=True
    ):
        if road >= 0:
            boxes_of[box.frame].append((box, road))
    file_names = {path.name for path in paths}
    number_of: dict[str, int] = {}
    for number, image in enumerate(coco.images.values()):
        name = Path(coco.file_name(image, number)).name
        if name in file_names and number_of.setdefault(name, number) != number:
            raise LabelFileError(
                f"{file}, images[{number}]: expected each file name once, found "
                f"{quoted(name)} twice."
            )
    labelled: list[LabelledImage] = []
    for path in paths:
        if (number := number_of.get(path.name, -1)) < 0:
            continue
        labels = boxes_of[number]
        xyxy_px = (
            np.array([box.xyxy for box, _ in labels], np.float64).reshape(-1, 4) - HALF_PIXEL_PX
        )
        truth = ImageTruth.of(
            xyxy_px, [road for _, road in labels], is_region=[box.is_region for box, _ in labels]
        )
        notes = () if labelled else ignored_note(file, n_empty, "without width or height")
        labelled.append(LabelledImage(path, truth, False, notes))
    return labelled


IMAGE_LABELS: Mapping[
    str, Callable[[Sequence[Path], Path, Sequence[str] | None], list[LabelledImage]]
] = {
    "yolo": _yolo,
    "kitti": _kitti,
    "coco": _coco,
}
"""Readers by format; their arguments are the images, the folder or file of labels, and YOLO's class
names."""
