"""LabelledSource: images with their labels, from a folder of images or the frames of a video."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, road_class_ids
from track_range.detection.formats.image_truth import ImageTruth
from track_range.detection.formats.kitti import LabelFileError
from track_range.detection.formats.labelled_images import (
    ImageFileError,
    LabelFormat,
    LabelledImage,
    of_split,
    read_image,
    read_labelled,
    read_manifest,
    read_sequence,
)
from track_range.foundation.arrays import Image
from track_range.foundation.errors import UsageError
from track_range.video.reader import VideoReader


class LabelledFrames(Protocol):
    """Images with their labels, one by one, and how many there are."""

    @property
    def n_images(self) -> int | None:
        """To expect; None = unknown."""
        ...

    @property
    def unreadable(self) -> Sequence[str]:
        """A sentence on each image that could not be read and was left out, so far."""
        ...

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]:
        """(H, W, 3) uint8 BGR with its labels in its pixels."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledSource:
    """Where the images and labels of an evaluation come from.

    Attributes:
        images: folder of images, or a video.
        labels: folder or file of labels.
        label_format: "yolo", "kitti" or "coco"; None = KITTI for a video, COCO for a .json file, else YOLO.
        label_names: class names of YOLO's numbers; None = what lies beside the labels, or the road classes.
        manifest: which images belong to which split, and which classes are labelled completely.
        split: of the manifest.
        leave_out: images of the folder that are not to be measured on.
        classes: road classes to measure; empty = all.
    """

    images: Path
    labels: Path
    label_format: LabelFormat | None = None
    label_names: tuple[str, ...] | None = None
    manifest: Path | None = None
    split: str = "val"
    leave_out: frozenset[Path] = frozenset()
    classes: tuple[str, ...] = ()

    @property
    def is_video(self) -> bool:
        """Images are frames of a video."""
        return self.images.is_file()

    @property
    def format(self) -> LabelFormat:
        """The labels' format, given or guessed."""
        if self.label_format is not None:
            return self.label_format
        if self.is_video:
            return "kitti"
        return "coco" if self.labels.suffix.lower() == ".json" else "yolo"

    def of_classes(self, truth: ImageTruth) -> ImageTruth:
        """The labels with only the chosen classes to be counted.

        Raises:
            ClassNameError: a class is unknown.
        """
        if not self.classes:
            return truth
        is_chosen = np.isin(np.arange(len(ROAD_CLASSES)), road_class_ids(self.classes))
        return replace(truth, is_complete=truth.is_complete & is_chosen)

    def labelled_files(self) -> list[LabelledImage]:
        """The images of the folder with their labels, all of the split where there is a manifest.

        Raises:
            LabelFileError, ImageFileError: labels or images cannot be read.
        """
        found = read_labelled(self.images, self.labels, self.format, names=self.label_names)
        if self.manifest is None:
            return found
        manifest = read_manifest(self.manifest)
        if wanted := of_split(found, manifest, self.split):
            return wanted
        splits = ", ".join(sorted({row.split for row in manifest.values()}))
        raise LabelFileError(f"{self.manifest}: no image is of the split '{self.split}' in it; it has: {splits}.")

    def open(self) -> LabelledFrames:
        """Read all labels.

        Raises:
            ClassNameError: a chosen class is unknown.
            UsageError: a video with labels other than KITTI's of a sequence.
            LabelFileError, ImageFileError, VideoError: labels, images or video cannot be read.
        """
        road_class_ids(self.classes)
        if not self.is_video:
            return _FolderFrames(self)
        if self.format != "kitti" or not self.labels.is_file() or self.manifest is not None:
            raise UsageError(
                "the frames of a video need one file of KITTI tracking labels: --format kitti --labels FILE."
            )
        return _VideoFrames(self)


class _FolderFrames:
    def __init__(self, source: LabelledSource) -> None:
        self._of_classes = source.of_classes
        self._found = [item for item in source.labelled_files() if item.path not in source.leave_out]
        if not self._found:
            raise LabelFileError(f"{source.images}: no labelled images are left to measure on.")
        self.n_images = len(self._found)
        self.unreadable: list[str] = []

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]:
        for item in self._found:
            try:
                image = read_image(item.path)
            except ImageFileError as error:
                self.unreadable.append(str(error))
                continue
            yield image, self._of_classes(item.truth_in(image))


class _VideoFrames:
    unreadable: Sequence[str] = ()

    def __init__(self, source: LabelledSource) -> None:
        self._of_classes, self._truth = source.of_classes, read_sequence(source.labels)
        self._video = VideoReader(source.images)
        self.n_images = self._video.n_frames

    def __iter__(self) -> Iterator[tuple[Image, ImageTruth]]:
        for frame in self._video:
            yield frame.image, self._of_classes(self._truth(frame.index))
