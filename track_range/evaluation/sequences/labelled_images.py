"""LabelledSource: images with their labels, from a folder of images or the frames of a video."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, road_class_ids
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.formats.image_labels.labelled_images import (
    ImageFileError,
    LabelledImage,
    of_split,
    read_image,
    read_labelled,
    read_manifest,
    read_sequence,
)
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import Image
from track_range.foundation.errors import UsageError
from track_range.recording.sources.open_video import open_video


class LabelledFrames(Protocol):
    """Iterates over images with their labels."""

    @property
    def n_images(self) -> int | None:
        """Expected number of images; None = unknown."""

    @property
    def unreadable(self) -> Sequence[str]:
        """One sentence per image that was skipped because it cannot be read."""

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]:
        """Pairs of an image, (H, W, 3) uint8 BGR, and its labels in pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledSource:
    """The images and labels of an evaluation."""

    images: Path  # folder of images, or a video
    labels: Path  # folder or file of labels
    # in `IMAGE_LABELS`; None = KITTI for a video, COCO for a .json file, else YOLO
    label_format: str | None = None
    # of YOLO's numbers; None = of a file beside them, or the road classes
    label_names: tuple[str, ...] | None = None
    # CSV file with the split of each image and its completely labelled classes
    manifest: Path | None = None
    split: str = "val"  # split of the manifest to use
    leave_out: frozenset[Path] = frozenset()  # images of the folder to exclude
    classes: tuple[str, ...] = ()  # road classes to evaluate; empty = all

    @property
    def is_video(self) -> bool:
        """Whether the images are frames of a video."""
        return self.images.is_file()

    @property
    def format(self) -> str:
        """The format of the labels, given or detected from the file names."""
        if self.label_format is not None:
            return self.label_format
        if self.is_video:
            return "kitti"
        return "coco" if self.labels.suffix.lower() == ".json" else "yolo"

    def class_truth(self, truth: ImageTruth) -> ImageTruth:
        """The labels, with only the chosen classes evaluated."""
        if not self.classes:
            return truth
        is_chosen = np.isin(np.arange(len(ROAD_CLASSES)), road_class_ids(self.classes))
        return replace(truth, is_complete=truth.is_complete & is_chosen)

    def labelled_files(self) -> list[LabelledImage]:
        """The images of the folder, or of the manifest's split, with their labels."""
        images = read_labelled(self.images, self.labels, self.format, names=self.label_names)
        if self.manifest is None:
            return images
        manifest = read_manifest(self.manifest)
        if split_images := of_split(images, manifest, self.split):
            return split_images
        splits = ", ".join(sorted({split for split, _ in manifest.values()}))
        raise LabelFileError(
            f"{self.manifest}: no image in the split '{self.split}'; splits in the file: {splits}."
        )

    def open(self) -> LabelledFrames:
        """Read all labels and open the images.

        Raises ClassNameError for an unknown class, UsageError for a video whose labels are not one
        KITTI tracking file, LabelFileError, ImageFileError or VideoError if labels, images or the
        video cannot be read.
        """
        road_class_ids(self.classes)
        if not self.is_video:
            return _FolderFrames(self)
        if self.format != "kitti" or not self.labels.is_file() or self.manifest is not None:
            raise UsageError(
                f"--images {self.images}: a video needs one KITTI tracking file; give --format "
                "kitti --labels FILE."
            )
        return _VideoFrames(self)


class _FolderFrames:
    def __init__(self, source: LabelledSource) -> None:
        self._images = [
            item for item in source.labelled_files() if item.path not in source.leave_out
        ]
        if not self._images:
            raise LabelFileError(
                f"{source.images}: expected labelled images for the evaluation, found none."
            )
        self._class_truth, self.n_images = source.class_truth, len(self._images)
        self.unreadable: list[str] = []

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]:
        for item in self._images:
            try:
                image = read_image(item.path)
            except ImageFileError as error:
                self.unreadable.append(str(error))
                continue
            yield image, self._class_truth(item.truth_in(image))


class _VideoFrames:
    unreadable: Sequence[str] = ()

    def __init__(self, source: LabelledSource) -> None:
        self._class_truth, self._truth = source.class_truth, read_sequence(source.labels)
        self._video = open_video(source.images)
        self.n_images = self._video.n_frames

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]:
        for frame in self._video:
            yield frame.image, self._class_truth(self._truth(frame.index))
