"""YoloDetector: detection of road users with any network whose output layout is in `detection.yolo.layouts`.

The networks are YOLO, DETR-like networks, NanoDet and PicoDet.

`detect` consists of three steps that reuse their buffers: `fill` resizes the image into the network's input, `infer`
runs the network, `decode` turns the outputs into detections. `prepared` does only the first step, in separate buffers,
so that another thread can meanwhile do the other steps for the previous image.

    one thread      prepared(k+1), prepared(k+2), ...
    another thread  function that prepared(k) returned; or detect; or fill, infer, decode; candidates, input_blob
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from track_range.detection.box_errors import BoxErrors
from track_range.detection.boxes import are_valid_boxes, nms
from track_range.detection.classes import (
    COCO_CATEGORIES,
    ROAD_CLASSES,
    SAME_OBJECT_GROUP,
    VOC_CLASSES,
    is_background_name,
    map_to_road_classes,
    road_class_of,
)
from track_range.detection.detections import Detections
from track_range.detection.detector import MAX_IOU
from track_range.detection.models.onnx_session import BoundNetwork, ModelError, OnnxSession, Runtime
from track_range.detection.yolo.decoders import Candidates
from track_range.detection.yolo.first_images import N_IMAGES, FirstImages
from track_range.detection.yolo.layouts import readings_of
from track_range.detection.yolo.letterbox import Letterbox, input_hw_of_area, rectangular_input_hw
from track_range.detection.yolo.metadata import (
    FROM_METADATA,
    Attribute,
    ModelMetadata,
    ModelOptions,
    read_metadata,
)
from track_range.detection.yolo.network_outputs import NetworkOutputs, YoloModel
from track_range.foundation.arrays import FloatArray, FloatArray32, Image, IntArray
from track_range.foundation.errors import Note
from track_range.foundation.files.input_files import quoted, shortened

# input sizes whose buffers are cached; binding a new size costs one run of the network
_MAX_BOUND = 8
# longer side of an input of variable size; most public networks were trained at it
DEFAULT_SIZE_PX = 640
# above it, two boxes of an end-to-end network are one with two classes that are easily confused
_SAME_BOX_IOU = 0.95
_UNREACHABLE_SCORE = 2.0  # threshold of classes that are left out; scores are at most 1


@dataclass(frozen=True, slots=True, kw_only=True)
class YoloSettings:
    """Settings of a YOLO detector."""

    # confidence threshold; low, since the tracker uses low-confidence boxes to continue tracks
    min_score: float = 0.1
    # (class id, score) of road classes with a separate threshold
    class_min_score: tuple[tuple[int, float], ...] = ()
    # of suppression among confused classes; end-to-end networks: only equal boxes are removed
    max_iou: float = MAX_IOU
    max_boxes: int = 300  # largest number of boxes per image
    # longer side of a variable input, or its width and height; None = as in the metadata, else
    # `DEFAULT_SIZE_PX`
    size_px: int | tuple[int, int] | None = None
    # a variable input is square, else of the image's aspect ratio, except of DETR-like ones
    is_square: bool = False
    class_id: tuple[int, ...] = ()  # ids of the road classes to detect; empty = all

    def min_score_by_class(self) -> FloatArray:
        """(8,) score threshold of each road class, above 1 for classes that are left out."""
        scores = np.full(len(ROAD_CLASSES), self.min_score)
        for class_id, score in self.class_min_score:
            scores[class_id] = score
        if self.class_id:
            scores[~np.isin(np.arange(len(scores)), self.class_id)] = _UNREACHABLE_SCORE
        return scores


# padded input (1, 3, height, width), and the resized image
_Buffers = tuple[npt.NDArray[Any], Image]


@dataclass(slots=True)
class _Input:
    """Buffers and format of the network's input for images of one size."""

    # the network bound to the size of its input, which is also that of images of other sizes
    network: BoundNetwork
    model: YoloModel  # decoder and input format
    letterbox: Letterbox  # placement of the images in the input
    free: deque[_Buffers] = field(default_factory=deque)  # buffers that are not in use

    @classmethod
    def of(
        cls,
        network: BoundNetwork,
        model: YoloModel,
        image_hw: tuple[int, int],
        input_hw: tuple[int, int],
    ) -> _Input:
        """The input for a reading of the outputs, which determines the placement of the image."""
        return cls(
            network, model, Letterbox.of_placement(model.input_format.placement, image_hw, input_hw)
        )

    def buffers(self) -> _Buffers:
        """Free buffers, or new buffers with the padding."""
        try:
            return self.free.pop()
        except IndexError:
            blob = np.zeros_like(self.network.blob)
            self.model.input_format.fill_padding(blob)
            return blob, np.empty((*self.letterbox.resized_hw, 3), np.uint8)

    def filled(self, image: Image) -> _Buffers:
        """Buffers with the image."""
        blob, scaled = self.buffers()
        self.model.input_format.write(image, self.letterbox, blob, scaled=scaled)
        return blob, scaled


