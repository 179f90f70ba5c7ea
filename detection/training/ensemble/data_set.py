"""Pseudo-labels of a data set: an ensemble of detectors labels the training images of a data.yaml.

    data = read_own_labels(Path("data.yaml"))
    out = Path("labels_soft")
    members = [EnsembleMember(path, out / DETECTIONS) for path in models]
    unreadable = store_missing(data.image_files, members)
    outcome = label_training_images(data, members, out, unreadable=unreadable)

The probabilities are fitted on the training images and verified on the validation images.

Pseudo-labels of one image: the fused boxes that supplement its labels, with their probabilities.

A class that is not completely labelled in the image gets the boxes of at least a minimum
probability. A completely labelled class gets boxes of high probability that overlap no label, which
training ignores: they are probably objects without a label, or objects of a kind that the data set
does not count.

Detections of a detector that is not at hand can be combined with the ensemble, as another opinion
of equal weight on the classes that are not completely labelled. With its score s, or s = 0.12 where
it has no box,

    q = sigma((logit(p) + logit(s)) / 2), and at least 0.6 s where it has a box;    0.75 s where the ensemble has none
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import expit, logit

from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.evaluation.score_calibration import Reliability
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.formats.image_labels.yolo_labels import YoloLabels
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.training.data_yaml import OwnLabels
from track_range.detection.training.ensemble.calibration import (
    MIN_POSITIVES,
    EnsembleCalibration,
    fit_calibration,
    reliability,
    samples,
)
from track_range.detection.training.ensemble.fusion import FusedBoxes, fuse
from track_range.detection.training.ensemble.views import EnsembleMember
from track_range.detection.training.errors import TrainingError
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape
from track_range.foundation.files.atomic_files import writable, write_text
from track_range.foundation.files.input_files import shortened

MIN_IGNORED_PROBABILITY = 0.6  # minimum probability of a box of a completely labelled class
_SAME_OBJECT_IOU = 0.5  # IoU above which two boxes show the same object
# of the other detector without a box, about half of the lowest that is stored, 0.25
_MISSING_SCORE = 0.12
# limits of the probabilities that are combined, so that log-odds are finite
_LOWEST, _HIGHEST = 0.02, 0.98
_LEAST_FRACTION = 0.6  # fraction of the other detector's score that its boxes have at least
# of the score of a box that only the other detector has, though the ensemble knows the class
_ALONE_FRACTION = 0.75


@dataclass(frozen=True, slots=True)
class PseudoLabels:
    """The K pseudo-labels of one image."""

    xyxy: FloatArray  # (K, 4) left, top, right, bottom as fractions of the image size
    class_id: IntArray  # (K,) road class
    probability: FloatArray  # (K,) probability that there is such an object
    is_ignored: BoolArray  # (K,) the class is completely labelled, so that training ignores the box

    def __post_init__(self) -> None:
        check_shape("xyxy", self.xyxy, (len(self.class_id), 4))
        for name in ("class_id", "probability", "is_ignored"):
            check_shape(name, getattr(self, name), (len(self.class_id),))

    def as_text(self, names: Sequence[str]) -> str:
        """Lines `class cx cy w h probability` with the class numbers of `names`, without classes
        that have no name.
        """
        road = map_to_road_classes(names).tolist()
        centre, size = (
            (self.xyxy[:, :2] + self.xyxy[:, 2:]) / 2,
            self.xyxy[:, 2:] - self.xyxy[:, :2],
        )
        rows = zip(
            self.class_id.tolist(),
            np.hstack([centre, size]).tolist(),
            self.probability.tolist(),
            strict=True,
        )
        return "".join(
            f"{road.index(class_id)} {' '.join(f'{value:.6f}' for value in box)} {p:.3f}\n"
            for class_id, box, p in rows
            if class_id in road
        )


def pseudo_labels(
    xyxy: FloatArray,
    probability: FloatArray,
    truth: ImageTruth,
    *,
    is_known: BoolArray,
    other: YoloLabels | None = None,
    min_probability: float = 0.1,
) -> PseudoLabels:
    """The pseudo-labels of one image; none of them overlaps a label by an IoU of more than 0.5.

    `xyxy` (K, 4) are fused boxes, as fractions of the image size, with probabilities by class (K,
    8). `is_known` (8,) are classes that a detector of the ensemble knows; boxes of other classes
    are not used. `other` are detections of a detector that is not at hand; `min_probability` is for
    classes that are not completely labelled.
    """
    is_open = is_known & ~truth.is_complete
    q = (
        probability
        if other is None
        else np.where(is_open, _combined(xyxy, probability, other), probability)
    )
    minimum = np.where(truth.is_complete, MIN_IGNORED_PROBABILITY, min_probability)
    box, classes = np.nonzero((q >= minimum) & (q > 0) & is_known)
    boxes, p = xyxy[box], q[box, classes]
    if other is not None:
        alone = ~truth.is_complete[other.class_id]
        alone &= ~(is_open[other.class_id] & (iou(xyxy, other.xyxy) > _SAME_OBJECT_IOU).any(axis=0))
        p_alone = other.score * np.where(is_known, _ALONE_FRACTION, 1.0)[other.class_id]
        alone &= p_alone >= min_probability
        added = (other.xyxy, other.class_id, p_alone)
        boxes, classes, p = (
            np.concatenate([old, new[alone]])
            for old, new in zip((boxes, classes, p), added, strict=True)
        )
    boxes = np.clip(boxes, 0.0, 1.0)
    is_new = iou(boxes, truth.xyxy_px).max(axis=1, initial=0.0) <= _SAME_OBJECT_IOU
    return PseudoLabels(
        boxes[is_new], classes[is_new], p[is_new], truth.is_complete[classes[is_new]]
    )


def _combined(xyxy: FloatArray, probability: FloatArray, other: YoloLabels) -> FloatArray:
    """(K, 8) mean log-odds of the fused boxes and of another detector's boxes; 0 where neither has
    the class.
    """
    other_score = np.zeros((len(xyxy), len(ROAD_CLASSES)))
    box, detection = np.nonzero(iou(xyxy, other.xyxy) > _SAME_OBJECT_IOU)
    np.maximum.at(other_score, (box, other.class_id[detection]), other.score[detection])
    is_seen = other_score > 0
    s = np.where(is_seen, np.minimum(other_score, _HIGHEST), _MISSING_SCORE)
    p = np.clip(probability, _LOWEST, _HIGHEST)
    q = expit((logit(p) + logit(s)) / 2)
    q = np.where(is_seen, np.maximum(q, _LEAST_FRACTION * s), q)
    return np.where(is_seen | (probability > 0), q, 0.0)


# folder of the detectors' boxes in the folder of pseudo-labels, while a run is not finished
DETECTIONS = "detections"
COUNTED_PROBABILITIES = (0.1, 0.3, 0.6)


@dataclass(frozen=True, slots=True)
class PseudoLabelFigures:
    """Pseudo-labels of a data set in figures."""

    # named road classes that at least one detector knows, in increasing order
    known_class_id: IntArray
    # (8, 3) of at least each of `COUNTED_PROBABILITIES`, in images that lack labels of the class
    n_labels: IntArray
    # (8,) number of boxes to ignore, in images in which the class is completely labelled
    n_ignored: IntArray
    calibration: EnsembleCalibration  # the fitted coefficients
    # by road class that is labelled, the calibration on the validation images
    validation: dict[int, Reliability]


def usable_classes(data: OwnLabels, members: Sequence[EnsembleMember]) -> BoolArray:
    """(D, 8) named road classes that each detector knows; LabelFileError for no class, or too few
    labels for a fit.
    """
    usable = np.array([member.is_known & data.is_named for member in members])
    if not usable.any():
        raise LabelFileError(
            f"{data.path}: expected class names that the detectors have, found "
            f"{shortened(', '.join(data.names))}; choose other detectors."
        )
    is_usable = usable.any(axis=0)
    labelled = [
        item.truth.class_id[(item.truth.is_complete & is_usable)[item.truth.class_id]]
        for item in data.train
    ]
    n_labels = np.bincount(np.concatenate(labelled), minlength=1)
    if n_labels.max() < MIN_POSITIVES:
        raise LabelFileError(
            f"{data.path}: expected at least {MIN_POSITIVES} labels of a class that is completely "
            f"labelled, to fit probabilities; found {n_labels.max()}."
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
    """Write the pseudo-labels of every training image to `out`, NAME.txt with lines `class cx cy w
    h probability`.

    The boxes of all images except `unreadable` images must be stored (`views.store_missing`).
    `min_probability` applies to pseudo-labels of classes that are not completely labelled;
    `progress` is called after each image. Raises LabelFileError: too few fused boxes match labels
    to fit probabilities, or the detectors know no class. Raises TrainingError: the boxes of an
    image are not stored, or a file cannot be written.
    """
    usable = usable_classes(data, members)
    is_known: BoolArray = np.asarray(usable.any(axis=0))
    train = [item for item in data.train if item.path not in unreadable]
    val = [item for item in data.val if item.path not in unreadable]

    pairs: list[tuple[FusedBoxes, ImageTruth]] = []
    for item in (*train, *val):
        pairs.append((fuse([member.boxes(item.path) for member in members]), item.truth))
        progress(len(pairs), len(train) + len(val))
    fitted = samples(pairs[: len(train)], n_detectors=len(members), is_labelled=data.is_named)
    calibration = fit_calibration(fitted, usable)
    if calibration is None:
        most = max(int(np.count_nonzero(boxes.is_match)) for boxes in fitted)
        raise LabelFileError(
            f"{data.path}: to fit probabilities, the detectors must find at least {MIN_POSITIVES} "
            f"labels of a completely labelled class, but found {most}; use other detectors or "
            "labels with --resume, or delete the --out folder."
        )
    verified = samples(pairs[len(train) :], n_detectors=len(members), is_labelled=data.is_named)
    validation = {
        class_id: reliability(calibration, boxes, class_id)
        for class_id, boxes in enumerate(verified)
        if is_known[class_id] and len(boxes.score)
    }
    n_labels = np.zeros((len(ROAD_CLASSES), len(COUNTED_PROBABILITIES)), np.int64)
    n_ignored = np.zeros(len(ROAD_CLASSES), np.int64)
    for item, (boxes, _) in zip(train, pairs, strict=False):
        labels = pseudo_labels(
            boxes.xyxy,
            calibration.probability(boxes.score),
            item.truth,
            is_known=is_known,
            other=None if data.labels_pseudo is None else data.labels_pseudo[item.path],
            min_probability=min_probability,
        )
        file = out / f"{item.path.stem}.txt"
        with writable(file, TrainingError):
            write_text(file, labels.as_text(data.names), is_flushed=False)
        np.add.at(n_ignored, labels.class_id[labels.is_ignored], 1)
        for i, minimum in enumerate(COUNTED_PROBABILITIES):
            np.add.at(
                n_labels[:, i],
                labels.class_id[~labels.is_ignored & (labels.probability >= minimum)],
                1,
            )
    return PseudoLabelFigures(
        np.flatnonzero(is_known), n_labels, n_ignored, calibration, validation
    )
