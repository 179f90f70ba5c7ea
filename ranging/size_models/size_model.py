"""SizeModel: protocol of models that give the distance of a box from its size, and the boxes that
they measure.

DriveState: evidence from the objects of a drive about its ground plane and about their own body
types.

    y_i = y0 + delta_t + H x_i + r_i            y_i: bottom edge, x_i = 1 / z_i by size, H: camera height
    delta_t ~ N(0, lambda pitch^2)              pitch and slope of the road at a time
    r_i ~ N(0, lambda (roll_i^2 + kerb_i^2))    contact point off the plane; lambda: roughness of the drive

A frame has few objects, and the size of each is known to some per cent only. y0, H and lambda are
common to a drive, so that objects seen before contribute to the objects of the frame. The size
error of an object is the same in all of its frames: an object counts once, with the mean of its
normal equations over its frames, and only after it has left; while it is in view it counts with its
present measurement.

The size and the body type of an object (`BodyType`) are the same in all of its frames, too. So are
its shape errors; therefore the log sizes and the log likelihoods of its views are averaged, not
summed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from pydantic import AfterValidator, Field

from track_range.detection.box_errors import NO_ERRORS, UNKNOWN_DETECTOR, BoxErrors
from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.files.input_files import quoted
from track_range.foundation.schemas.validation import Number
from track_range.foundation.track_state import TrackState
from track_range.stereo.geometry.camera import PinholeCamera

_MEMORY_S = 60.0  # time in s over which the contribution of an object that has left decays to 1/e
_ROUGHNESS_OBJECTS = 3.0  # weight of the prior roughness, 1, as a number of objects
_ROUGHNESS_RANGE = (0.2, 5.0)  # smallest and largest roughness lambda
_MAX_CHI2 = 9.0  # largest squared residual relative to its variance that counts for the roughness
# weight, relative to a new object, below which an object that has left is forgotten
_MIN_WEIGHT = 0.02
# of two body types from the earlier views of an object, since shapes are not cuboids
_MAX_LOG_RATIO = 1.0
_SIZE_MEMORY_S = 3.0  # time constant of the mean size of an object over its views
_N_MEANS = 7  # per object: five terms of the normal equations, two moments of the residuals

_N_GROUND, _N_VIEWS, _TIME, _WEIGHT, _SIZE, _BODIES = range(_N_MEANS, _N_MEANS + 6)
"""Rows of the state of an object after the means: frames on the ground, frames, time of the last,
weight of the mean log size and this mean; then the mean log likelihoods of the body types."""


class GroundTerms(NamedTuple):
    """Measurements of the ground plane by the N objects of a frame."""

    # (5, N) terms of the normal equations for (y0, H) (`shared_ground.solve_ground`)
    normal: FloatArray
    residual2: FloatArray  # (N,) squared residuals of the bottom edges
    # (N,) part of their variance that is proportional to the roughness, for a roughness of 1
    rough: FloatArray
    other: FloatArray  # (N,) rest of their variance
    is_on_ground: BoolArray  # (N,) whether the object is on the ground; others do not contribute


class DriveState:
    """State of one drive."""

    def __init__(self) -> None:
        self._tracks: TrackState | None = None
        self._track_id: IntArray = np.zeros(0, np.int64)
        # states of these tracks before the frame
        self._in_view: FloatArray = np.zeros((_BODIES, 0))
        self._time_s = 0.0
        # (5,) sums of the normal equations over the objects that left
        self.information: FloatArray = np.zeros(5)
        self.roughness = 1.0  # factor lambda of the variances of pitch and of contact points

    def start_frame(self, track_id: IntArray, time_s: float) -> None:
        """Start a frame with the tracks (N,) `track_id`, whose boxes are measured next."""
        self._track_id, self._time_s = track_id, time_s
        if self._tracks is None:
            return
        self._in_view = self._tracks.get(track_id)
        known, has_left = self._tracks.known, self._tracks.is_absent(track_id)
        means = known[:_N_MEANS] * np.exp((known[_TIME] - time_s) / _MEMORY_S)
        self.information = np.add.reduce(means[:5, has_left], axis=1)
        excess, expected = np.add.reduce(means[5:], axis=1).tolist()
        low, high = _ROUGHNESS_RANGE
        self.roughness = min(
            max((_ROUGHNESS_OBJECTS + excess) / (_ROUGHNESS_OBJECTS + expected), low), high
        )

    def body_evidence(self, n_bodies: int) -> FloatArray:
        """(B, N) mean log likelihoods of all B body types over the earlier views of the tracks; 0 =
        the most likely.
        """
        if self._tracks is None:
            return np.zeros((n_bodies, len(self._track_id)))
        return self._in_view[_BODIES:]

    def add(
        self,
        rows: IntArray,
        ground: GroundTerms | None,
        log_likelihood: FloatArray,
        log_size: FloatArray,
        variance: FloatArray,
    ) -> FloatArray:
        """Add the measurements of the tracks of the frame with the indices `rows` (N,).

        `ground` None = no object is on the ground; `log_likelihood` (B, N) of the body types, 0 =
        the most likely one, or one that the class does not have; `log_size` (N,) of the heights by
        this frame alone, with their `variance`. Returns the mean log sizes (N,) over the views of
        the last seconds.
        """
        if self._tracks is None:
            self._tracks = TrackState(np.zeros(_BODIES + len(log_likelihood)))
            self._in_view = self._tracks.get(self._track_id)
        track_id, state = self._track_id[rows], self._in_view[:, rows]
        if ground is not None:
            state[_N_GROUND] += ground.is_on_ground
            fraction = ground.is_on_ground / np.maximum(state[_N_GROUND], 1.0)
            # Terms of the normal equations and moments of the residuals of this frame.
            expected = ground.other + self.roughness * ground.rough
            gain = ground.rough / expected**2
            excess = np.minimum(ground.residual2, _MAX_CHI2 * expected) - ground.other
            means = state[:_N_MEANS]
            means[:5] += fraction * (ground.normal - means[:5])
            means[5] += fraction * (gain * excess - means[5])
            means[6] += fraction * (gain * ground.rough - means[6])
        forgetting = np.exp((state[_TIME] - self._time_s) / _SIZE_MEMORY_S)
        state[_WEIGHT] = 1.0 / variance + forgetting * state[_WEIGHT]
        state[_SIZE] += (log_size - state[_SIZE]) / (variance * state[_WEIGHT])
        state[_N_VIEWS] += 1.0
        state[_BODIES:] += (np.maximum(log_likelihood, -_MAX_LOG_RATIO) - state[_BODIES:]) / state[
            _N_VIEWS
        ]
        state[_TIME] = self._time_s
        age_s = self._time_s - self._tracks.known[_TIME]
        self._tracks.put(track_id, state, keep_known=age_s < -_MEMORY_S * math.log(_MIN_WEIGHT))
        return np.asarray(state[_SIZE])


SIZE_CLASSES = (*ROAD_CLASSES, "van")  # road classes, and vans, which differ in size from cars


def _known(name: str) -> str:
    if name not in SIZE_CLASSES:
        raise ValueError(
            f"expected one of the size classes {', '.join(SIZE_CLASSES)}, found {quoted(name)}"
        )
    return name


SizeClass = Annotated[str, AfterValidator(_known)]  # name of a size class in a file
# in a file; 1 / sigma^2 of smaller values overflows
Sigma = Annotated[Number, Field(ge=1e-4, le=100)]
# height, width or length of an object in a file, metres
SizeM = Annotated[Number, Field(ge=0.01, le=50)]

_HAS_PERSON = np.array([name in ("person", "bicycle", "motorcycle") for name in SIZE_CLASSES])
"""(size classes,) whether the box of an object contains a person's limbs."""

