"""Average precision and recall by size of object: COCO's three bins of area, and four bins of
height.

As in pycocotools, labels outside a bin are ignored, and unmatched detections outside the bin count
neither as true nor as false positives. The area is the area of the box (COCO's own labels have the
area of the object's outline) in square pixels of the image, before it is scaled to the network's
input. An object at the limit of two bins is in the upper one; pycocotools counts it in both.

Heights are used because a distance by size follows from the height in pixels: at a focal length of
1000 px, a car of 1.5 m is 25 px high at 60 m, 50 px at 30 m and 100 px at 15 m.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation.average_precision import MIN_BOXES, accuracy, json_number
from track_range.detection.evaluation.matching import SizeBin, SizeMeasure, match_class
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.foundation.arrays import FloatArray, IntArray

# bins by measure; those of area are COCO's
SIZE_BINS: Mapping[SizeMeasure, tuple[SizeBin, ...]] = {
    "area": (
        SizeBin("small", "area", 0.0, 32.0**2),
        SizeBin("medium", "area", 32.0**2, 96.0**2),
        SizeBin("large", "area", 96.0**2, np.inf),
    ),
    "height": (
        SizeBin("< 25 px", "height", 0.0, 25.0),
        SizeBin("25-50 px", "height", 25.0, 50.0),
        SizeBin("50-100 px", "height", 50.0, 100.0),
        SizeBin(">= 100 px", "height", 100.0, np.inf),
    ),
}
# minimum number of labels of a class in a bin that is included in the bin's means
MIN_BIN_BOXES = 10

_FIGURES = ("ap50", "ap50_95", "recall")


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeClassScores:
    """Scores of one class in one bin, as in `ClassScores`; NaN without labels."""

    n_boxes: int
    ap50: float
    ap50_95: float
    recall: float
    is_averaged: bool


@dataclass(frozen=True, slots=True)
class SizeScores:
    """Scores of one detector in one bin by road class id, and their unweighted means over the
    averaged classes.
    """

    size_bin: SizeBin
    by_class: Mapping[int, SizeClassScores]

    def mean(self, figure: str) -> float:
        """Mean of a figure of `SizeClassScores` over the averaged classes; NaN if there are
        none.
        """
        values = [
            getattr(scores, figure) for scores in self.by_class.values() if scores.is_averaged
        ]
        return float(np.mean(values)) if values else float("nan")

    def as_dict(self) -> dict[str, Any]:
        """Bin, means, number of labels and names of the averaged classes, all scores by class name,
        for JSON.
        """
        unit = "px2" if self.size_bin.measure == "area" else "px"
        averaged = {i: scores for i, scores in self.by_class.items() if scores.is_averaged}
        return {
            "name": self.size_bin.name,
            f"from_{unit}": self.size_bin.low,
            f"to_{unit}": self.size_bin.high if np.isfinite(self.size_bin.high) else None,
            "n_boxes": sum(scores.n_boxes for scores in averaged.values()),
            **{figure: json_number(self.mean(figure)) for figure in _FIGURES},
            "averaged_classes": [ROAD_CLASSES[i] for i in averaged],
            "classes": {
                ROAD_CLASSES[i]: {
                    name: json_number(getattr(row, name))
                    for name in SizeClassScores.__dataclass_fields__
                }
                for i, row in self.by_class.items()
            },
        }


def evaluate_by_size(
    detections: Sequence[Detections],
    truth: Sequence[ImageTruth],
    *,
    working_score: FloatArray,
    known_class_id: IntArray,
    measure: SizeMeasure = "area",
    min_boxes: int = MIN_BOXES,
    min_bin_boxes: int = MIN_BIN_BOXES,
    min_height_px: float = 0.0,
) -> list[SizeScores]:
    """Scores of one detector on labelled images for each bin of `SIZE_BINS[measure]`.

    Example:
        >>> import numpy as np, track_range as tr
        >>> car = tr.Detections.of([[100, 50, 130, 70]], [0.9], [2])
        >>> truth = tr.evaluate.ImageTruth.of(car.xyxy_px, car.class_id)
        >>> small, medium, large = tr.evaluate.detections_by_size(
        ...     [car], [truth], working_score=np.full(8, 0.25), known_class_id=np.arange(8)
        ... )
        >>> small.by_class[2].ap50, medium.by_class[2].n_boxes
        (1.0, 0)

    Args:
        detections: the detections of each image, down to very low scores.
        truth: the labels of each image, in the same order.
        working_score: (8,) score threshold by road class at which the recall is computed.
        known_class_id: road classes that the detector has a name for; other classes are excluded
            from the means.
        measure: "area" in square pixels or "height" in pixels of the image.
        min_boxes: classes with fewer labels of any size are excluded from the means.
        min_bin_boxes: classes with fewer labels in a bin are excluded from its means.
        min_height_px: smaller labels are ignored, and so are smaller unmatched detections.

    Raises ValueError: `detections` and `truth` differ in length, or there is no such measure.
    """
    if measure not in SIZE_BINS:
        raise ValueError(f"measure: expected {' or '.join(map(repr, SIZE_BINS))}, got {measure!r}")
    bins = SIZE_BINS[measure]
    by_bin: list[dict[int, SizeClassScores]] = [{} for _ in bins]
    for class_id in range(len(ROAD_CLASSES)):
        by_size = match_class(detections, truth, class_id, min_height_px=min_height_px, bins=bins)
        if not (n_boxes := sum(matches.n_boxes for matches in by_size)):
            continue
        is_averaged = class_id in known_class_id and n_boxes >= min_boxes
        for by_class, matches in zip(by_bin, by_size, strict=True):
            figures = accuracy(matches, float(working_score[class_id]))
            by_class[class_id] = SizeClassScores(
                n_boxes=matches.n_boxes,
                is_averaged=is_averaged and matches.n_boxes >= min_bin_boxes,
                **{figure: figures[figure] for figure in _FIGURES},
            )
    return [SizeScores(size_bin, by_class) for size_bin, by_class in zip(bins, by_bin, strict=True)]
