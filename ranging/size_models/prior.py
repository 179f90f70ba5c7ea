"""SizePrior: prior of the size, yaw and distance of objects of a class; ShapeTables: the boxes that this prior implies.

    log (height, width, length) ~ sum_b fraction_b N(mean_b, covariance_b)  over the objects of all drives
    yaw                         ~ weights of a few angles to the camera's axis, the same to the left and right
    log distance                ~ N(mean, sigma)                            wide: it only makes 500 m unlikely

The components b are body types (small van, high-roof van, lorry); classes whose sizes vary little have a single type.

`ShapeTables` contain the geometry of `cuboid.py` at nodes of yaw, bearing and log distance, with slopes for linear
interpolation, so that the boxes of a frame need a single look-up.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Field

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.schemas.validation import Integer, Number
from track_range.ranging.size_models.cuboid import CuboidBox, Floats, box_of_cuboid
from track_range.ranging.size_models.size_model import SIZE_CLASSES, Sigma, SizeM

# denser where the box width changes
YAW_DEG = np.array([0.0, 3.0, 7.0, 12.0, 20.0, 32.0, 48.0, 68.0, 90.0])
# of the boxes in the tables, that of KITTI; box sizes hardly depend on it
NODE_CAMERA_HEIGHT_M = 1.65
# (K,) yaw of the bins of the tables, to both sides
_YAW_RAD = np.radians(np.concatenate([YAW_DEG, -YAW_DEG[1:-1]]))
_BEARING_STEP = 0.06  # spacing of the nodes in the tangent of the bearing
_BEARINGS = np.arange(21) * _BEARING_STEP  # tangent of the bearing of the nodes, up to 50 degrees
_LOG_STEP = 0.1  # spacing of the nodes in log distance
# log distance of the nodes, from 4 to 250 m
_LOG_M = np.arange(np.log(4.0), np.log(250.0), _LOG_STEP)
NODE_RANGE = float(_LOG_M[0]), float(_LOG_M[-1])  # smallest and largest log distance of the nodes
_N_NODE_VALUES = 10  # number of values per node, in the order given by `Nodes`
_SIZE_STEP = 0.02  # step of the numerical derivatives in log size
Floats32 = npt.NDArray[np.float32]
_Log = Annotated[Number, Field(ge=-100, le=100)]  # logarithm in a file; larger values overflow

_Correlation = Annotated[Number, Field(ge=-1, le=1)]
_Weight = Annotated[Number, Field(ge=0, le=100)]


@dataclass(frozen=True, slots=True, kw_only=True)
class BodySizes:
    """Sizes of objects of one body type; the names of the attributes are keys of curve files."""

    hwl_m: tuple[SizeM, SizeM, SizeM]  # typical height, width and length in metres
    # standard deviations of log height, log width and log length
    log_sigma: tuple[Sigma, Sigma, Sigma]
    # correlations of log height and width, height and length, width and length
    correlation: tuple[_Correlation, _Correlation, _Correlation]

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) covariance of log height, log width and log length."""
        hw, hl, wl = self.correlation
        correlation = np.array([[1.0, hw, hl], [hw, 1.0, wl], [hl, wl, 1.0]])
        return np.asarray(correlation * np.outer(self.log_sigma, self.log_sigma))


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyType(BodySizes):
    """One component of the sizes of a class."""

    name: str  # name of the body type, such as "high roof"
    share: Annotated[Number, Field(gt=0, le=1)]  # probability of the type within the class