# from the image border within which a box counts as cut: boxes of detectors end up to 1 px inside
BORDER_PX = 1.5


# distance within which two edges abut: px, plus a fraction of the height
_ABUTS_PX, _ABUTS_FRACTION = 2.0, 0.1


def have_hidden_sides(xyxy_px: FloatArray) -> BoolArray:
    """(N,) whether the left or right side of boxes (N, 4) of a frame lies in a nearer box, or abuts
    on one.

    Boxes that end lower in the image are nearer. Boxes that hide a side cover its lower half, where
    objects are widest.
    """
    left, top, right, bottom = xyxy_px.T
    abuts_px = _ABUTS_PX + _ABUTS_FRACTION * (bottom - top)
    sides_px = xyxy_px.T[::2]
    # (2, N, N) by side, box and other box
    hides = left < (sides_px + abuts_px)[:, :, None]
    hides &= right > (sides_px - abuts_px)[:, :, None]
    hides &= (bottom > bottom[:, None]) & (top < ((top + bottom) / 2)[:, None])
    return np.asarray(np.logical_or.reduce(hides, axis=(0, 2)))


@dataclass(frozen=True, slots=True)
class BoxNoise:
    """Noise of box edges: independent errors with a standard deviation of hypot(px, relative *
    size).

    The edges of a good detector (RRC on KITTI) have an error of half a pixel on small boxes, 1-2 %
    of the height of large vehicles, and 4 % of the height of people, whose limbs move and are
    labelled inconsistently.
    """

    px: float = 0.35
    relative: float = 0.01  # fraction of the box size for vehicles, lights and signs
    relative_person: float = 0.04  # fraction of the box size for people and two-wheelers
    # standard deviation of width and height, the same in all frames of an object
    systematic_px: float = 0.0

    def sigma_px(self, size_px: FloatArray, size_class: IntArray) -> FloatArray:
        """(N, 2) standard deviation of the edges of boxes, from their (N, 2) width and height in
        px.
        """
        fraction = np.where(_HAS_PERSON, self.relative_person, self.relative)[size_class]
        relative_px = fraction[:, None] * size_px
        return np.asarray(np.sqrt(self.px**2 + relative_px * relative_px))


