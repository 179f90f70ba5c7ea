"""YoloDetector: image -> network input -> outputs -> road users, for every family that `detection.yolo.layouts` knows.

The three steps reuse one set of buffers: `fill` resizes the image into the network's bound input, `infer` runs it,
`decode` reads the outputs where they lie. `detect` is the three in a row.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.boxes import are_valid_boxes, nms
from track_range.detection.classes import ROAD_CLASSES, SAME_OBJECT_GROUP, map_to_road_classes
from track_range.detection.detections import Detections
from track_range.detection.models.metadata import Attribute, ModelMetadata, ModelOptions, read_metadata
from track_range.detection.models.onnx_session import BoundNetwork, ModelError, OnnxSession, Runtime
from track_range.detection.yolo.layouts import YoloModel, identify_layout
from track_range.detection.yolo.letterbox import Letterbox, rectangular_input_hw
from track_range.foundation.arrays import FloatArray, FloatArray32, Image, IntArray

_MAX_BOUND = 8
"""Input sizes whose buffers are kept, for images of changing sizes; binding one anew costs a run of the network."""

DEFAULT_SIZE_PX = 640
"""Longer side of an open input; what most public networks were trained at."""

_UNREACHABLE = 2.0
"""A threshold that no score reaches, for classes that are not wanted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class YoloSettings:
    """What a YOLO detector may be told.

    Attributes:
        min_score: boxes below are dropped; low, since the tracker uses weak boxes to keep a track.
        class_min_score: (class id, score) of road classes with a threshold of their own.
        max_iou: of two boxes of one kind of object that overlap more, the better is kept.
        max_boxes: the best so many boxes are kept.
        size_px: the longer side of the network's input, where the model leaves it open; None = what the model says
            of itself, else `DEFAULT_SIZE_PX`.
        is_square: an open input is square; else no larger than the image needs.
        class_id: road classes wanted; empty = all.
    """

    min_score: float = 0.1
    class_min_score: tuple[tuple[int, float], ...] = ()
    max_iou: float = 0.5
    max_boxes: int = 300
    size_px: int | None = None
    is_square: bool = False
    class_id: tuple[int, ...] = ()

    def min_score_by_class(self) -> FloatArray:
        """(8,) threshold of each road class, above 1 for one that is not wanted."""
        scores = np.full(len(ROAD_CLASSES), self.min_score)
        for class_id, score in self.class_min_score:
            scores[class_id] = score
        if self.class_id:
            scores[~np.isin(np.arange(len(scores)), self.class_id)] = _UNREACHABLE
        return scores


