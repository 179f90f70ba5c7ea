"""Priors over sizes from labels with 3-D boxes, and standard sizes for classes that the labels do not have.

Sizes are a matter of objects, not of boxes: an object that is seen in n frames counts n^0.8, since it says one thing of
the sizes in the world, but what is long in view here is likely to be so elsewhere. Their spread over all drives is at
once the error between objects and between drives. Standard sizes count as a few objects more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.size_models.cuboid import box_of_cuboid
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.curve import CurveError
from track_range.ranging.size_models.prior import NODE_CAMERA_HEIGHT_M, YAW_DEG, SizePrior

MIN_OBJECTS, MIN_BOXES = 3, 100
"""Fewer objects or boxes of a class tell nothing: its standard size it is."""

_OBJECT_POWER, _BOX_POWER = 0.8, -0.5  # how an object's n boxes count together, and each of them alone
_STANDARD_OBJECTS = 1.0
_TURN_FLOOR = 0.1  # share of turns that are as likely as any
_LEAST_SCATTER = (0.01, 0.02)
_TYPICAL_DISTANCE = (3.2, 1.2)  # 25 m, and 2.3 times more or less: hardly anything, so that it serves every road

_UPRIGHT = (0.3, 0.2, 0.2)
STANDARD_SIZES: Mapping[str, tuple[tuple[float, float, float], tuple[float, float, float], str]] = {
    "person": ((1.70, 0.55, 0.55), (0.08, 0.25, 0.35), "adults 1.55-1.90 m, children among them"),
    "bicycle": ((1.73, 0.60, 1.75), (0.06, 0.25, 0.10), "a rider on a bicycle"),
    "car": ((1.52, 1.75, 4.20), (0.08, 0.08, 0.13), "passenger cars, sizes of sold models"),
    "van": ((2.05, 1.92, 4.90), (0.14, 0.08, 0.15), "delivery vans and minibuses"),
    "truck": ((3.35, 2.50, 8.50), (0.14, 0.07, 0.30), "lorries of 7-40 t"),
    "bus": ((3.10, 2.50, 11.5), (0.12, 0.07, 0.20), "city buses 2.9-3.3 m high, coaches to 3.8 m, minibuses 2.5 m"),
    "motorcycle": ((1.55, 0.80, 2.10), (0.12, 0.20, 0.12), "a motorcycle with its rider, 1.3-1.8 m"),
    "traffic light": ((0.95, 0.35, 0.35), (0.35, 0.35, 0.35), "three lamps of 200 or 300 mm; some have one, two, four"),
    "traffic sign": ((0.70, 0.70, 0.05), (0.30, 0.30, 0.30), "round and octagonal signs of 600-900 mm"),
}
"""Height, width, length in metres, relative standard deviations, and from what."""

_HANGING = ("traffic light", "traffic sign")


@dataclass(frozen=True, slots=True)
class LabelledSizes:
    """Labelled boxes with their 3-D boxes, one row per object and frame.

    Attributes:
        size_class: (N,) name.
        object_id: (N,) unique over all sequences.
        wh_over_f: (N, 2) width / fx and height / fy.
        bearing: (N,) tangent of the middle column's angle.
        distance_m: (N,) to the surface.
        size_hwl_m: (N, 3).
        rotation_y_rad: (N,) KITTI's.
        is_whole: (N,) not cut off by the image's border.
    """

    size_class: npt.NDArray[np.str_]
    object_id: IntArray
    wh_over_f: FloatArray
    bearing: FloatArray
    distance_m: FloatArray
    size_hwl_m: FloatArray
    rotation_y_rad: FloatArray
    is_whole: BoolArray

    def select(self, keep: BoolArray | IntArray) -> LabelledSizes:
        """The rows that a mask or an index array names."""
        return LabelledSizes(*(getattr(self, field.name)[keep] for field in fields(self)))

    @property
    def yaw_rad(self) -> FloatArray:
        """(N,) of the long side away from the camera's axis, -pi/2 to pi/2: front and back look alike."""
        return np.asarray(np.mod(self.rotation_y_rad, np.pi) - np.pi / 2)


def fit_size_priors(labels: LabelledSizes, *, source: str) -> CuboidSizes:
    """Priors of every class with a standard size, learnt where the labels have enough of it.

    Raises:
        CurveError: no class has `MIN_OBJECTS` objects and `MIN_BOXES` boxes with 3-D boxes.
    """
    labels = labels.select((labels.size_hwl_m > 0).all(axis=1) & np.isfinite(labels.distance_m))
    learnt = {}
    for name in STANDARD_SIZES:
        mine = labels.select(labels.size_class == name)
        if len(np.unique(mine.object_id)) >= MIN_OBJECTS and len(mine.object_id) >= MIN_BOXES:
            learnt[name] = _learnt(name, mine, source)
    if not learnt:
        names, counts = np.unique(labels.size_class, return_counts=True)
        available = ", ".join(f"{n} {c}" for n, c in zip(names, counts, strict=True)) or "none"
        raise CurveError(
            f"expected at least {MIN_BOXES} labels with 3-D boxes of at least {MIN_OBJECTS} objects of one class, "
            f"got {available}."
        )
    return CuboidSizes({name: learnt.get(name) or _standard(name) for name in STANDARD_SIZES})