class YoloDetector:
    """Detector of road users with a YOLO network; buffers are reused, so use one instance per
    video, in one thread.

    Only `prepared` may be called in another thread, one at a time. `size`: longer side, or width
    and height, in pixels of an input of variable size, and the source of this value. `area`: number
    of pixels of an input of variable size, used instead of `size`; None = `size` is used.
    `n_invalid`: number of boxes dropped so far because of NaN, infinite numbers or labels without a
    class name. Raises ModelError: the model cannot be read, its outputs have no known layout, the
    number of class names differs from the number of classes, or the model has none of the classes
    to detect.
    """

    def __init__(
        self,
        path: Path,
        settings: YoloSettings | None = None,
        *,
        options: ModelOptions | None = None,
        runtime: Runtime | None = None,
    ) -> None:
        self._settings = settings or YoloSettings()
        self._session = OnnxSession(path, runtime)
        task = self._session.metadata.get("task", "detect")  # written by Ultralytics' exporter
        if task not in ("detect", "segment", "pose"):
            raise ModelError(
                f"{path}: expected a network for the task 'detect', 'segment' or 'pose', got one "
                f"for {quoted(task)}."
            )
        self._metadata: ModelMetadata = read_metadata(
            path, self._session.metadata, options or ModelOptions()
        )
        self._bound: dict[tuple[int, int], tuple[BoundNetwork, tuple[YoloModel, ...]]] = {}
        self._first_images = FirstImages(path)
        self._last: tuple[list[FloatArray32], _Input] | None = None
        self._preparing = threading.Lock()
        self.n_invalid = 0
        self.size: Attribute = self._metadata.get("size", DEFAULT_SIZE_PX, "default")
        area = self._metadata.get("area", None, "")
        self.area: Attribute | None = None if area.value is None else area
        if self._settings.size_px is not None:
            self.size, self.area = Attribute(self._settings.size_px, "as specified"), None
        self._input = self._prepare(image_hw=(DEFAULT_SIZE_PX, DEFAULT_SIZE_PX))
        self._filled = self._input, self._input.buffers()
        self._set_thresholds()

    def _set_thresholds(self) -> None:
        """The road class and threshold of each class of the network; ModelError if it has no class
        to detect.
        """
        names = self.model.names
        self._road_class: IntArray = map_to_road_classes(names)
        # index -1: no road class
        thresholds = np.append(self._settings.min_score_by_class(), _UNREACHABLE_SCORE)
        self._min_score: FloatArray = thresholds[self._road_class]
        if (self._min_score >= _UNREACHABLE_SCORE).all():
            first_names = shortened(", ".join(names[:8]))
            raise ModelError(
                f"{self._session.path}: none of its classes ({first_names}, ...) is one of the "
                "road classes to detect; choose other classes or another model."
            )

    @property
    def session(self) -> OnnxSession:
        """The loaded network."""
        return self._session

    @property
    def input_hw(self) -> tuple[int, int]:
        """(height, width) of the network's input for the latest image, filled or prepared."""
        return self._input.letterbox.input_hw

    @property
    def takes_parts(self) -> bool:
        """Whether `detect_part` is possible: the input has colours, any size and any shape."""
        shape, n_channels = self._session.input_shape, self._session.n_channels
        return None in shape[2:] and n_channels == 3 and not self.model.is_square

    @property
    def model(self) -> YoloModel:
        """Family, input format and class names for the latest image, filled or prepared."""
        return self._input.model

    @property
    def readings(self) -> tuple[YoloModel, ...]:
        """All meanings that the outputs may have by their shapes; `model` is the chosen or the
        usual reading.
        """
        return self._bound[self.input_hw][1]

    @property
    def why(self) -> str:
        """Reason for the choice of the layout."""
        stated = self._metadata.get(
            "layout", None, "the usual one for " if len(self.readings) > 1 else ""
        )
        source = (
            stated.source
            if stated.value is not None
            else f"{stated.source}the shapes of the outputs"
        )
        return self._first_images.why or source

    @property
    def box_errors(self) -> BoxErrors | None:
        """Systematic errors of the boxes; None = unknown."""
        errors: BoxErrors | None = self.model.attributes["box_errors"].value
        return errors

    @property
    def known_class_id(self) -> IntArray:
        """Sorted ids of the road classes that the network has a name for."""
        return np.unique(self._road_class[self._road_class >= 0])

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user on the model and on dropped boxes."""
        name, first = self._session.path.name, self._first_images
        source = self.model.attributes["names"].source
        notes = [*self._session.notes]
        if source != FROM_METADATA:
            notes.append(f"Class names of {name}: {source}.")
        usual = {*COCO_CATEGORIES, *VOC_CLASSES}  # of which a note would be no news
        if other := [
            name
            for name in self.model.names
            if road_class_of(name) is None and name not in usual and not is_background_name(name)
        ]:
            notes.append(
                f"Boxes of {name} with other names than road classes are left out: "
                f"{shortened(', '.join(other), 80)} (--names renames them)."
            )
        if self.model.name != self.readings[0].name:
            notes.append(
                f"The outputs of {name} are read as {self.model.name} "
                f"({self.model.layout}): {self.why}."
            )
        if self.model.note:
            notes.append(self.model.note)
        # only models that this package trained have an area, and their outputs are known
        is_ours = self._metadata.get("area", None, "").value is not None
        if first.n_checked >= N_IMAGES and not first.n_detected and not is_ours:
            notes.append(
                Note(
                    f"{name} detected nothing in the first {N_IMAGES} images; if they show road "
                    "users, the input or the outputs of the model are interpreted wrongly: see "
                    "`track-range models info --image`.",
                    "detector-empty",
                    "error",
                    "detector",
                )
            )
        if self._settings.size_px is not None and None not in self._session.input_shape[2:]:
            notes.append(f"--size is not used: the input of {name} has a fixed size.")
        if self.n_invalid:
            boxes = "1 box" if self.n_invalid == 1 else f"{self.n_invalid} boxes"
            notes.append(
                Note(
                    f"The network returned NaN, infinite numbers or unknown labels: {boxes} ignored.",
                    "detector-invalid",
                    "warning",
                    "detector",
                )
            )
        return tuple(notes)

    def restart(self) -> None:
        """Forget the counts of boxes and the layout chosen from the first images, before the next
        video.
        """
        self.n_invalid, self._first_images = 0, FirstImages(self._session.path)

    def detect(self, image: Image) -> Detections:
        """The road users in `image`, (H, W, 3) uint8 BGR, in order of decreasing score."""
        return self.prepared(image)()

    def prepared(self, image: Image) -> Callable[[], Detections]:
        """Write `image` into an input of the network, and return the function that detects the road
        users in it.

        The function must be called once, in the order of the images, in the thread of the other
        methods. Another thread may prepare images meanwhile; the image of `fill` does not change.
        Images and errors: see `fill`.
        """
        return partial(self._detect_prepared, *self._written(image))

    def _detect_prepared(self, prepared: _Input, buffers: _Buffers) -> Detections:
        outputs = prepared.network.run(buffers[0])
        prepared.free.append(buffers)
        self._last = outputs, prepared
        return self._decoded(outputs, prepared, self._min_score)

    def detect_part(self, part: Image, input_hw: tuple[int, int]) -> Detections:
        """The road users in a part of the latest image, (H, W, 3) uint8 BGR, in pixels of the part.

        `input_hw` is the (height, width) of the input, multiples of 32. `candidates` remain those
        of the whole image.
        """
        with self._preparing:
            source = self._prepare(image_hw=(part.shape[0], part.shape[1]), input_hw=input_hw)
        blob, _ = source.filled(part)
        # a copy of the thresholds: the first images, which show the layout, are whole ones
        return self._decoded(source.network.run(blob), source, self._min_score.copy())

    def candidates(self, min_score: FloatArray) -> Detections:
        """The boxes in the image of the latest detection, including boxes with lower scores and of
        other classes.

        `min_score` (8,) is by road class; classes that are not in the settings are detected too.
        ValueError if `detect` was not called before.
        """
        if self._last is None:
            raise ValueError("expected an earlier call of detect")
        n_invalid = self.n_invalid
        # index -1: no road class
        by_class = np.append(min_score, _UNREACHABLE_SCORE)[self._road_class]
        detections = self._decoded(*self._last, np.minimum(self._min_score, by_class))
        self.n_invalid = n_invalid  # `detect` has counted them
        return detections

    def input_blob(self, image: Image) -> FloatArray32:
        """(1, 3, height, width) the network's input for `image`, as a copy."""
        # a buffer that is not used again
        return self._written(image)[1][0].astype(np.float32, copy=False)

    def fill(self, image: Image) -> None:
        """Write `image` into the network's input; ValueError if it is not (H, W, 3) uint8, or
        empty.
        """
        (before, buffers), self._filled = self._filled, self._written(image)
        before.free.append(buffers)

    def infer(self) -> list[FloatArray32]:
        """The network's outputs for the latest image passed to `fill`; the next run overwrites
        them.
        """
        source, (blob, _) = self._filled
        return source.network.run(blob)

    def decode(
        self, outputs: list[FloatArray32], min_score: FloatArray | None = None
    ) -> Detections:
        """The road users in the latest image of `fill`; `min_score` (C,) by class, else the scores
        of the settings.
        """
        return self._decoded(
            outputs, self._filled[0], self._min_score if min_score is None else min_score
        )

    def _decoded(
        self, outputs: list[FloatArray32], source: _Input, min_score: FloatArray
    ) -> Detections:
        if min_score is self._min_score:
            self._first_images.check(source.model, outputs, source.letterbox.input_hw)
        # the decoder drops and counts what is not finite
        with np.errstate(over="ignore", invalid="ignore"):
            candidates = source.model.decoder(outputs, min_score)
        self.n_invalid += candidates.n_invalid
        max_iou = _SAME_BOX_IOU if source.model.is_end_to_end else self._settings.max_iou
        class_id, max_boxes = self._road_class[candidates.class_index], self._settings.max_boxes
        return suppressed(
            candidates, class_id, source.letterbox, max_iou=max_iou, max_boxes=max_boxes
        )

    def _written(self, image: Image) -> tuple[_Input, _Buffers]:
        """The input for images of this size, and buffers with the image."""
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
            raise ValueError(
                f"image: expected shape (H, W, 3) of uint8, got {image.shape} of {image.dtype}"
            )
        with self._preparing:  # `fill` and `prepared` may be in progress at once
            if self._input.letterbox.image_hw != image.shape[:2]:
                self._input = self._prepare(image_hw=(image.shape[0], image.shape[1]))
            if self._session.n_channels == 1:
                image = np.repeat(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)[..., None], 3, axis=2)
            if not self._first_images.chosen and len(self.readings) > 1:
                self._compare_readings(image)
            source = self._input
        return source, source.filled(image)

    def _prepare(
        self, *, image_hw: tuple[int, int], input_hw: tuple[int, int] | None = None
    ) -> _Input:
        """Network, decoder and letterbox for images of size `image_hw`, in an input of the usual
        size if none is given; bound networks are cached.
        """
        input_hw = input_hw or self._input_hw(image_hw)
        if input_hw not in self._bound:
            if len(self._bound) == _MAX_BOUND:
                del self._bound[next(iter(self._bound))]
            network = self._session.bound(input_hw)
            outputs = NetworkOutputs(
                has_integer_input=self._session.has_integer_input,
                path=self._session.path,
                input_hw=input_hw,
                names=tuple(network.output_shapes),
                shapes=tuple(network.output_shapes.values()),
                is_integer=tuple(name in network.integer_outputs for name in network.output_shapes),
                has_target_sizes=self._session.has_target_sizes,
                metadata=self._metadata,
            )
            self._bound[input_hw] = network, readings_of(outputs)
        network, readings = self._bound[input_hw]
        chosen = [reading for reading in readings if reading.name == self._first_images.chosen]
        return _Input.of(network, (chosen or readings)[0], image_hw, input_hw)

    def _compare_readings(self, image: Image) -> None:
        """Compare the readings of the outputs on `image`, one of the first images, and use the best
        from now on.
        """
        network, readings = self._bound[self.input_hw]
        letterbox = self._input.letterbox
        inputs = [
            _Input.of(network, reading, letterbox.image_hw, letterbox.input_hw)
            for reading in readings
        ]
        by_format: dict[object, list[FloatArray32]] = {}
        for source in inputs:
            if source.model.input_format not in by_format:
                blob, _ = source.filled(image)
                by_format[source.model.input_format] = self._session.run(blob)
        outputs = [by_format[source.model.input_format] for source in inputs]
        best = self._first_images.compare(readings, outputs, letterbox.input_hw)
        if best.name != self._input.model.name:
            self._input = next(source for source in inputs if source.model is best)
            self._set_thresholds()

    def _input_hw(self, image_hw: tuple[int, int]) -> tuple[int, int]:
        _, _, height, width = self._session.input_shape
        if height is not None and width is not None:
            return height, width
        if isinstance(self.size.value, tuple):
            return self.size.value[1], self.size.value[0]
        is_square = self._settings.is_square or any(
            readings[0].is_square for _, readings in self._bound.values()
        )
        shape_hw = (1, 1) if is_square else image_hw
        if self.area is not None:
            return input_hw_of_area(shape_hw, area_px2=self.area.value)
        return rectangular_input_hw(shape_hw, size_px=int(self.size.value))


def suppressed(
    candidates: Candidates,
    class_id: IntArray,
    letterbox: Letterbox,
    *,
    max_iou: float,
    max_boxes: int,
) -> Detections:
    """The candidates of road classes (N,) that remain after non-maximum suppression, in pixels of
    the image.
    """
    groups = SAME_OBJECT_GROUP[class_id]
    best = nms(candidates.xyxy_net, candidates.score, groups, max_iou=max_iou, max_boxes=max_boxes)
    xyxy_px = letterbox.to_image_clipped(candidates.xyxy_net[best])
    is_valid = are_valid_boxes(xyxy_px)
    best = best[is_valid]
    return Detections.of(xyxy_px[is_valid], candidates.score[best], class_id[best])
