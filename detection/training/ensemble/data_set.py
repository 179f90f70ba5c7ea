"""Pseudo-labels of a data set: an ensemble of detectors labels the training images of a data.yaml.

    data = read_own_labels(Path("data.yaml"))
    out = Path("labels_soft")
    members = [EnsembleMember(path, out / DETECTIONS) for path in models]
    unreadable = store_missing(data.image_files, members)
    outcome = label_training_images(data, members, out, unreadable=unreadable)

The probabilities are fitted on the training images and verified on the validation images.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.evaluation.score_calibration import Reliability
from track_range.detection.formats.errors import LabelFileError
from track_range.detection.training.data.data_yaml import OwnLabels
from track_range.detection.training.ensemble.calibration import (
    MIN_POSITIVES,
    EnsembleCalibration,
    fit_calibration,
    reliability,
    samples,
)
from track_range.detection.training.ensemble.fusion import FusedBoxes, fuse
from track_range.detection.training.ensemble.pseudo_labels import pseudo_labels
from track_range.detection.training.ensemble.views import EnsembleMember
from track_range.detection.training.errors import TrainingError
from track_range.foundation.arrays import BoolArray, IntArray
from track_range.foundation.files.atomic_files import describe, write_text
from track_range.foundation.files.input_files import real_path, shortened

DETECTIONS = "detections"
"""Folder of the detectors' boxes in the folder of pseudo-labels, while a run is not finished."""

COUNTED_PROBABILITIES = (0.1, 0.3, 0.6)


@dataclass(frozen=True, slots=True)
class PseudoLabelFigures:
    """Pseudo-labels of a data set in figures.

    Attributes:
        n_labels: (8, 3) number of pseudo-labels by class of at least each of `COUNTED_PROBABILITIES`, in images in
            which the class is not completely labelled.
    """

    known_class_id: IntArray  # named road classes that at least one detector knows, in increasing order
    n_labels: IntArray
    n_ignored: IntArray  # (8,) number of boxes to ignore, in images in which the class is completely labelled
    calibration: EnsembleCalibration  # the fitted coefficients
    validation: dict[int, Reliability]  # by road class that is labelled, the calibration on the validation images


def usable_classes(data: OwnLabels, members: Sequence[EnsembleMember]) -> BoolArray:
    """(D, 8) named road classes that each detector knows; LabelFileError if none, or too few labels to fit."""
    usable = np.array([member.is_known & data.is_named for member in members])
    if not usable.any():
        raise LabelFileError(
            f"{data.path}: expected names that the detectors know, found {shortened(', '.join(data.names))}; choose "
            "other detectors."
        )
    is_usable = usable.any(axis=0)
    labelled = [item.truth.class_id[(item.truth.is_complete & is_usable)[item.truth.class_id]] for item in data.train]
    n_labels = np.bincount(np.concatenate(labelled), minlength=1)
    if n_labels.max() < MIN_POSITIVES:
        raise LabelFileError(
            f"{data.path}: expected at least {MIN_POSITIVES} labels of a class that is completely labelled, to fit "
            f"probabilities; found {n_labels.max()}."
        )
    return usable


def label_training_images(
    data: OwnLabels,
    members: Sequence[EnsembleMember],
    out: Path,
    *,
    unreadable: Collection[Path] = (),
    min_probability: float = 0.1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> PseudoLabelFigures:
    """Write the pseudo-labels of every training image to `out`, NAME.txt with lines `class cx cy w h probability`.

    Args:
        data: the images and their labels.
        members: the detectors, which have stored the boxes of all images (`views.store_missing`).
        out: an existing folder.
        unreadable: images that are left out.
        min_probability: that of pseudo-labels of classes that are not completely labelled.
        progress: called after each image with the number of images whose boxes are fused, and their total.

    Raises:
        LabelFileError: too few fused boxes match labels to fit probabilities, or the detectors know no class.
        TrainingError: the boxes of an image are not stored, or a file cannot be written.
    """
    usable = usable_classes(data, members)
    is_known: BoolArray = np.asarray(usable.any(axis=0))
    train = [item for item in data.train if item.path not in unreadable]
    val = [item for item in data.val if item.path not in unreadable]

    fused: list[FusedBoxes] = []
    for item in (*train, *val):
        fused.append(fuse([member.boxes(item.path) for member in members]))
        progress(len(fused), len(train) + len(val))
    pairs = [(boxes, item.truth) for boxes, item in zip(fused, (*train, *val), strict=True)]
    fitted = samples(pairs[: len(train)], n_detectors=len(members), is_labelled=data.is_named)
    calibration = fit_calibration(fitted, usable)
    if calibration is None:
        most = max(int(np.count_nonzero(of_class.is_match)) for of_class in fitted)
        raise LabelFileError(
            f"{data.path}: expected at least {MIN_POSITIVES} labels of a completely labelled class that the detectors "
            f"find, to fit probabilities; found {most}; use other detectors or labels with --resume, or delete --out."
        )
    verified = samples(pairs[len(train) :], n_detectors=len(members), is_labelled=data.is_named)
    validation = {
        class_id: reliability(calibration, of_class, class_id)
        for class_id, of_class in enumerate(verified)
        if is_known[class_id] and len(of_class.score)
    }
    n_labels = np.zeros((len(ROAD_CLASSES), len(COUNTED_PROBABILITIES)), np.int64)
    n_ignored = np.zeros(len(ROAD_CLASSES), np.int64)
    for item, boxes in zip(train, fused[: len(train)], strict=True):
        labels = pseudo_labels(
            boxes.xyxy,
            calibration.probability(boxes.score),
            item.truth,
            is_known=is_known,
            other=None if data.labels_pseudo is None else data.labels_pseudo[item.path],
            min_probability=min_probability,
        )
        file = out / f"{item.path.stem}.txt"
        try:
            write_text(file, labels.as_text(data.names), is_flushed=False)
        except OSError as error:
            raise TrainingError(f"{file}: cannot be written ({describe(error)}).") from error
        np.add.at(n_ignored, labels.class_id[labels.is_ignored], 1)
        for i, minimum in enumerate(COUNTED_PROBABILITIES):
            np.add.at(n_labels[:, i], labels.class_id[~labels.is_ignored & (labels.probability >= minimum)], 1)
    return PseudoLabelFigures(np.flatnonzero(is_known), n_labels, n_ignored, calibration, validation)


def is_validated_on_training_images(data: OwnLabels) -> bool:
    """Whether validation images are training images too, so that the calibration is not verified independently."""
    train = {real_path(item.path) for item in data.train}
    return any(real_path(item.path) in train for item in data.val)