@dataclass(frozen=True, slots=True, kw_only=True)
class SizePrior(BodySizes):
    """Prior of one class; the names of the attributes are keys of curve files. The sizes cover all
    body types.

    Attributes:
        turn_weights: probability of each yaw in `YAW_DEG`; they sum to 1.
        log_distance: mean and standard deviation of log distance, in metres.
        offset: mean of the log height and log width of boxes minus the values of the cuboid.
        scatter: standard deviations about `offset`, from shapes that are not cuboids (mirrors,
            swinging arms).
        stands: whether objects of the class are on the road.
        n_boxes: number of labels that the prior was fitted to; 0 = a standard size.
        n_tracks: number of objects in these labels; 0 = a standard size.
        source: origin of the values.
        drive_sigma: standard deviation of the mean log height of the objects of a drive, part of
            `log_sigma`.
        bodies: body types whose mixture describes the sizes; empty = a single Gaussian.
    """

    turn_weights: tuple[_Weight, ...]
    log_distance: tuple[_Log, Sigma]
    offset: tuple[_Log, _Log]
    scatter: tuple[Sigma, Sigma]
    stands: bool
    n_boxes: Integer
    n_tracks: Integer
    source: str
    drive_sigma: Sigma = 0.03
    bodies: tuple[BodyType, ...] = ()

    @property
    def components(self) -> tuple[tuple[float, BodySizes], ...]:
        """Probability and sizes of each body type; a class without body types has one type."""
        return tuple((body.share, body) for body in self.bodies) or ((1.0, self),)

    def faults(self) -> str:
        """Description of the first invalid value; empty = all are valid."""
        if len(self.turn_weights) != len(YAW_DEG) or sum(self.turn_weights) <= 0:
            return f"expected {len(YAW_DEG)} turn_weights, not all 0"
        if not all(
            np.linalg.eigvalsh(sizes.covariance).min() > 0 for sizes in (self, *self.bodies)
        ):
            return "the correlation matrix must be positive definite"
        return ""


class Nodes(NamedTuple):
    """Values at the nodes nearest to N boxes, for M body types and K yaw bins each.

    The tables hold the 10 values of a node in this order, so that one look-up reads them all.
    """

    # (2, 2, N, M, K) slopes in log distance of log height and log width, then these
    slopes_and_sizes: Floats32
    per_bearing: Floats32  # (2, N, M, K) slopes in bearing of log height and log width
    variance: Floats32  # (2, N, M, K) their variances, from sizes and scatter
    covariance: Floats32  # (N, M, K) their covariance
    # (N, M, K) log of the distance divided by the nearest ground point's
    log_contact_ratio: Floats32


class ShapeTables:
    """Boxes of all body types at nodes of yaw, bearing and log distance, as values with slopes."""

    def __init__(self, priors: Mapping[str, SizePrior]) -> None:
        """Compute the nodes of every body type from its prior, in about 15 ms each."""
        types = [
            (name, prior, fraction, sizes)
            for name, prior in priors.items()
            for fraction, sizes in prior.components
        ]
        self.class_name = tuple(name for name, *_ in types)  # (B,) class of each body type
        # (B,) probability within the class
        self.fraction = np.array([fraction for _, _, fraction, _ in types])
        # (nodes of all body types, 10 K): one look-up reads the values of a node, side by side
        self._nodes = np.concatenate([_nodes(prior, sizes) for _, prior, _, sizes in types])
        # (B, K) log weights of the yaw bins
        self.log_weight = np.array([_log_weight(prior) for _, prior, _, _ in types], np.float32)
        self.typical = np.array(  # (3, B) log height, and mean and 1 / variance of log distance
            [
                (np.log(sizes.hwl_m[0]), p.log_distance[0], p.log_distance[1] ** -2)
                for _, p, _, sizes in types
            ]
        ).T

    def at(
        self, body: IntArray, bearing: FloatArray, log_m: FloatArray
    ) -> tuple[FloatArray, FloatArray, Nodes]:
        """Bearing (N,) and log distance (N, M) of N boxes of M body types relative to the nearest
        nodes, and the nodes.

        `body` (N, M) are the types, `bearing` (N,) is |tan bearing|, `log_m` (N, M) within
        `NODE_RANGE`.
        """
        b = np.minimum((bearing / _BEARING_STEP + 0.5).astype(np.int64), len(_BEARINGS) - 1)
        d = ((log_m - _LOG_M[0]) / _LOG_STEP + 0.5).astype(np.int64)
        bearing_step = np.minimum(bearing - b * _BEARING_STEP, _BEARING_STEP)
        node = (body * len(_BEARINGS) + b[:, None]) * len(_LOG_M) + d
        by_node = self._nodes.take(node.ravel(), axis=0).reshape(*node.shape, _N_NODE_VALUES, -1)
        v = np.ascontiguousarray(by_node.transpose(2, 0, 1, 3))
        both = v[:4].reshape(2, 2, *v.shape[1:])
        return bearing_step, log_m - _LOG_M[d], Nodes(both, v[4:6], v[6:8], *v[8:])


