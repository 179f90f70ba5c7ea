"""The `ObjectDetector` protocol: what every detector of road users implements."""

from typing import Any, Protocol, runtime_checkable

import numpy as np

from track_range.detection.boxes import iou, survivors
from track_range.detection.classes import SAME_OBJECT_GROUP
from track_range.detection.detections import Detections
from track_range.foundation.arrays import Image
from track_range.foundation.errors import UserError, named_errors

MAX_IOU = 0.5  # of two boxes of classes that are easily confused; above it they are one object


class DetectorError(UserError):
    """A detector that returns no valid `Detections`; the message names its class and the frame."""


@runtime_checkable
class ObjectDetector(Protocol):
    """Detector of road users in images; use one instance per video stream, in one thread."""

    def detect(self, image: Image) -> Detections:
        """The road users in `image`, (H, W, 3) uint8 BGR, with boxes in pixels of that image."""


def checked_detections(detector: ObjectDetector, image: Image, frame_index: int) -> Detections:
    """The detections of a detector of another package in the image of a frame.

    DetectorError: the detector does not return `Detections`, or raises an exception, as
    `Detections` does for invalid values.
    """
    where = f"{type(detector).__module__}:{type(detector).__qualname__}, frame {frame_index}"
    with named_errors(type(detector).__module__, where, DetectorError):
        result: Any = detector.detect(image)
    if not isinstance(result, Detections):
        returned = f"{type(result).__name__} {getattr(result, 'shape', '')}".rstrip()
        raise DetectorError(
            f"{where}: expected detect() to return Detections, such as Detections.of(boxes, "
            f"scores, class_ids) with arrays of shapes (N, 4), (N,) and (N,), got {returned}."
        )
    if result.xyxy_px.min(initial=0.0) >= 0 < result.xyxy_px.max(initial=0.0) <= 1:
        example, (height, width) = result.xyxy_px[0].tolist(), image.shape[:2]
        raise DetectorError(
            f"{where}: expected boxes in pixels of the image ({width}x{height}), got fractions of "
            f"its size, such as {example}; multiply them by width and height."
        )
    return without_confused(result)


def without_confused(detections: Detections, max_iou: float = MAX_IOU) -> Detections:
    """The detections without boxes that overlap a higher-scoring box of another class in the same
    group.

    A group has classes that detectors confuse: a car and a truck on one vehicle are one object.
    Boxes of one class do not suppress each other: their source decides which of them are one
    object.
    """
    group = SAME_OBJECT_GROUP[detections.class_id]
    if len(np.unique(group)) == len(np.unique(detections.class_id)):
        return detections
    best = np.argsort(-detections.score, kind="stable")
    xyxy_px, class_id, group = detections.xyxy_px[best], detections.class_id[best], group[best]
    is_same = (
        (iou(xyxy_px, xyxy_px) > max_iou)
        & (group[:, None] == group)
        & (class_id[:, None] != class_id)
    )
    return detections.select(np.sort(best[survivors(is_same)]))
