"""Augmentation: mosaics of four images, each scaled, shifted and mirrored, and changes of the
colours.

An image that is larger than its part of the mosaic is cropped so that an object is visible, if it
has one. Each image is resampled only once, with one affine transform. Its scale has a uniform
distribution on a logarithmic axis, so that objects are enlarged as often as reduced. (Mosaic:
Bochkovskiy et al., "YOLOv4", 2020.)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, Image, IntArray

PAD_GREY = 114  # grey level of the background, as in YOLOv5
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class AugmentationSettings:
    """Strength of the augmentation: limits x of angles and changes of colour (YOLOv5's), drawn
    uniformly from -x..x.
    """

    mosaic: float = 0.9  # probability that a training image is a mosaic of four images
    # of the scale, relative to an image whose longer side fills the training image
    min_gain: float = 0.5
    max_gain: float = 1.5
    rotation_deg: float = 0.0
    shear_deg: float = 0.0
    # range of the shift of a single smaller image, as a fraction of the free space
    shift: float = 1.0
    mirror: float = 0.5  # probability of mirroring left to right
    hue: float = 0.015
    saturation: float = 0.7
    value: float = 0.4


MIN_SIDE_PX = 2.0  # smallest visible side of a box that is not ignored
# smallest visible fraction of the area of a box that is not ignored (as in YOLOv5)
MIN_FRACTION = 0.1


@dataclass(frozen=True, slots=True)
class LabelledPixels:
    """An image and its labels."""

    image: Image  # (H, W, 3) uint8, BGR before and RGB after the augmentation
    xyxy: FloatArray  # (M, 4) float64 boxes in corner coordinates (the left edge is 0)
    class_index: IntArray  # (M,) int64 class of the network
    is_ignored: BoolArray  # (M,) detections of the object are neither true nor false positives
    # (M,) probability that there is such an object: 1 for labels, less for pseudo-labels
    confidence: FloatArray
    # (2, 2, C) classes completely labelled above and below, left and right of `meeting_xy`
    is_complete: BoolArray
    # where the parts of a mosaic meet
    meeting_xy: FloatArray = field(default_factory=lambda: np.zeros(2))


def single(
    source: LabelledPixels, size_px: int, settings: AugmentationSettings, rng: np.random.Generator
) -> LabelledPixels:
    """A training image of side `size_px` from one image."""
    part = _Part(slice(0, size_px), slice(0, size_px), (0, 0))
    return _combined([source], [part], size_px, settings, rng)


def mosaic(
    sources: Sequence[LabelledPixels],
    size_px: int,
    settings: AugmentationSettings,
    rng: np.random.Generator,
) -> LabelledPixels:
    """A training image of side `size_px` from four images, which meet in a random point."""
    x, y = (int(position) for position in rng.uniform(0.2, 0.8, 2) * size_px)
    columns, rows = (slice(0, x), slice(x, size_px)), (slice(0, y), slice(y, size_px))
    parts = [_Part(columns[i], rows[j], (2 * i - 1, 2 * j - 1)) for j in (0, 1) for i in (0, 1)]
    combined = _combined(sources, parts, size_px, settings, rng)
    complete = np.stack([source.is_complete[0, 0] for source in sources]).reshape(2, 2, -1)
    return replace(combined, is_complete=complete, meeting_xy=np.array([x, y], np.float64))


@dataclass(frozen=True, slots=True)
class _Part:
    """The part of a training image, in its `columns` and `rows`, that shows one image."""

    columns: slice
    rows: slice
    side: tuple[int, int]  # (x, y) side of the meeting point, -1 or 1; 0 = no mosaic


def _affine(
    source: LabelledPixels,
    part: _Part,
    size_px: int,
    settings: AugmentationSettings,
    rng: np.random.Generator,
) -> FloatArray:
    """(2, 3) random affine transform from corner coordinates of an image to the training image."""
    size = np.array([source.image.shape[1], source.image.shape[0]], np.float64)
    gain = (
        math.exp(rng.uniform(math.log(settings.min_gain), math.log(settings.max_gain)))
        * size_px
        / size.max()
    )
    angle, shear = (
        math.radians(rng.uniform(-x, x)) if x else 0.0
        for x in (settings.rotation_deg, settings.shear_deg)
    )
    flip = -1.0 if rng.random() < settings.mirror else 1.0
    rotation = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    linear = gain * rotation @ np.array([[flip, math.tan(shear)], [0.0, 1.0]])
    extent = np.abs(linear) @ size
    fraction = rng.random(2)
    interest = fraction * size  # point that should be visible: in an object, if there is one
    if len(source.xyxy):
        box = source.xyxy[rng.integers(len(source.xyxy))]
        interest = box[:2] + fraction * (box[2:] - box[:2])
    focus = extent / 2 + linear @ (interest - size / 2)
    low = [
        _low_edge(span, extent[axis], focus[axis], part.side[axis], settings.shift, rng)
        for axis, span in enumerate((part.columns, part.rows))
    ]
    return np.column_stack([linear, np.array(low) + extent / 2 - linear @ size / 2])


def _low_edge(
    span: slice, extent: float, focus: float, side: int, shift: float, rng: np.random.Generator
) -> float:
    """Start of an image of size `extent` on one axis, so that it fills the span or starts at the
    meeting point.
    """
    low, high = span.start, span.stop
    position, jitter = rng.random(2)
    if extent > high - low:
        return float(np.clip(low + position * (high - low) - focus, high - extent, low))
    if side:
        return float(high - extent if side < 0 else low)
    return float(low + (high - low - extent) * (0.5 + shift * (jitter - 0.5)))


def _combined(
    sources: Sequence[LabelledPixels],
    parts: Sequence[_Part],
    size_px: int,
    settings: AugmentationSettings,
    rng: np.random.Generator,
) -> LabelledPixels:
    canvas: Image = np.full((size_px, size_px, 3), PAD_GREY, np.uint8)
    labels = []
    for source, part in zip(sources, parts, strict=True):
        matrix = _affine(source, part, size_px, settings, rng)
        shown = canvas[part.rows, part.columns]
        if shown.size:
            # OpenCV's pixel centres are at integers, those of corner coordinates at halves
            centres = matrix.copy()
            first = np.array([part.columns.start, part.rows.start])
            centres[:, 2] += matrix[:, :2] @ np.array([0.5, 0.5]) - 0.5 - first
            options = {"flags": cv2.INTER_LINEAR, "borderMode": cv2.BORDER_TRANSPARENT}
            cv2.warpAffine(
                source.image, centres, (shown.shape[1], shown.shape[0]), dst=shown, **options
            )
        labels.append(_transformed_labels(source, matrix, part))
    boxes, class_index, ignored, confidence = (
        np.concatenate(column) for column in zip(*labels, strict=True)
    )
    image = _coloured(canvas, settings, rng)
    return LabelledPixels(image, boxes, class_index, ignored, confidence, sources[0].is_complete)


def _transformed_labels(
    source: LabelledPixels, matrix: FloatArray, part: _Part
) -> tuple[FloatArray, IntArray, BoolArray, FloatArray]:
    """Boxes clipped to the part, with classes, ignored flags (also set if too little is visible)
    and confidences.
    """
    low, high = source.xyxy[:, None, :2], source.xyxy[:, None, 2:]
    corners = (low + (high - low) * _CORNERS) @ matrix[:, :2].T + matrix[:, 2]
    full = np.concatenate([corners.min(1), corners.max(1)], axis=1).reshape(-1, 4)
    first = np.array([part.columns.start, part.rows.start] * 2)
    last = np.array([part.columns.stop, part.rows.stop] * 2)
    boxes = np.clip(full, first, last)
    size, full_size = boxes[:, 2:] - boxes[:, :2], full[:, 2:] - full[:, :2]
    fraction = size.prod(1) / np.maximum(full_size.prod(1), 1e-9)
    is_too_small = (size.min(1, initial=np.inf) < MIN_SIDE_PX) | (fraction < MIN_FRACTION)
    is_visible = size.min(1, initial=np.inf) > 0
    is_ignored = source.is_ignored | is_too_small
    return (
        boxes[is_visible],
        source.class_index[is_visible],
        is_ignored[is_visible],
        source.confidence[is_visible],
    )


def _coloured(bgr: Image, settings: AugmentationSettings, rng: np.random.Generator) -> Image:
    gains = 1 + rng.uniform(-1, 1, 3) * (settings.hue, settings.saturation, settings.value)
    if not (settings.hue or settings.saturation or settings.value):
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)
    level = np.arange(256, dtype=np.float64)
    table = np.stack(
        [level * gains[0] % 180, *(np.clip(level * gain, 0, 255) for gain in gains[1:])], -1
    )
    hsv = cv2.LUT(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV), table.astype(np.uint8)[None])
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB), np.uint8)