def _standard(name: str) -> SizePrior:
    hwl_m, sigma, source = STANDARD_SIZES[name]
    return SizePrior(
        hwl_m=hwl_m,
        log_sigma=sigma,
        correlation=_UPRIGHT,
        turn_weights=tuple(np.full(len(YAW_DEG), round(1 / len(YAW_DEG), 4)).tolist()),
        log_distance=_TYPICAL_DISTANCE,
        offset=(0.0, 0.0),
        scatter=(0.02, 0.05),
        stands=name not in _HANGING,
        n_boxes=0,
        n_tracks=0,
        source=f"standard size, not fitted: {source}",
    )


def _learnt(name: str, labels: LabelledSizes, source: str) -> SizePrior:
    _, first, row, counts = np.unique(labels.object_id, return_index=True, return_inverse=True, return_counts=True)
    mean, covariance = _sizes(name, labels.size_hwl_m[first], counts)
    sigma = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    weight = counts.astype(np.float64)[row.reshape(-1)] ** _BOX_POWER
    offset, scatter = _beside_the_cuboid(labels, weight)
    return SizePrior(
        hwl_m=_rounded(np.exp(mean), 3),
        log_sigma=_rounded(sigma, 4),
        correlation=_rounded(np.clip(correlation[[0, 0, 1], [1, 2, 2]], -0.95, 0.95), 3),
        turn_weights=tuple(_turns(np.abs(np.degrees(labels.yaw_rad)), weight).round(4).tolist()),
        log_distance=_TYPICAL_DISTANCE,
        offset=offset,
        scatter=scatter,
        stands=name not in _HANGING,
        n_boxes=len(labels.object_id),
        n_tracks=len(counts),
        source=source,
    )


def _sizes(name: str, size_hwl_m: FloatArray, counts: IntArray) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of log sizes over (M, 3) objects with (M,) boxes, and the standard size as some more."""
    typical_m, sigma, _ = STANDARD_SIZES[name]
    log_size, weight = np.log(size_hwl_m), counts.astype(np.float64) ** _OBJECT_POWER
    effective = weight.sum() ** 2 / (weight**2).sum()  # so many objects of equal weight
    weight = weight / weight.sum() * effective
    total = effective + _STANDARD_OBJECTS
    mean = (weight @ log_size + _STANDARD_OBJECTS * np.log(typical_m)) / total
    away, typical = log_size - mean, np.log(typical_m) - mean
    scatter = (away * weight[:, None]).T @ away
    scatter += _STANDARD_OBJECTS * (np.diag(np.square(sigma)) + np.outer(typical, typical))
    return mean, scatter / (total - 1.0)


def _turns(turn_deg: FloatArray, weight: FloatArray) -> FloatArray:
    """Weights of `YAW_DEG`, each label shared between its two neighbours."""
    before = np.clip(np.searchsorted(YAW_DEG, turn_deg, side="right") - 1, 0, len(YAW_DEG) - 2)
    share = (turn_deg - YAW_DEG[before]) / np.diff(YAW_DEG)[before]
    seen = np.bincount(before, weight * (1 - share), len(YAW_DEG))
    seen += np.bincount(before + 1, weight * share, len(YAW_DEG))
    width = np.gradient(YAW_DEG)
    return np.asarray((1 - _TURN_FLOOR) * seen / seen.sum() + _TURN_FLOOR * width / width.sum())


def _beside_the_cuboid(labels: LabelledSizes, weight: FloatArray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Offset and scatter of log height and width of the boxes against their own cuboids, few outliers counting."""
    box = box_of_cuboid(
        np.log(labels.size_hwl_m).T,
        yaw_rad=labels.yaw_rad,
        bearing=labels.bearing,
        distance_m=labels.distance_m,
        camera_height_m=NODE_CAMERA_HEIGHT_M,
    )
    whole = weight * labels.is_whole
    found = []
    for seen, shape, mean_limit, limit in (
        (labels.wh_over_f[:, 1], box.log_height, 0.1, 0.06),
        (labels.wh_over_f[:, 0], box.log_width, 0.7, 0.3),
    ):
        away = np.log(seen) - shape
        offset = float(np.average(np.clip(away, -mean_limit, mean_limit), weights=whole))
        found.append((offset, float(np.sqrt(np.average(np.clip(away - offset, -limit, limit) ** 2, weights=whole)))))
    (first, first_scatter), (second, second_scatter) = found
    return _pair((first, second), 4), _pair(np.maximum((first_scatter, second_scatter), _LEAST_SCATTER), 4)


def _rounded(values: FloatArray, digits: int) -> tuple[float, float, float]:
    first, second, third = values.round(digits).tolist()
    return first, second, third


def _pair(values: tuple[float, float] | FloatArray, digits: int) -> tuple[float, float]:
    first, second = np.round(np.asarray(values, np.float64), digits).tolist()
    return first, second
