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
_N_NODE_VALUES = 11  # number of values per node, in the order given by `Nodes`
_SIZE_STEP = 0.02  # step of the numerical derivatives in log size
_Float32 = npt.NDArray[np.float32]
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
    """Values at the nodes nearest to N boxes, for K yaw bins and M body types each.

    The tables hold the 11 values of a node side by side, in this order, so that one look-up reads
    them all.
    """

    log_hw: _Float32  # (2, K, M, N) log height and log width
    per_log_m: _Float32  # (2, K, M, N) their slopes in log distance
    per_bearing: _Float32  # (2, K, M, N) their slopes in bearing
    variance: _Float32  # (2, K, M, N) their variances, from sizes and scatter
    covariance: _Float32  # (K, M, N) their covariance
    # (K, M, N) log of the distance divided by the nearest ground point's
    log_contact_ratio: _Float32
    log_weight: _Float32  # (K, M, N) log weight of the yaw bin


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
        self._nodes = np.concatenate(
            [
                _nodes(prior, sizes).reshape(len(_BEARINGS) * len(_LOG_M), -1)
                for _, prior, _, sizes in types
            ]
        )
        self.typical = np.array(  # (3, B) log height, and mean and 1 / variance of log distance
            [
                (np.log(sizes.hwl_m[0]), p.log_distance[0], p.log_distance[1] ** -2)
                for _, p, _, sizes in types
            ]
        ).T

    def at(
        self, body: IntArray, bearing: FloatArray, log_m: FloatArray
    ) -> tuple[FloatArray, FloatArray, Nodes]:
        """Bearing (N,) and log distance (M, N) of N boxes of M body types relative to the nearest
        nodes, and the nodes.

        `bearing` (N,) is |tan bearing|, `log_m` (M, N) within `NODE_RANGE`.
        """
        b = np.minimum((bearing / _BEARING_STEP + 0.5).astype(np.int64), len(_BEARINGS) - 1)
        d = ((log_m - _LOG_M[0]) / _LOG_STEP + 0.5).astype(np.int64)
        bearing_step = np.minimum(bearing - b * _BEARING_STEP, _BEARING_STEP)
        nodes = self._nodes.take((body * len(_BEARINGS) + b) * len(_LOG_M) + d, axis=0)
        nodes = np.ascontiguousarray(nodes.reshape(log_m.size, -1).T)
        v = nodes.reshape(_N_NODE_VALUES, len(_YAW_RAD), *log_m.shape)
        return bearing_step, log_m - _LOG_M[d], Nodes(v[:2], v[2:4], v[4:6], v[6:8], *v[8:])


@lru_cache(maxsize=4 * len(SIZE_CLASSES))
def _nodes(prior: SizePrior, sizes: BodySizes) -> Floats:
    """(bearings, distances, 11, yaw bins) node values of one body type; read-only, since equal
    priors share them.
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
    by_size = np.stack(
        [
            (
                _log_size(box_for(mean + step, start=typical))
                - _log_size(box_for(mean - step, start=typical))
            )
            / (2 * _SIZE_STEP)
            for step in (_SIZE_STEP * np.identity(3)).astype(np.float32)
        ]
    )
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
    turn_weights = np.array(prior.turn_weights)
    # of each yaw bin: the weights are for both sides together
    half = turn_weights / turn_weights.sum()
    half[1:-1] /= 2
    weight = np.broadcast_to(np.log(np.maximum(np.concatenate([half, half[1:-1]]), 1e-9)), a.shape)
    rest = np.stack([a, c, b, typical.log_inverse_depth + log_m, weight])
    nodes = np.concatenate([value, *slopes, rest]).transpose(1, 2, 0, 3)
    nodes.setflags(write=False)
    return nodes


def _log_size(box: CuboidBox) -> Floats:
    return np.stack([box.log_height, box.log_width])
