"""Augmentation: four images as a mosaic, each scaled, moved and mirrored; then colours.

An image larger than its part of the mosaic shows a part of itself that has an object in it, where there is one. Every
image goes from its own pixels to the training image in one affine map, so nothing is resampled twice. The scale
is drawn per image and evenly on a logarithmic axis: small objects are made from large ones as often as the other way.
(Mosaic: Bochkovskiy et al., "YOLOv4", 2020.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, Image, IntArray

PAD_GREY = 114
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class AugmentationSettings:
    """How strongly training images are changed; the shares are probabilities.

    Attributes:
        mosaic: share of training images made of four.
        min_gain, max_gain: scale of an image, relative to its longer side filling the training image.
        rotation_deg, shear_deg: each is drawn from -x..x.
        shift: how far a single smaller image may move, as a share of the room around it.
        mirror: share mirrored left to right.
        hue, saturation, value: relative changes, drawn from -x..x (YOLOv5's).
    """

    mosaic: float = 0.9
    min_gain: float = 0.5
    max_gain: float = 1.5
    rotation_deg: float = 0.0
    shear_deg: float = 0.0
    shift: float = 1.0
    mirror: float = 0.5
    hue: float = 0.015
    saturation: float = 0.7
    value: float = 0.4


MIN_SIDE_PX = 2.0
MIN_SHARE = 0.1
"""Of a box's area that must still be visible for it to be learnt (YOLOv5's)."""


@dataclass(frozen=True, slots=True)
class LabelledPixels:
    """An image and its labels.

    Attributes:
        image: (H, W, 3) uint8; BGR on the way in, RGB once augmented.
        xyxy: (M, 4) float64 boxes in corner coordinates (the left edge is 0).
        class_index: (M,) int64.
        is_ignored: (M,) neither right nor wrong to find.
        is_complete: (2, 2, C) by class, all are labelled: above, below x left, right of `meeting_xy`.
        meeting_xy: (2,) where the parts of a mosaic meet; anywhere for a single image.
    """

    image: Image
    xyxy: FloatArray
    class_index: IntArray
    is_ignored: BoolArray
    is_complete: BoolArray
    meeting_xy: FloatArray = field(default_factory=lambda: np.zeros(2))


def single(
    source: LabelledPixels, size_px: int, settings: AugmentationSettings, rng: np.random.Generator
) -> LabelledPixels:
    """One image in a square."""
    part = _Part(slice(0, size_px), slice(0, size_px), (0, 0))
    return _finished([source], [part], size_px, settings, rng)


def mosaic(
    sources: Sequence[LabelledPixels], size_px: int, settings: AugmentationSettings, rng: np.random.Generator
) -> LabelledPixels:
    """Four images, each in a quarter of a square, which meet in one point."""
    x, y = (int(at) for at in rng.uniform(0.2, 0.8, 2) * size_px)
    columns, rows = (slice(0, x), slice(x, size_px)), (slice(0, y), slice(y, size_px))
    parts = [_Part(columns[i], rows[j], (2 * i - 1, 2 * j - 1)) for j in (0, 1) for i in (0, 1)]
    whole = _finished(sources, parts, size_px, settings, rng)
    complete = np.stack([source.is_complete[0, 0] for source in sources]).reshape(2, 2, -1)
    return replace(whole, is_complete=complete, meeting_xy=np.array([x, y], np.float64))


@dataclass(frozen=True, slots=True)
class _Part:
    """Where in the square an image may show.

    Attributes:
        columns, rows: of the square.
        side: (x, y) on which side of the mosaic's meeting point it lies, -1 or 1; 0 = there is no such point.
    """

    columns: slice
    rows: slice
    side: tuple[int, int]


def _affine(
    source: LabelledPixels, part: _Part, size_px: int, settings: AugmentationSettings, rng: np.random.Generator
) -> FloatArray:
    """(2, 3) from corner coordinates of the image to those of the square."""
    size = np.array([source.image.shape[1], source.image.shape[0]], np.float64)
    gain = math.exp(rng.uniform(math.log(settings.min_gain), math.log(settings.max_gain))) * size_px / size.max()
    turn, shear = (math.radians(rng.uniform(-x, x)) if x else 0.0 for x in (settings.rotation_deg, settings.shear_deg))
    flip = -1.0 if rng.random() < settings.mirror else 1.0
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    linear = gain * rotation @ np.array([[flip, math.tan(shear)], [0.0, 1.0]])
    extent = np.abs(linear) @ size
    focus = extent / 2 + linear @ (_point_of_interest(source, size, rng) - size / 2)
    ranges = ((part.columns.start, part.columns.stop), (part.rows.start, part.rows.stop))
    low = [
        _low_edge(span, extent[axis], focus[axis], part.side[axis], settings.shift, rng)
        for axis, span in enumerate(ranges)
    ]
    return np.column_stack([linear, np.array(low) + extent / 2 - linear @ size / 2])


def _point_of_interest(source: LabelledPixels, size: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A point of the image that should show: in an object, where there is one."""
    n = len(source.xyxy)
    share = rng.random(2)
    if n == 0:
        return share * size
    box = source.xyxy[rng.integers(n)]
    return np.asarray(box[:2] + share * (box[2:] - box[:2]))