_NETWORK_PX = 640.0  # width of the input of small networks


def detector_noise(width_px: int) -> BoxNoise:
    """Noise of the boxes of a small detector in images of this width, in proportion to the pixels
    of its input.

    Measured for YOLOv5n, YOLOX-nano, NanoDet, PicoDet and the packaged detectors on KITTI 0003,
    0005 and 2015.
    """
    scale = max(width_px / _NETWORK_PX, 1.0)
    return BoxNoise(px=0.36 * scale, systematic_px=0.77 * scale)


@dataclass(frozen=True, slots=True)
class BoxExtents:
    """N boxes of one frame, with image coordinates divided by the focal length."""

    wh_over_f: FloatArray  # (N, 2) width and height, positive
    bearing: FloatArray  # (N,) tangent of the angle between the middle column and the camera's axis
    bottom: FloatArray  # (N,) tangent of the angle of the bottom edge below the camera's axis
    size_class: IntArray  # (N,) index into `SIZE_CLASSES`
    uses_width: BoolArray  # (N,) False = a side is cut or hidden, the width is not used
    uses_bottom: BoolArray  # (N,) False = the bottom edge is not the contact point
    edge_sigma: FloatArray  # (N, 2) standard deviation of one edge, in x and in y
    # (N, 2) of log width and log height, the same in all frames of an object
    systematic_sigma: FloatArray
    # (N,) classes that the boxes may have instead, and their probabilities; None = no doubt
    doubt: tuple[IntArray, FloatArray] | None = None

    def __len__(self) -> int:
        return len(self.bearing)

    def select(self, rows: BoolArray | IntArray) -> BoxExtents:
        """The boxes selected by a mask or an index array."""
        *arrays, doubt = (getattr(self, field.name) for field in fields(self))
        if doubt is not None:
            doubt = doubt[0][rows], doubt[1][rows]
        return BoxExtents(*[*(array[rows] for array in arrays), doubt])

    @property
    def noise_variance(self) -> FloatArray:
        """(N, 2) variance of log width and log height by noise, each the difference of two
        independent edges.
        """
        return np.asarray(2.0 * (self.edge_sigma / self.wh_over_f) ** 2)


def box_error_table(errors: BoxErrors | None) -> FloatArray:
    """(size classes, 2, 2) means and standard deviations of the errors of log width and log height;
    None = unknown.

    A van has the errors of a car, which is what detectors report.
    """
    known = {**UNKNOWN_DETECTOR, **(errors or {})}
    table = np.array([known["car" if name == "van" else name] for name in SIZE_CLASSES])
    return table.reshape(-1, 2, 2).transpose(0, 2, 1)[:, :, ::-1]


_NO_ERRORS = box_error_table(NO_ERRORS)


@dataclass(frozen=True, slots=True)
class BoxTraits:
    """Errors of the boxes of a detector."""

    noise: BoxNoise
    errors: FloatArray  # (size classes, 2, 2) systematic ones, see `box_error_table`
    are_visible: bool  # whether boxes end where a nearer object begins

    @classmethod
    def of(
        cls,
        width_px: int,
        *,
        box_sigma_px: float | None = None,
        errors: BoxErrors | None = None,
        are_visible: bool = False,
    ) -> BoxTraits:
        """Those of a detector in images of this width, with the standard deviation `box_sigma_px` of
        all edges, None = typical of a detector. `errors` None = an unknown detector, or with
        `box_sigma_px` no such errors.
        """
        if box_sigma_px is None:
            return cls(detector_noise(width_px), box_error_table(errors), are_visible)
        table = _NO_ERRORS if errors is None else box_error_table(errors)
        return cls(BoxNoise(box_sigma_px, 0.0, 0.0), table, are_visible)