@lru_cache(maxsize=4)
def shape_tables(priors: tuple[tuple[str, SizePrior], ...]) -> ShapeTables:
    """The tables of the classes, by name and prior, which equal priors share."""
    return ShapeTables(dict(priors))


@lru_cache(maxsize=4 * len(SIZE_CLASSES))
def _nodes(prior: SizePrior, sizes: BodySizes) -> Floats32:
    """(bearings x distances, 10 x yaw bins) node values of one body type, in single precision;
    read-only, since equal priors share them.
    """
    bearing, log_m, yaw = (axis.astype(np.float32) for axis in np.ix_(_BEARINGS, _LOG_M, _YAW_RAD))
    box_for = partial(
        box_of_cuboid,
        yaw_rad=yaw,
        bearing=bearing,
        distance_m=np.exp(log_m),
        camera_height_m=NODE_CAMERA_HEIGHT_M,
    )
    mean = np.log(sizes.hwl_m).astype(np.float32)
    typical = box_for(mean)
    value = _log_size(typical)
    # another height changes neither the place of a cuboid nor the width of its box
    higher, lower = (
        typical.log_height_of(np.exp(mean[0] + step), NODE_CAMERA_HEIGHT_M)
        for step in (_SIZE_STEP, -_SIZE_STEP)
    )
    by_size = np.zeros((3, *value.shape), np.float32)
    by_size[0, 0] = (higher - lower) / (2 * _SIZE_STEP)
    for side in (1, 2):
        step = _SIZE_STEP * np.identity(3, np.float32)[side]
        longer = _log_size(box_for(mean + step, start=typical))
        shorter = _log_size(box_for(mean - step, start=typical))
        by_size[side] = (longer - shorter) / (2 * _SIZE_STEP)
    covariance = sizes.covariance
    a, c, b = (
        np.einsum("i...,ij,j...", by_size[:, i], covariance, by_size[:, j])
        for i, j in ((0, 0), (1, 1), (0, 1))
    )
    a, c = a + prior.scatter[0] ** 2, c + prior.scatter[1] ** 2
    slopes = [
        np.gradient(value, step, axis=axis) for axis, step in ((2, _LOG_STEP), (1, _BEARING_STEP))
    ]
    value += np.array(prior.offset, np.float32)[:, None, None, None]
    per_log_m, per_bearing = slopes
    rest = np.stack([a, c, b, typical.log_inverse_depth + log_m])
    nodes = np.concatenate([per_log_m, value, per_bearing, rest]).astype(np.float32)
    nodes = nodes.transpose(1, 2, 0, 3).reshape(len(_BEARINGS) * len(_LOG_M), -1)
    nodes.setflags(write=False)
    return nodes


def _log_weight(prior: SizePrior) -> FloatArray:
    """(K,) log weights of the yaw bins; those of a prior are for both sides together."""
    turn_weights = np.array(prior.turn_weights)
    half = turn_weights / turn_weights.sum()
    half[1:-1] /= 2
    return np.asarray(np.log(np.maximum(np.concatenate([half, half[1:-1]]), 1e-9)))


def _log_size(box: CuboidBox) -> Floats:
    return np.stack([box.log_height, box.log_width])
