"""Validation of a network on labelled images, with the letterbox, decoder and NMS of
`YoloDetector`.
"""

from collections.abc import Callable, Iterable

import numpy as np
import torch

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation import DetectionScores, evaluate_detections
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.training.networks.network import DetectionNetwork
from track_range.detection.yolo.decoders import BoxRows, Part, centres, decode_rows
from track_range.detection.yolo.detector import suppressed
from track_range.detection.yolo.input_format import InputFormat
from track_range.detection.yolo.letterbox import Letterbox, rectangular_input_hw
from track_range.foundation.arrays import Image, IntArray

LOWEST_SCORE = 0.001  # of the detections; low, so that the precision-recall curve is complete
# IoU threshold of non-maximum suppression, and largest number of boxes per image
_MAX_IOU, _MAX_BOXES = 0.5, 300
_WORKING_SCORE = 0.25  # score threshold of the reported precision and recall


class NetworkDetector:
    """A network as a detector, for the validation during training."""

    def __init__(
        self,
        network: DetectionNetwork,
        road_class_id: IntArray,
        *,
        size_px: int,
        device: torch.device,
        precision: torch.dtype,
    ) -> None:
        self._network, self._road_class_id, self._size_px = network, road_class_id, size_px
        self._device, self._precision = device, precision
        self._min_score = np.full(len(road_class_id), LOWEST_SCORE)
        columns = slice(0, 4), slice(5, None), slice(4, 5)
        boxes, scores, objectness = (Part(0, column) for column in columns)
        self._rows = BoxRows(boxes=boxes, scores=scores, objectness=objectness, code=centres())

    def detect(self, image: Image) -> Detections:
        """The road users in `image`, (H, W, 3) uint8 BGR, in order of decreasing score."""
        hw = (image.shape[0], image.shape[1])
        letterbox = Letterbox.of_placement(
            "centred", hw, rectangular_input_hw(hw, size_px=self._size_px)
        )
        input_format, blob = InputFormat(), np.empty((1, 3, *letterbox.input_hw), np.float32)
        input_format.fill_padding(blob)
        input_format.write(
            image, letterbox, blob, scaled=np.empty((*letterbox.resized_hw, 3), np.uint8)
        )
        with (
            torch.no_grad(),
            torch.autocast(self._device.type, self._precision, self._precision != torch.float32),
        ):
            raw = self._network(
                torch.from_numpy(blob).to(self._device, memory_format=torch.channels_last)
            )
        rows = self._network.decode([head.float() for head in raw]).cpu().numpy()
        candidates = decode_rows([self._rows], [rows], self._min_score)
        class_id = self._road_class_id[candidates.class_index]
        return suppressed(candidates, class_id, letterbox, max_iou=_MAX_IOU, max_boxes=_MAX_BOXES)


def validate(
    detector: NetworkDetector,
    images: Iterable[tuple[Image, ImageTruth]],
    road_class_id: IntArray,
    *,
    min_boxes: int,
    done: Callable[[int], None],
) -> DetectionScores:
    """Scores of a network on labelled images.

    Classes with fewer labels than `min_boxes` are excluded from the mean, unless all have fewer.
    `done` is called after each image with the number of images so far.
    """
    detections, truth = [], []
    for image, labels in images:
        detections.append(detector.detect(image))
        truth.append(labels)
        done(len(truth))
    counted = [labels.class_id[~labels.is_ignored] for labels in truth]
    counted = [ids[labels.is_complete[ids]] for ids, labels in zip(counted, truth, strict=True)]
    most = int(np.bincount(np.concatenate(counted), minlength=1).max())
    return evaluate_detections(
        detections,
        truth,
        working_score=np.full(len(ROAD_CLASSES), _WORKING_SCORE),
        known_class_id=road_class_id,
        min_boxes=max(min(min_boxes, most), 1),  # at least the most frequent class is averaged
    )