def measured_boxes(
    xyxy_px: FloatArray,
    size_class: IntArray,
    *,
    camera: PinholeCamera,
    noise: BoxNoise,
    errors: FloatArray = _NO_ERRORS,
    uses_width_bottom: tuple[BoolArray, BoolArray] | None = None,
    doubt: tuple[IntArray, FloatArray] | None = None,
) -> BoxExtents:
    """Boxes (N, 4) of positive size, in px of `camera` (undistorted), in camera-independent units.

    `errors` is a `box_error_table`. Its means are corrected about the centre of the box, since both
    edges of the measured detectors are wrong: the contact point moves by half of the error of the
    height. `uses_width_bottom` are `BoxExtents.uses_width` and `uses_bottom`, (N,) each; None =
    True for all boxes. `doubt` is `BoxExtents.doubt`.
    """
    focal_px = np.array([camera.fx_px, camera.fy_px])
    error = errors[size_class]
    low_px, high_px = xyxy_px[:, :2], xyxy_px[:, 2:]
    size_px = (high_px - low_px) * np.exp(-error[:, 0])
    # of the point at the bottom of the box, in its middle
    point_px = low_px + high_px
    point_px[:, 1] += size_px[:, 1]
    bearing, bottom = ((point_px / 2 - (camera.cx_px, camera.cy_px)) / focal_px).T
    uses_width, uses_bottom = uses_width_bottom or (
        np.ones(len(xyxy_px), np.bool_),
        np.ones(len(xyxy_px), np.bool_),
    )
    return BoxExtents(
        wh_over_f=size_px / focal_px,
        bearing=bearing,
        bottom=bottom,
        size_class=size_class,
        uses_width=uses_width,
        uses_bottom=uses_bottom,
        edge_sigma=noise.sigma_px(size_px, size_class) / focal_px,
        systematic_sigma=np.hypot(error[:, 1], noise.systematic_px / size_px),
        doubt=doubt,
    )


class SizeRanges(NamedTuple):
    """Distances by size, (N,) each; NaN = the class has no size model."""

    distance_m: FloatArray  # z of the visible surface
    sigma_m: FloatArray  # standard deviation of `distance_m`
    # constant over a track (the size of the object); the rest is box noise
    sigma_systematic_m: FloatArray


class SizeModel(Protocol):
    """Model of object sizes: curves, or priors over cuboids."""

    def measure(self, boxes: BoxExtents, drive: DriveState | None = None) -> SizeRanges:
        """Distances of the boxes of one frame; `drive` has started it for their tracks
        (`DriveState.start_frame`).
        """
        ...


class StoredSizeModel(SizeModel, Protocol):
    """Size model that can be written to a curve file (`curve.save_curves`)."""

    def document(self) -> dict[str, Any]:
        """Content of the curve file: "kind" and the parameters of the model, as JSON values."""
        ...


def _by_class(values: dict[str, float]) -> FloatArray:
    """(size classes,) the values, 0 for classes without a value."""
    return np.array([values.get(name, 0.0) for name in SIZE_CLASSES])


# offsets in m for boxes with an aspect ratio up to 1.5 (rear view), medians over KITTI's labels
_NARROW_M = _by_class(
    {
        "person": 0.05,
        "bicycle": 0.15,
        "motorcycle": 0.15,
        "car": 0.03,
        "van": 0.03,
        "truck": 0.03,
        "bus": 0.03,
    }
)
_WIDE_M = _by_class(  # the same for boxes with an aspect ratio of 2.2 or more (side view)
    {
        "person": 0.05,
        "bicycle": 0.3,
        "motorcycle": 0.3,
        "car": 0.45,
        "van": 0.55,
        "truck": 1.5,
        "bus": 1.5,
    }
)
_DIFFERENCE_M = _WIDE_M - _NARROW_M


# tyres' contact behind the bumper, m: overhangs are 0.7 to 0.9 m
_OVERHANG_M = _by_class({"car": 0.6, "van": 0.6})


def surface_offset_m(
    xyxy_px: FloatArray, class_id: IntArray, *, has_visible_boxes: bool = False
) -> FloatArray:
    """(N,) depth in m of the visible surface behind the contact point, for boxes (N, 4) of size
    classes (N,).

    The bottom edge of a box belongs to the object's nearest point on the ground; `distance_m` is
    where the ray through the box centre meets the object. Both are the same for an object seen from
    behind. Seen from a corner or the side, the nearest point is the corner, and the surface is
    farther.

    Linear in the aspect ratio between rear and side views. The visible boxes of a detector end at
    the tyres of a car, in a rear view behind its bumper; labels that are projections of 3-D boxes
    end where the bumper is above the road.
    """
    size_px = xyxy_px[:, 2:] - xyxy_px[:, :2]
    aspect = size_px[:, 0] / np.maximum(size_px[:, 1], 1.0)
    # 0 for rear views to 1 for side views
    wide = np.minimum(np.maximum((aspect - 1.5) / 0.7, 0.0), 1.0)
    offset_m = _NARROW_M[class_id] + wide * _DIFFERENCE_M[class_id]
    return np.asarray(
        offset_m - (1.0 - wide) * _OVERHANG_M[class_id] if has_visible_boxes else offset_m
    )