class YoloDetector:
    """A YOLO network on one stream of images; buffers are reused, so one instance serves one thread.

    Attributes:
        model: the family, its input and its class names, as told or assumed.
        size: the longer side of the input where the model leaves it open, and who says so.
        n_invalid: boxes dropped so far because the network gave NaN or infinite numbers for them.
    """

    def __init__(
        self,
        path: Path,
        settings: YoloSettings | None = None,
        *,
        options: ModelOptions | None = None,
        runtime: Runtime | None = None,
    ) -> None:
        """Load the network and run it once.

        Raises:
            ModelError: no such model, unknown outputs, or class names that do not fit them.
        """
        self._settings = settings or YoloSettings()
        self._session = OnnxSession(path, runtime)
        _check_is_detector(self._session)
        self._facts: ModelMetadata = read_metadata(path, self._session.metadata, options or ModelOptions())
        self._bound: dict[tuple[int, int], tuple[BoundNetwork, YoloModel]] = {}
        self.n_invalid = 0
        self.size: Attribute = self._facts.of("size", DEFAULT_SIZE_PX, "default")
        if self._settings.size_px is not None:
            self.size = Attribute(self._settings.size_px, "as given")
        self._prepare(image_hw=(self.size.value, self.size.value))
        names = self.model.names
        self._road_class: IntArray = map_to_road_classes(names)
        wanted = np.append(self._settings.min_score_by_class(), _UNREACHABLE)  # -1, no road class, is the last
        self._min_score: FloatArray = wanted[self._road_class]
        if (self._min_score >= _UNREACHABLE).all():
            raise ModelError(f"{path}: none of its classes ({', '.join(names[:8])}, ...) is a wanted road class.")

    @property
    def session(self) -> OnnxSession:
        """The loaded network: its file, device and input."""
        return self._session

    @property
    def input_hw(self) -> tuple[int, int]:
        """(height, width) of the network's input for the latest image."""
        return self._letterbox.input_hw

    @property
    def known_class_id(self) -> IntArray:
        """Road classes, sorted, that the network has a name for."""
        return np.unique(self._road_class[self._road_class >= 0])

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user on the model, and on what it did so far."""
        names = f"Class names of {self._session.path.name}: {self.model.facts['names'].source}."
        if not self.n_invalid:
            return (*self._session.notes, names)
        boxes = "1 box" if self.n_invalid == 1 else f"{self.n_invalid} boxes"
        return (*self._session.notes, names, f"The network gave NaN or infinite numbers: {boxes} dropped.")

    def detect(self, image: Image) -> Detections:
        """The road users in `image`, (H, W, 3) uint8 BGR; best score first."""
        self.fill(image)
        return self.decode(self.infer())

    def input_of(self, image: Image) -> FloatArray32:
        """(1, 3, height, width) what the network would see of `image`, a copy."""
        self.fill(image)
        return np.array(self._network.blob, np.float32)

    def fill(self, image: Image) -> None:
        """Write `image` into the network's input.

        Raises:
            ValueError: it is not (H, W, 3) uint8 with at least one pixel.
        """
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
            raise ValueError(f"image: shape (*, *, 3) of uint8 wanted, {image.shape} of {image.dtype} got")
        if self._letterbox.image_hw != image.shape[:2]:
            self._prepare(image_hw=(image.shape[0], image.shape[1]))
        self.model.input_format.write(image, self._letterbox, self._network.blob, scaled=self._scaled)

    def infer(self) -> list[FloatArray32]:
        """Run the network on what `fill` wrote; the outputs, overwritten by the next run."""
        return self._network.run()

    def decode(self, outputs: list[FloatArray32]) -> Detections:
        """The road users that the outputs for the latest image mean."""
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is dropped, and counted
            found = self.model.decoder.decode(outputs, self._min_score)
        self.n_invalid += found.n_invalid
        class_id = self._road_class[found.class_index]
        best = nms(
            found.xyxy_net,
            found.score,
            SAME_OBJECT_GROUP[class_id],
            max_iou=self._settings.max_iou,
            max_boxes=self._settings.max_boxes,
        )
        boxes = Detections.of(self._letterbox.to_image_clipped(found.xyxy_net[best]), found.score[best], class_id[best])
        return boxes.select(are_valid_boxes(boxes.xyxy_px))

    def _prepare(self, *, image_hw: tuple[int, int]) -> None:
        """Buffers, decoder and letterbox for images of one size; an input size seen before has its network still."""
        input_hw = self._input_hw(image_hw)
        if input_hw not in self._bound:
            if len(self._bound) == _MAX_BOUND:
                del self._bound[next(iter(self._bound))]
            network = self._session.bound(input_hw)
            model = identify_layout(self._session.path, input_hw, network.output_shapes, self._facts)
            self._bound[input_hw] = network, model
        self._network, self.model = self._bound[input_hw]
        form = self.model.input_format
        self._letterbox = Letterbox.placed(form.placement, image_hw, input_hw)
        self._scaled: Any = np.empty((*self._letterbox.resized_hw, 3), np.uint8)
        form.fill_padding(self._network.blob)

    def _input_hw(self, image_hw: tuple[int, int]) -> tuple[int, int]:
        _, _, height, width = self._session.input_shape
        if height is not None and width is not None:
            return height, width
        size_px = int(self.size.value)
        return rectangular_input_hw((1, 1) if self._settings.is_square else image_hw, size_px=size_px)


def _check_is_detector(session: OnnxSession) -> None:
    task = session.metadata.get("task", "detect")  # as Ultralytics' exports tell it
    if task != "detect":
        raise ModelError(f"{session.path}: a '{task}' network, not a detector; export one of the task 'detect'.")