def _low_edge(
    span: tuple[int, int], extent: float, focus: float, side: int, shift: float, rng: np.random.Generator
) -> float:
    """Where on an axis an image of `extent` begins, so that it fills the span, or begins at the meeting point."""
    low, high = span
    place, jitter = rng.random(2)
    if extent > high - low:
        return float(np.clip(low + place * (high - low) - focus, high - extent, low))
    if side:
        return float(high - extent if side < 0 else low)
    return float(low + (high - low - extent) * (0.5 + shift * (jitter - 0.5)))


def _finished(
    sources: Sequence[LabelledPixels],
    parts: Sequence[_Part],
    size_px: int,
    settings: AugmentationSettings,
    rng: np.random.Generator,
) -> LabelledPixels:
    """Pixels and labels of all sources in one square."""
    canvas: Image = np.full((size_px, size_px, 3), PAD_GREY, np.uint8)
    moved = []
    for source, part in zip(sources, parts, strict=True):
        matrix = _affine(source, part, size_px, settings, rng)
        _paint(source.image, matrix, canvas, part)
        moved.append(_moved(source, matrix, part))
    boxes, class_index, ignored = (np.concatenate(column) for column in zip(*moved, strict=True))
    return LabelledPixels(_coloured(canvas, settings, rng), boxes, class_index, ignored, sources[0].is_complete)


def _paint(image: Image, matrix: FloatArray, canvas: Image, shown: _Part) -> None:
    """Draw the image into its part of the canvas; what it does not cover stays."""
    part = canvas[shown.rows, shown.columns]
    if part.size == 0:
        return
    centres = matrix.copy()  # OpenCV's pixels have their centres at whole numbers, corner coordinates at halves
    centres[:, 2] += matrix[:, :2] @ np.array([0.5, 0.5]) - 0.5 - np.array([shown.columns.start, shown.rows.start])
    cv2.warpAffine(
        image,
        centres,
        (part.shape[1], part.shape[0]),
        dst=part,
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_TRANSPARENT,
    )


def _moved(source: LabelledPixels, matrix: FloatArray, part: _Part) -> tuple[FloatArray, IntArray, BoolArray]:
    """Boxes on the canvas, cut at their part's edges; those of which too little is left are ignored."""
    low, high = source.xyxy[:, None, :2], source.xyxy[:, None, 2:]
    corners = (low + (high - low) * _CORNERS) @ matrix[:, :2].T + matrix[:, 2]
    whole = np.concatenate([corners.min(1), corners.max(1)], axis=1).reshape(-1, 4)
    first = np.array([part.columns.start, part.rows.start] * 2)
    last = np.array([part.columns.stop, part.rows.stop] * 2)
    boxes = np.clip(whole, first, last)
    size, full = boxes[:, 2:] - boxes[:, :2], whole[:, 2:] - whole[:, :2]
    share = size.prod(1) / np.maximum(full.prod(1), 1e-9)
    too_little = (size.min(1, initial=np.inf) < MIN_SIDE_PX) | (share < MIN_SHARE)
    keep = size.min(1, initial=np.inf) > 0
    return boxes[keep], source.class_index[keep], (source.is_ignored | too_little)[keep]


def _coloured(bgr: Image, settings: AugmentationSettings, rng: np.random.Generator) -> Image:
    """RGB, with hue, saturation and value changed."""
    gains = 1 + rng.uniform(-1, 1, 3) * (settings.hue, settings.saturation, settings.value)
    if not (settings.hue or settings.saturation or settings.value):
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)
    level = np.arange(256, dtype=np.float64)
    table = np.stack([level * gains[0] % 180, *(np.clip(level * gain, 0, 255) for gain in gains[1:])], -1)
    hsv = cv2.LUT(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV), table.astype(np.uint8)[None])
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB), np.uint8)
