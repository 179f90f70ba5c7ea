"""The choice between readings of a network's outputs, and the check of its boxes, on the first
images.

The right reading gives boxes inside the image, near their grid cells, and neighbouring cells agree
on their size. A wrong reading gives boxes of less than two pixels (fractions taken as pixels),
beyond the image (pixels taken as fractions), or of negative size (centres taken as corners).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from track_range.detection.boxes import area_px2, iou, nms
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.decoders import Candidates
from track_range.detection.yolo.network_outputs import YoloModel
from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32

N_IMAGES = 10  # images on which readings are compared and boxes are checked
_MIN_SCORE = 0.25  # of the boxes that are compared: those below it are often of bad shape
_MAX_COMPARED = 100  # boxes per image
_MIN_BOXES = 3  # of a decision before the last image
_MIN_GARBAGE = 5  # boxes of a failure
_MAX_GARBAGE = 0.8  # fraction of boxes; wrong readings have nearly 1
_MIN_LEAD = 0.1  # in mean quality, of a reading before the next one
_MIN_SIZE_PX = 1.5
_BORDER = 0.25  # of the input's size, that right boxes may exceed it
_FILLING = 0.95  # fraction of the input's area of boxes "of the image's size"
# of boxes of the image's size; a truck in front of the camera is of one or two
_MAX_FILLING_CLASSES = 4
# boxes of the image's size on one image; a truck in front of the camera has some tens
_MAX_FILLING = 200
_MIN_QUALITY = 0.3  # right readings of real networks have 0.6 on road images, wrong ones 0
_LOG_SIZE_SIGMA = 0.5  # of log sizes of neighbouring cells at which they disagree


@dataclass(slots=True)
class _Tally:
    """Boxes of one reading on the images so far."""

    n: int = 0
    quality: float = 0.0  # sum over boxes, from 0 to 1 each
    is_possible: bool = True  # by the reading's own rule

    @property
    def mean(self) -> float:
        return self.quality / self.n if self.n else 0.0


@dataclass(slots=True)
class FirstImages:
    """Choice between the readings of a network; raises ModelError for a reading that gives
    impossible boxes.
    """

    path: Path
    chosen: str = ""  # name of the reading, once it is decided
    why: str = ""
    n_compared: int = 0
    n_checked: int = 0
    n_detected: int = 0  # boxes of any class on the checked images
    _tallies: dict[str, _Tally] = field(default_factory=dict)
    _n_garbage: int = 0
    _n_strong: int = 0
    _has_zero: bool = False  # whether a box had the class number 0

    def compare(
        self,
        readings: Sequence[YoloModel],
        outputs: Sequence[Sequence[FloatArray32]],
        input_hw: tuple[int, int],
    ) -> YoloModel:
        """The best reading so far, from the outputs for one more image, which depend on the
        reading's input format.

        ModelError: after the last image, two readings are equally plausible.
        """
        self._count(readings, outputs, input_hw)
        possible = [reading for reading in readings if self._tallies[reading.name].is_possible]
        usual = (possible or readings)[0]
        ranked = sorted(possible or readings, key=lambda reading: -self._tallies[reading.name].mean)
        best = self._tallies[ranked[0].name]
        second = max((self._tallies[reading.name].mean for reading in ranked[1:]), default=0.0)
        is_clear = best.n > 0 and best.mean > _MIN_QUALITY and best.mean - second >= _MIN_LEAD
        is_last = self.n_compared >= N_IMAGES
        if is_clear and (best.n >= _MIN_BOXES or is_last):
            self.chosen = ranked[0].name
            self.why = (
                f"only its boxes on the first images are plausible ({best.mean:.2f}, next "
                f"{second:.2f})"
            )
        elif is_last:
            if best.n >= _MIN_GARBAGE and best.mean > _MIN_QUALITY:
                raise self._undecided(ranked)
            self.chosen = usual.name
            self.why = (
                "usual for these shapes; the first images have too few boxes for a comparison of "
                "layouts"
            )
        return ranked[0] if is_clear else usual

    def _count(
        self,
        readings: Sequence[YoloModel],
        outputs: Sequence[Sequence[FloatArray32]],
        input_hw: tuple[int, int],
    ) -> None:
        """Add the boxes of one more image."""
        self.n_compared += 1
        for reading, values in zip(readings, outputs, strict=True):
            tally = self._tallies.setdefault(reading.name, _Tally())
            tally.is_possible &= reading.accepts is None or reading.accepts(values)
            quality = _quality(_candidates(reading, values), input_hw)
            tally.n += len(quality)
            tally.quality += float(quality.sum())

    def _undecided(self, ranked: Sequence[YoloModel]) -> ModelError:
        """The error for readings that are about as plausible as the best one, which is the
        first.
        """
        means = {reading.name: self._tallies[reading.name].mean for reading in ranked}
        best = means[ranked[0].name]
        names = " or ".join(name for name, mean in means.items() if best - mean < _MIN_LEAD)
        return ModelError(
            f"{self.path}: its outputs may be read as {names}, and each reading gives "
            "plausible boxes on the first images; choose one with --layout (Python: layout)."
        )

    def check(
        self, reading: YoloModel, outputs: Sequence[FloatArray32], input_hw: tuple[int, int]
    ) -> None:
        """Count the boxes of one more image; ModelError if most of them so far cannot be boxes of
        objects.
        """
        if self.n_checked >= N_IMAGES:
            return
        self.n_checked += 1
        candidates = _candidates(reading, outputs)
        self.n_detected += len(candidates.score) + candidates.n_invalid
        if not reading.is_numbering_known:
            self._check_numbering(candidates)
        filling = area_px2(candidates.xyxy_net) >= _FILLING * input_hw[0] * input_hw[1]
        n_classes = len(np.unique(candidates.class_index[filling]))
        is_filled = n_classes >= _MAX_FILLING_CLASSES or np.count_nonzero(filling) > _MAX_FILLING
        boxes = candidates.xyxy_net
        wrong = ~_are_inside(boxes, input_hw) | (filling if is_filled else False)
        self._n_strong += len(boxes)
        self._n_garbage += int(np.count_nonzero(wrong))
        if self._n_garbage >= _MIN_GARBAGE and self._n_garbage > _MAX_GARBAGE * self._n_strong:
            raise ModelError(
                f"{self.path}: its outputs, read as {reading.name} ({reading.layout}), give boxes "
                f"that are too small, beyond the image or of the whole image ({self._n_garbage} of "
                f"{self._n_strong} on the first images); choose another reading with --layout "
                "(Python: layout; `track-range models info` lists them), or export the network "
                "again (docs/how-to/detectors.md)."
            )

    def _check_numbering(self, candidates: Candidates) -> None:
        """ModelError if class numbers without names may be COCO's ids, which count from 1, since no
        box so far has 0.
        """
        self._has_zero |= bool((candidates.class_index == 0).any())
        if self.n_detected and not self._has_zero:
            raise ModelError(
                f"{self.path}: expected class names, since its class numbers may count COCO's 80 "
                "names from 0 or be COCO's ids from 1, found none; choose with --names coco or "
                "--names coco-ids, or give their names."
            )


def _candidates(reading: YoloModel, outputs: Sequence[FloatArray32]) -> Candidates:
    with np.errstate(over="ignore", invalid="ignore"):
        return reading.decoder(outputs, np.full(len(reading.names), _MIN_SCORE))


def _are_inside(xyxy_net: FloatArray, input_hw: tuple[int, int]) -> BoolArray:
    """(N,) whether boxes are inside the input, within a margin, and not too small."""
    size = xyxy_net[:, 2:] - xyxy_net[:, :2]
    limit = np.array(input_hw[::-1], np.float64)
    is_inside = (xyxy_net[:, :2] >= -_BORDER * limit) & (xyxy_net[:, 2:] <= (1 + _BORDER) * limit)
    return np.asarray((is_inside & (size >= _MIN_SIZE_PX)).all(axis=1))


def _quality(candidates: Candidates, input_hw: tuple[int, int]) -> FloatArray:
    """(M,) quality from 0 to 1 of the boxes after suppression and of invalid boxes."""
    boxes, one_class = candidates.xyxy_net, np.zeros(len(candidates.score), np.int64)
    kept = nms(boxes, candidates.score, one_class, max_iou=0.5, max_boxes=_MAX_COMPARED)
    best, size = boxes[kept], boxes[kept, 2:] - boxes[kept, :2]
    is_right = _are_inside(best, input_hw) & (
        size.prod(axis=1) < _FILLING * input_hw[0] * input_hw[1]
    )
    offset = np.abs((best[:, :2] + best[:, 2:]) / 2 - candidates.cell_px[kept]) / np.maximum(
        size, _MIN_SIZE_PX
    )
    centring = np.nan_to_num(1 - np.clip(offset.max(axis=1, initial=0.0), 0, 1), nan=1.0)
    overlaps = iou(best, boxes) > 0.3
    log_size, log_best = (
        np.log(np.maximum(b[:, 2:] - b[:, :2], _MIN_SIZE_PX)) for b in (boxes, best)
    )
    differences = np.abs(log_size[None] - log_best[:, None]).mean(axis=2)
    difference = (differences * overlaps).sum(axis=1) / np.maximum(overlaps.sum(axis=1), 1)
    agreement = 1 - np.minimum(difference / _LOG_SIZE_SIGMA, 1)
    return np.concatenate(
        [is_right * centring * agreement, np.zeros(min(candidates.n_invalid, _MAX_COMPARED))]
    )
