r"""CuboidEstimator: sizes, heading and centre of the tracks, from boxes, distances and course.

One filter per track (Rao-Blackwellised, Murphy, NIPS 1999): its yaw is on a grid of directions
fixed to the world, and given each direction, the log sizes and the error of the distance are
Gaussian:

    p(yaw, x) = sum_k w_k [f_k | b_k] N(x; x_k, P_k)      x = (log h, log w, log l, s)
                                                          f, b: probabilities of front and back

The cuboid of (yaw_k, x_k), whose surface is at the distance d e^s on the ray through the box, has a
box (`box_of_cuboid`). Its width, with derivatives (H_w, H_l) and -(H_w + H_l) by s, since sizes and
distance scale alike, is compared with the measured one, also in w_k:

    nu = log width - offset - log width(yaw_k, x_k)       S = H P H' + R       w_k *= N(nu; 0, S)

Two visible sides and the change of the width while the view changes so measure yaw, width and
length. Where a side is cut or hidden, the box only shows that the object is at least as wide:

    w_k *= Phi(-nu / S^1/2)^(1/n),    and x_k moves only where nu > 0
                                      n: number of frames with the same errors

s has the variance of the distance, of shapes that are no cuboids, and of the yaw within a step of
the grid; it is one error of all frames with the same view, and decays with the change of bearing
and distance:

    s' = a s,    a = exp(-|change of bearing| / b - |change of log d| / c)

The height is that of the box at the distance, whose information beyond that of the mean size of the
class, 1 / sigma_d^2 - 1 / sigma_h^2, is not from the height itself. It counts once per view, too.

The velocity over ground v, of covariance V, points along the yaw, unless the object is at rest:

    L(yaw) = r + (1 - r) 2 Phi(m / sigma_m) N(v; 0, V + f^2 a a') / N(v; 0, V)

where a is the direction of the yaw, m the speed along a, and f that of free traffic. So there is no
threshold of speed, and the heading stays when an object stops. The yaw of moving objects is a random
walk, in which the moments of x are mixed between neighbours (IMM; Blom and Bar-Shalom, IEEE TAC
1988).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.lateral_motion import sides_cut
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.class_sizes import ClassSizes
from track_range.ranging.size_models.cuboid import CuboidBox, box_of_cuboid
from track_range.ranging.size_models.prior import YAW_DEG
from track_range.ranging.size_models.size_model import (
    BORDER_PX,
    BoxExtents,
    BoxTraits,
    have_hidden_sides,
    measured_boxes,
)
from track_range.ranging.world.cuboids import Cuboids, wrapped_deg
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import GroundVelocity
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting
from track_range.tracking.tracks import Tracks

# directions of the long axis, in the world, counterclockwise
_N_YAWS = 36
_STEP_RAD = math.pi / _N_YAWS
_AXIS_RAD = np.linspace(0.0, math.pi, _N_YAWS, endpoint=False)[:, None]
# half the window, in steps, within which the directions around the best one are averaged
_WINDOW = 6
# of the class, part of the prior of directions that is any direction
_ANY_DIRECTION = 0.1
_N_STEPS = 3  # iterations for the position of a cuboid
_LOG_STEP = 0.02  # of the derivatives by log sizes
_SIZES, _S = slice(0, 3), 3  # rows of the state: log height, width, length; s

# b in rad and c, over which shape and distance have other errors; on KITTI
_VIEW_RAD, _VIEW_LOG_M = 0.3, 1.0
_SHAPE_SIGMA = (
    0.05  # of the width of boxes by shapes that are no cuboids, between cameras and labels
)
_SIZE_FLOOR = 0.03  # smallest relative sigma of a size, by the definition of its ends
_MAX_SIZE_SIGMA = 2.5  # largest difference of a log size from the mean of the class
_MAX_NU = 2.0  # in sigma, of a width that counts in full
_MAX_CHI2 = 16.0  # largest squared innovation in sigma that counts against a direction
# over which errors of the edges, and of the course, are the same
_EDGES_S, _COURSE_S = 1.0, 0.4
_FIRST_COURSE = 0.3  # weight of the course of a new track
_LEAST = 1e-6  # smallest new part of an error, against a division by zero
_LEAST_S = 1e-3  # shortest time between two frames
# random walk of the yaw of moving objects, per square root of a second; a turn on a junction
_TURN_RAD = math.radians(10.0)
_FAST_MPS = 8.0  # speed above which turns are limited by the acceleration to the side
_LOST = 1e-3  # probability per second that the yaw is any other
_REST = 0.5  # r
_FREE_MPS = np.where(np.array(ROAD_CLASSES) == "person", 1.5, 8.0)  # (classes,) f
# of a velocity from the direction of the yaw: constant, and relative to the speed
_SLIP_MPS, _SLIP = 0.2, 0.03
_BACKWARDS = 0.02  # probability that a moving object goes backwards
_ANY_FRONT = 0.1  # difference of the probability of a front from 1/2 that tells nothing
_KNOWN_FRONT = 0.95  # probability from which front and back are told apart
_YAW_FLOOR_RAD = math.radians(2.0)  # of the axes of cameras and labels
# people and riders do not fill their boxes, and move their limbs
_IS_RIGID = np.isin(ROAD_CLASSES, ("car", "truck", "bus"))
_ONE_SIDE = np.where(_IS_RIGID, 0.02, 0.1)  # of the middle of a box, relative to the width
_USUAL_HEIGHT_M = 1.5  # of a camera above the road
_MAX_GAP_S = 10.0  # after which a track that comes back is a new one

_INDEX = np.arange(_N_YAWS)[:, None]
# of each direction of the whole circle, the ones before and after it
_AFTER = np.arange(1, 2 * _N_YAWS + 1) % (2 * _N_YAWS)
_BEFORE = np.arange(-1, 2 * _N_YAWS - 1) % (2 * _N_YAWS)
_NEAR = np.abs((_INDEX - _INDEX.T + _N_YAWS // 2) % _N_YAWS - _N_YAWS // 2) <= 2
_STEPS = _LOG_STEP * np.array([[0, 0, 0], [0, 1, 0], [0, 0, 1]])[:, :, None, None]


class _View(NamedTuple):
    """How N tracks are seen in one frame, (N,) each: the rows of `TrackState`; NaN = new track."""

    class_id: FloatArray
    time_s: FloatArray
    bearing_rad: FloatArray
    log_m: FloatArray  # of the distance


class _Seen(NamedTuple):
    """What one frame shows of N tracks whose distances are known."""

    tracks: Tracks
    boxes: BoxExtents
    view: _View
    before: _View  # of the last frame
    log_sigma: FloatArray  # (N,) of the log of the distance
    velocity: GroundVelocity
    yaw_rad: FloatArray  # (K, 1) of the directions of the grid, in the camera's axes
    drive_rad: float  # direction of the axis from that of the drive, positive = to the left
    is_cut: BoolArray  # (2, N) whether the border of the image cuts the left, the right side
    is_part: BoolArray  # (N,) whether a side is cut or hidden
    ends_cut: BoolArray  # (2, N) whether the border cuts the top, the bottom

    @property
    def class_id(self) -> IntArray:
        """(N,) road classes."""
        return self.tracks.class_id

    @property
    def dt(self) -> FloatArray:
        """(N,) time since the last frame, at least a short one; NaN = new track."""
        return np.maximum(self.view.time_s - self.before.time_s, _LEAST_S)

    @property
    def same(self) -> FloatArray:
        """(N,) a: how much of the errors of the view is that of the last frame; NaN = new track."""
        change = np.abs(self.view.bearing_rad - self.before.bearing_rad) / _VIEW_RAD
        return np.exp(-change - np.abs(self.view.log_m - self.before.log_m) / _VIEW_LOG_M)

    def repeats(self, lasts_s: float) -> FloatArray:
        """(N,) number of frames that have the same error, which lasts for this time."""
        return np.fmax(lasts_s / self.dt, 1.0)


class _Cells(NamedTuple):
    """The filters of N tracks, by direction (K) of the long axis."""

    weight: FloatArray  # (2, K, N) with the front along the direction, and against it
    table: FloatArray  # (4, 5, K, N) [P x] of (log h, log w, log l, s)

    def corrected(self, row: FloatArray, nu: FloatArray, gain: FloatArray) -> _Cells:
        """The filters after innovations nu (K, N) with the weight 1 / S, 0 = not measured, whose
        covariances with the state are the first four of `row` (5, K, N).
        """
        row[4] = -nu
        return self._replace(table=self.table - row[:4, None] * row * gain)


class CuboidEstimator:
    """Estimates the cuboids of the tracks of a drive, frame by frame."""

    def __init__(
        self,
        mounting: Mounting | None = None,
        sizes: ClassSizes | None = None,
        traits: BoxTraits | None = None,
    ) -> None:
        """`mounting` is that of the view, `sizes` those of the classes, `traits` of the detector's
        boxes; None = unknown.
        """
        self._mounting, self._traits = mounting, traits
        self._sizes = ClassSizes.of(None) if sizes is None else sizes
        self._drive_rad = 0.0 if mounting is None else math.radians(mounting.yaw_deg)
        height_m = None if mounting is None else mounting.z_m
        self._height_m = _USUAL_HEIGHT_M if height_m is None else height_m
        self._cells = TrackState(np.full((22, _N_YAWS), np.nan))
        self._views = TrackState(np.full(len(_View._fields), np.nan))
        self._directions = _direction_prior(self._sizes.turn_weights)

    def update(
        self,
        tracks: Tracks,
        camera: PinholeCamera,
        distance: Ranges,
        velocity: GroundVelocity,
        pose: EgoPose,
        time_s: float,
    ) -> Cuboids:
        """The cuboids of N tracks at the filtered `distance`, with their `velocity` over ground in
        the camera's axes; `pose` is that of the camera.
        """
        is_known = np.isfinite(distance.distance_m + distance.sigma_m)
        is_known &= np.isfinite(self._sizes.log_hwl[tracks.class_id, 0])
        rows = is_known.nonzero()[0]
        if not len(rows):
            return Cuboids.unknown(len(tracks))
        heading_rad = 0.0 if math.isnan(pose.heading_rad) else pose.heading_rad
        seen = self._seen(tracks, rows, camera, distance, velocity, time_s)
        seen = seen._replace(yaw_rad=_AXIS_RAD - heading_rad)
        cells = self._predicted(seen)
        box = self._projected(cells, seen)
        cells = self._by_size(cells, seen, box)
        cells = _by_course(cells, seen)
        track_id = seen.tracks.track_id
        is_recent = time_s - self._views.known[1] <= _MAX_GAP_S
        self._views.put(track_id, np.array(seen.view), keep_known=is_recent)
        columns = np.concatenate([cells.weight, cells.table.reshape(20, *cells.table.shape[2:])])
        self._cells.put(track_id, columns, keep_known=is_recent)
        cuboids = _estimated(cells, seen, box)
        cuboids = cuboids if len(rows) == len(tracks) else cuboids.in_rows(rows, len(tracks))
        return replace(
            cuboids,
            vehicle_m=cuboids.in_vehicle(self._mounting).centre_m,
            world_m=cuboids.in_world(pose, self._mounting).centre_m,
        )

    def _seen(
        self,
        tracks: Tracks,
        rows: IntArray,
        camera: PinholeCamera,
        distance: Ranges,
        velocity: GroundVelocity,
        time_s: float,
    ) -> _Seen:
        """What the frame shows of the tracks `rows`."""
        traits = self._traits or BoxTraits.of(camera.width_px)
        is_cut = sides_cut(tracks, camera)
        is_part: BoolArray = np.logical_or(*is_cut)
        if traits.are_visible:
            is_part = is_part | have_hidden_sides(tracks.xyxy_px)
        seen = tracks.select(rows)
        boxes = measured_boxes(
            seen.xyxy_px, seen.class_id, camera=camera, noise=traits.noise, errors=traits.errors
        )
        top_px, bottom_px = seen.xyxy_px.T[1::2]
        distance_m = distance.distance_m[rows]
        view = _View(
            seen.class_id.astype(np.float64),
            np.full(len(rows), time_s),
            np.arctan(boxes.bearing),
            np.log(distance_m),
        )
        return _Seen(
            seen,
            boxes,
            view,
            _View(*self._views.get(seen.track_id)),
            distance.sigma_m[rows] / distance_m,
            GroundVelocity(*(column[rows] for column in velocity)),
            _AXIS_RAD,
            self._drive_rad,
            is_cut[:, rows],
            is_part[rows],
            np.array([top_px < BORDER_PX, bottom_px > camera.height_px - 1 - BORDER_PX]),
        )

    def _predicted(self, seen: _Seen) -> _Cells:
        """The filters before the measurements of the frame: new ones, and those of before."""
        before = self._cells.get(seen.tracks.track_id)
        cells = _Cells(before[:2], before[2:].reshape(4, 5, _N_YAWS, -1))
        cells = _turned(cells, seen)
        table = cells.table
        own = self._own_variance(seen)
        a = seen.same
        table[_S] *= a
        table[:, _S] *= a
        table[_S, _S] += (1 - a * a) * own
        is_new = ~(seen.before.class_id == seen.class_id)  # also with another class
        if not is_new.any():
            return cells
        first = self._first(seen, own)
        table = np.where(is_new, first.table, table)
        weight = np.where(np.isnan(seen.before.time_s), first.weight, cells.weight)
        return _Cells(weight, table)

    def _own_variance(self, seen: _Seen) -> FloatArray:
        """(K, N) variance of s."""
        shape = self._sizes.scatter[seen.class_id, 1] ** 2 + _SHAPE_SIGMA**2
        own = seen.log_sigma**2 + seen.boxes.systematic_sigma[:, 0] ** 2 + shape
        # The yaw of a direction is within half a step, which changes the width of long objects.
        _, width_m, length_m = np.exp(self._sizes.log_hwl[seen.class_id]).T
        view_rad = seen.yaw_rad + seen.view.bearing_rad
        end_m, side_m = width_m * np.cos(view_rad), length_m * np.sin(view_rad)
        turned_m = np.abs(length_m * np.cos(view_rad)) - np.abs(width_m * np.sin(view_rad))
        by_yaw = turned_m / (np.abs(end_m) + np.abs(side_m))
        return np.asarray(own + by_yaw**2 * (_STEP_RAD**2 / 12))

    def _first(self, seen: _Seen, own: FloatArray) -> _Cells:
        """The filters of new tracks: directions and sizes of the class. A distance by size is too
        small by the error of the size, by which s follows the height.
        """
        covariance = self._sizes.covariance[seen.class_id].transpose(1, 2, 0)
        table = np.zeros((4, 5, *own.shape))
        table[:3, :3] = covariance[:, :, None]
        by_size = np.minimum(seen.log_sigma**2 / covariance[0, 0], 1.0)
        table[_S, :3] = table[:3, _S] = table[0, :3] * by_size
        table[_S, _S] = np.maximum(own, table[_S, 0] * by_size)
        table[:3, 4] = self._sizes.log_hwl[seen.class_id].T[:, None]
        angle_deg = np.degrees(seen.yaw_rad + seen.drive_rad)
        column = np.rint(angle_deg).astype(np.int64) % 180
        return _Cells(self._directions[seen.class_id, column] / 2, table)

    def _projected(self, cells: _Cells, seen: _Seen) -> CuboidBox:
        """The boxes (3, K, N) of the filters, and of those with another width and length."""
        boxes, (at_left, at_right) = seen.boxes, seen.is_cut
        half = boxes.wh_over_f[:, 0] / 2
        # of a box that is cut at one side, the other edge has its place
        side = np.where(at_left, 1.0, np.where(at_right, -1.0, 0.0)) * (at_left != at_right)
        return box_of_cuboid(
            cells.table[:3, None, 4] + _STEPS,
            yaw_rad=-seen.yaw_rad,
            bearing=boxes.bearing,
            distance_m=np.exp(seen.view.log_m + cells.table[_S, 4]),
            camera_height_m=self._height_m,
            anchor=(boxes.bearing + side * half, (1.0 + side) / 2),
            n_steps=_N_STEPS,
        )

    def _by_size(self, cells: _Cells, seen: _Seen, box: CuboidBox) -> _Cells:
        """The filters after the width and the height of the boxes."""
        boxes, sizes, class_id = seen.boxes, self._sizes, seen.class_id
        log_width, log_height = np.log(np.maximum(boxes.wh_over_f, 1e-9)).T
        same_edges, is_seen = seen.repeats(_EDGES_S), seen.tracks.observed

        # Width; z = log w + s along the line of sight.
        H_w, H_l = (box.log_width[1:] - box.log_width[0]) / _LOG_STEP
        H_s = -(H_w + H_l)
        nu = log_width - sizes.offset[class_id, 1] - box.log_width[0]
        row = H_w * cells.table[1] + H_l * cells.table[2] + H_s * cells.table[_S]
        S = H_w * row[1] + H_l * row[2] + H_s * row[_S] + boxes.noise_variance[:, 0] * same_edges
        counts = is_seen & _IS_RIGID[class_id]
        chi2 = nu * nu / S
        moves = counts & (~seen.is_part | (nu > 0))
        gain = np.where(moves, 1.0 / (S * np.maximum(chi2 / _MAX_NU**2, 1.0)), 0.0)
        exactly = (np.minimum(chi2, _MAX_CHI2) + np.log(S)) / -2
        at_least = np.maximum(log_ndtr(-nu / np.sqrt(S)), _MAX_CHI2 / -2) / same_edges
        log_likelihood = counts * np.where(seen.is_part, at_least, exactly)
        corrected = cells.corrected(row, nu, gain)

        # Height, with the information of the distance that is not from the size.
        class_variance = sizes.covariance[class_id, 0, 0]
        other = 1.0 / np.maximum(seen.log_sigma**-2 - 1.0 / class_variance, 1e-9)
        other = other + sizes.scatter[class_id, 0] ** 2
        other = other / np.fmin(1.0 - seen.same**2 + _LEAST, 1.0)  # all of it is new at first
        nu = log_height - sizes.offset[class_id, 0] - box.log_height[0] - cells.table[_S, 4]
        is_high = is_seen & ~np.logical_or(*seen.ends_cut)
        row = corrected.table[0].copy()
        S = row[0] + other + boxes.noise_variance[:, 1] * same_edges
        cells = corrected.corrected(row, nu, np.where(is_high, 1.0 / S, 0.0))

        usual = sizes.log_hwl[class_id].T[:, None]
        limit = _MAX_SIZE_SIGMA * np.sqrt(np.diagonal(sizes.covariance[class_id], 0, 1, 2)).T
        x = cells.table[:3, 4]
        np.clip(x, usual - limit[:, None], usual + limit[:, None], out=x)
        return cells._replace(weight=_weighted(cells.weight, log_likelihood))


def _direction_prior(turn_weights: FloatArray) -> FloatArray:
    """(C, 180) probability that the long axis of an object is within half a step from this angle in
    degrees to the drive.
    """
    ends_deg = np.concatenate([[0.0], (YAW_DEG[1:] + YAW_DEG[:-1]) / 2, [90.0]])
    ends_deg = np.concatenate([ends_deg, 180 - ends_deg[-2::-1]])
    both = np.concatenate([turn_weights, turn_weights[:, ::-1]], axis=1) / 2
    density = both / np.diff(ends_deg)
    fine_deg = (np.arange(1800) + 0.5) / 10
    fine = density[:, np.searchsorted(ends_deg, fine_deg) - 1]
    half = round(10 * 180 / _N_YAWS / 2)
    around = (10 * np.arange(180)[:, None] + np.arange(-half, half)) % 1800
    by_angle = fine[:, around].mean(axis=2) * (180 / _N_YAWS)
    return np.asarray((1 - _ANY_DIRECTION) * by_angle + _ANY_DIRECTION / _N_YAWS)


def _weighted(weight: FloatArray, log_likelihood: FloatArray) -> FloatArray:
    """Weights (2, K, N) times a likelihood (K, N) or (2, K, N); they sum to 1."""
    log_likelihood = log_likelihood - log_likelihood.max(axis=(-3, -2)[-log_likelihood.ndim + 1 :])
    weight = weight * np.exp(log_likelihood)
    return np.asarray(weight / weight.sum(axis=(0, 1)))


def _turned(cells: _Cells, seen: _Seen) -> _Cells:
    """The filters after the turns of objects that move."""
    v = seen.velocity
    speed2 = v.along_mps**2 + v.right_mps**2
    moving = speed2 / (speed2 + v.along_variance + v.right_variance + 1.0)
    moving /= 1.0 + speed2 / _FAST_MPS**2
    dt = np.fmax(seen.dt, 0.0)  # 0 of a new track
    p = np.fmax(np.minimum(moving * dt * (_TURN_RAD / _STEP_RAD) ** 2 / 2, 1 / 3), 0.0)
    lost = _LOST * dt
    weight = (1 - lost) * cells.weight + lost / (2 * _N_YAWS)
    ring = weight.reshape(2 * _N_YAWS, -1)  # the second half of the circle is the backs
    ring = (1 - 2 * p) * ring + p * (ring[_BEFORE] + ring[_AFTER])
    turned = cells._replace(weight=ring.reshape(weight.shape))
    if not (p > 0).any():
        return turned

    # What is known of the sizes turns with the object: the moments of the mixtures.
    g, total = weight.sum(axis=0), turned.weight.sum(axis=0)
    x = cells.table[:, 4]
    moments = cells.table.copy()
    moments[:, :4] += x[:, None] * x
    mixed = ((1 - 2 * p) * g / total) * moments
    for other in (_BEFORE[:_N_YAWS] % _N_YAWS, _AFTER[:_N_YAWS] % _N_YAWS):
        mixed += (p * g[other] / total) * moments[:, :, other]
    x = mixed[:, 4]
    mixed[:, :4] -= x[:, None] * x
    return turned._replace(table=mixed)


def _by_course(cells: _Cells, seen: _Seen) -> _Cells:
    """The filters after the velocities over ground."""
    v, yaw_rad = seen.velocity, seen.yaw_rad
    is_known = np.isfinite(v.along_mps + v.right_mps + v.along_variance + v.right_variance)
    along, right, A, B = (np.where(is_known, part, 1.0) for part in v)
    slip2 = _SLIP_MPS**2 + _SLIP**2 * (along**2 + right**2)
    A, B, f2 = A + slip2, B + slip2, _FREE_MPS[seen.class_id] ** 2
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    information = cos**2 / A + sin**2 / B
    aVv = cos * (along / A) - sin * (right / B)
    variance = f2 / (1 + f2 * information)
    m = aVv * variance
    log_ratio = (aVv * m - np.log(1 + f2 * information)) / 2
    ahead = ndtr(m / np.sqrt(variance))
    sense = _BACKWARDS + (1 - 2 * _BACKWARDS) * np.array([ahead, 1 - ahead])
    log_moving = math.log(1 - _REST) + log_ratio + np.log(2 * sense)
    log_likelihood = np.logaddexp(math.log(_REST), log_moving)
    share = np.where(np.isnan(seen.before.time_s), _FIRST_COURSE, 1.0 / seen.repeats(_COURSE_S))
    return cells._replace(weight=_weighted(cells.weight, is_known * share * log_likelihood))


def _estimated(cells: _Cells, seen: _Seen, box: CuboidBox) -> Cuboids:
    """The cuboids by the moments of the filters, around the best direction."""
    g = cells.weight.sum(axis=0)
    best = (_NEAR.astype(np.float64) @ g).argmax(axis=0)
    steps = _INDEX - best
    nearest = (steps + _N_YAWS // 2) % _N_YAWS - _N_YAWS // 2
    local = g * (np.abs(nearest) <= _WINDOW)
    local /= local.sum(axis=0)

    # Yaw; front and back of directions beyond the ends of the grid are exchanged.
    mean_rad = (local * nearest).sum(axis=0) * _STEP_RAD
    apart_rad = (nearest * _STEP_RAD - mean_rad + math.pi / 2) % math.pi - math.pi / 2
    variance = (g * apart_rad**2).sum(axis=0) + _STEP_RAD**2 / 12 + _YAW_FLOOR_RAD**2
    front = np.where(nearest == steps, cells.weight[0], cells.weight[1]).sum(axis=0)
    yaw_rad = seen.yaw_rad[best, 0] + mean_rad
    is_along = np.cos(yaw_rad + seen.drive_rad) >= 0  # where nothing tells, along the drive
    ahead = np.where(np.abs(front - 0.5) > _ANY_FRONT, front > 0.5, is_along)
    yaw_rad = np.where(ahead, yaw_rad, yaw_rad + math.pi)

    # Sizes.
    x, P = cells.table[:3, 4], cells.table[_SIZES, _SIZES]
    mean = (local * x).sum(axis=1)
    spread = (x - mean[:, None]) ** 2 + np.diagonal(P).transpose(2, 0, 1)
    log_sigma = np.sqrt((g * spread).sum(axis=1) + _SIZE_FLOOR**2)
    hwl_m = np.exp(mean)
    centre_m, covariance_m2 = _centred(cells, seen, box, local, hwl_m, log_sigma)
    return Cuboids.of(
        lwh_m=hwl_m[::-1].T,
        lwh_sigma_m=(hwl_m * log_sigma)[::-1].T,
        yaw_deg=wrapped_deg(np.degrees(yaw_rad)),
        yaw_sigma_deg=np.degrees(np.sqrt(variance)),
        front_known=np.maximum(front, 1 - front) > _KNOWN_FRONT,
        centre_m=centre_m,
        covariance_m2=covariance_m2,
    )


def _centred(
    cells: _Cells,
    seen: _Seen,
    box: CuboidBox,
    local: FloatArray,
    hwl_m: FloatArray,
    log_sigma: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Centres (N, 3) and their covariances (N, 3, 3) in the camera's axes; `hwl_m` and `log_sigma`
    (3, N) are sizes.
    """
    boxes, g = seen.boxes, cells.weight.sum(axis=0)
    xz = np.array(box.xz_m)
    J = (xz[:, 1:] - xz[:, :1]) / _LOG_STEP  # by log width and log length
    J_s = xz[:, 0] - J.sum(axis=1)
    xz = xz[:, 0] - J_s * cells.table[_S, 4]  # at the distance d, not d e^s
    mean = (local * xz).sum(axis=1)
    apart = xz - mean[:, None]
    P = cells.table[1:3, 1:3]
    JP = J[:, 0, None] * P[0] + J[:, 1, None] * P[1]
    C = apart[:, None] * apart + JP[:, None, 0] * J[:, 0] + JP[:, None, 1] * J[:, 1]
    C = (g * C).sum(axis=2)

    # The bottom edge is that of the nearest edge on the road; if it is cut, the top edge counts.
    near_m = (local / box.inverse_depths[0][0]).sum(axis=0)
    sign = np.where(seen.ends_cut[1], -1.0, 1.0)
    end_m = (boxes.bottom - (sign < 0) * boxes.wh_over_f[:, 1]) * near_m
    y_m = end_m - sign * hwl_m[0] / 2
    by_log_m = np.array([*(local * J_s).sum(axis=1), end_m]) * seen.log_sigma
    x_s, z_s, y_s = by_log_m
    covariance = np.zeros((len(y_m), 3, 3))
    covariance[:, ::2, ::2] = C.transpose(2, 0, 1)
    of_distance = np.array([x_s, y_s, z_s]).T
    covariance += of_distance[:, :, None] * of_distance[:, None]
    edge_m = boxes.edge_sigma * np.exp(seen.view.log_m)[:, None]
    # limbs and mirrors are at one side
    covariance[:, 0, 0] += edge_m[:, 0] ** 2 / 2 + (_ONE_SIDE[seen.class_id] * hwl_m[1]) ** 2
    covariance[:, 1, 1] += edge_m[:, 1] ** 2 + (hwl_m[0] * log_sigma[0] / 2) ** 2
    return np.column_stack([mean[0], y_m, mean[1]]), covariance
