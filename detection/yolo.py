"""YOLO networks as detectors: image -> input blob -> network -> boxes.

YOLOv5's official export gives [1, N, 5 + C]: centre x, centre y, width, height in input pixels, objectness and C class
scores, all decoded, N = 3 anchors on grids of stride 8, 16 and 32; a box's score is objectness times class score.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

from detection.boxes import are_sound, nms, xyxy_from_cxcywh
from detection.classes import COCO_CLASSES, SAME_OBJECT_GROUP, road_class_of_each
from detection.detections import Detections, Image, IntArray
from detection.letterbox import Letterbox, rectangular_input_hw
from detection.onnx_session import Device, FloatArray32, ModelError, OnnxSession

_PAD_GREY = 114  # YOLOv5's letterbox colour
_STRIDES_PX = (8, 16, 32)
_ANCHORS_PER_CELL = 3
_KNOWN_LAYOUTS = "YOLOv5's official export, [1, 3 anchors x cells of strides 8, 16, 32, 5 + classes]"


@dataclass(frozen=True, slots=True, kw_only=True)
class YoloSettings:
    """What a YOLO detector may be told.

    Attributes:
        min_score: boxes below are dropped; low, since the tracker uses weak boxes to keep a track.
        max_iou: of two boxes of one kind of object that overlap more, the better is kept.
        max_boxes: the best so many boxes are kept.
        size_px: the longer side of the network's input, where the model leaves it open.
        class_id: road classes wanted; empty = all.
    """

    min_score: float = 0.1
    max_iou: float = 0.5
    max_boxes: int = 300
    size_px: int = 640
    class_id: tuple[int, ...] = ()


class YoloDetector:
    """A YOLOv5 network on one stream of images; buffers are reused, so one instance serves one thread.

    Attributes:
        names: the network's own class names.
        notes: sentences for the user.
    """

    def __init__(
        self,
        path: Path,
        settings: YoloSettings | None = None,
        *,
        names: Sequence[str] = (),
        device: Device = "auto",
        n_threads: int = 0,
    ) -> None:
        """Load the network and run it once.

        Class names come from `names`, else the model's metadata, else `MODEL.yaml` beside it, else COCO's 80.

        Raises:
            ModelError: no such model, unknown outputs, or class names that do not fit them.
        """
        self._settings = settings or YoloSettings()
        self._session = OnnxSession(path, device=device, n_threads=n_threads)
        self._letterbox: Letterbox | None = None
        n_classes = self._n_classes()
        self.names, source = _class_names(path, names, self._session.metadata, n_classes)
        self._road_class = self._wanted_road_classes()
        if not (self._road_class >= 0).any():
            raise ModelError(f"{path}: none of its classes ({', '.join(self.names[:8])}, ...) is a wanted road class.")
        self.notes = (*self._session.notes, f"Class names of {path.name}: {source}.")

    @property
    def device(self) -> str:
        """What the network runs on."""
        return self._session.device

    def sha256(self) -> str:
        """The model file's checksum."""
        return self._session.sha256()

    def detect(self, image: Image) -> Detections:
        """The road users in `image`, (H, W, 3) uint8 BGR; best score first."""
        letterbox = self._letterbox_of(image)
        rows, columns = letterbox.inside  # the padding stays from the first image on
        self._blob[:, :, rows, columns] = cv2.dnn.blobFromImage(letterbox.scaled(image), 1 / 255, swapRB=True)
        return self._decode(self._session.run(self._blob)[0][0], letterbox)

    def _decode(self, rows: FloatArray32, letterbox: Letterbox) -> Detections:
        """Boxes of the raw rows (N, 5 + C)."""
        keep = self._settings
        rows = rows[rows[:, 4] >= keep.min_score]  # the score cannot exceed the objectness; NaN is dropped here too
        foreign_class = rows[:, 5:].argmax(axis=1) if len(rows) else np.zeros(0, np.int64)
        score = (rows[:, 4] * rows[np.arange(len(rows)), 5 + foreign_class]).astype(np.float64)
        class_id = self._road_class[foreign_class]
        xyxy_net = xyxy_from_cxcywh(rows[:, :4].astype(np.float64))
        good = np.flatnonzero((score >= keep.min_score) & (class_id >= 0) & are_sound(xyxy_net))
        best = good[nms(xyxy_net[good], score[good], SAME_OBJECT_GROUP[class_id[good]], max_iou=keep.max_iou)]
        best = best[: keep.max_boxes]
        found = Detections.of(letterbox.to_image_clipped(xyxy_net[best]), np.minimum(score[best], 1.0), class_id[best])
        return found.select(are_sound(found.xyxy_px))

    def _letterbox_of(self, image: Image) -> Letterbox:
        image_hw = (image.shape[0], image.shape[1])
        if self._letterbox is None or self._letterbox.image_hw != image_hw:
            self._letterbox = Letterbox.centred(image_hw, self._input_hw(image_hw))
            self._blob = np.full((1, 3, *self._letterbox.input_hw), _PAD_GREY / 255, np.float32)
        return self._letterbox

    def _input_hw(self, image_hw: tuple[int, int]) -> tuple[int, int]:
        _, _, height, width = self._session.input_shape
        if height is not None and width is not None:
            return height, width
        return rectangular_input_hw(image_hw, size_px=self._settings.size_px)

    def _n_classes(self) -> int:
        """The number of classes, from the shape of a trial output."""
        height, width = self._input_hw((self._settings.size_px, self._settings.size_px))
        shapes = self._session.output_shapes(np.zeros((1, 3, height, width), np.float32))
        n_boxes = _ANCHORS_PER_CELL * sum((height // s) * (width // s) for s in _STRIDES_PX)
        first = next(iter(shapes.values()))
        if len(first) != 3 or first[1] != n_boxes or first[2] < 6:
            found = ", ".join(f"{name} {list(shape)}" for name, shape in shapes.items())
            raise ModelError(f"{self._session.path}: unknown outputs {found}; known layouts: {_KNOWN_LAYOUTS}.")
        return first[2] - 5

    def _wanted_road_classes(self) -> IntArray:
        road = road_class_of_each(self.names)
        wanted = self._settings.class_id
        return np.where(np.isin(road, wanted), road, -1) if wanted else road


def _class_names(
    path: Path, names: Sequence[str], metadata: Mapping[str, str], n_classes: int
) -> tuple[tuple[str, ...], str]:
    """The network's class names and, in words, where they come from."""
    sidecar = path.with_suffix(".yaml")
    if names:
        found, source = tuple(names), "as given"
    elif "names" in metadata:
        found, source = _names_in_metadata(path, metadata["names"]), "from the model's metadata"
    elif sidecar.is_file():
        found, source = _names_in_yaml(sidecar), f"from {sidecar.name} beside it"
    elif n_classes == len(COCO_CLASSES):
        found, source = COCO_CLASSES, "it has none; 85 columns, so COCO's 80"
    else:
        raise ModelError(
            f"{path}: it has {n_classes} classes without names; give them with --names a,b,c or --names FILE."
        )
    if len(found) != n_classes:
        raise ModelError(f"{path}: it has {n_classes} classes, but {len(found)} names ({source}); give all, in order.")
    return found, source


def _names_in_metadata(path: Path, text: str) -> tuple[str, ...]:
    """Names as Ultralytics' exporter writes them: a Python mapping or list as text."""
    try:
        return _listed(ast.literal_eval(text))
    except (SyntaxError, ValueError, TypeError) as error:
        raise ModelError(
            f"{path}: its metadata 'names' is no list of names ({text[:40]}); give them with --names."
        ) from error


def _names_in_yaml(path: Path) -> tuple[str, ...]:
    try:
        return _listed(yaml.safe_load(path.read_text(encoding="utf-8"))["names"])
    except (OSError, yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
        raise ModelError(f"{path}: a list 'names: [a, b, ...]' wanted ({type(error).__name__}).") from error


def _listed(names: object) -> tuple[str, ...]:
    """Names from a list, or from a mapping number -> name as YOLO's tools write it."""
    if isinstance(names, Mapping):
        return tuple(str(names[key]) for key in sorted(names))
    if isinstance(names, Sequence) and not isinstance(names, str):
        return tuple(str(name) for name in names)
    raise TypeError("names are neither a list nor a mapping")
