r"""RoadMotions: positions and speeds of tracks on the plane of the road, from their boxes, by one filter per track.

    state = (X, Y, X', Y', l, w, h)    middle of the footprint in m, its velocity, log sizes over those of the class

A box is the outline of the cuboid l x w x h that stands at (X, Y) and looks along its velocity:

    z = (x1, y1, x2, y2) = outline of the projected corners + edges' errors

so that the middle of the footprint does not move where the aspect changes: the lower edge of a box is the near side
of its object, which for a car seen from the front is 2 m before its middle, and from the side 1 m. Before the heading
is known, the footprint is a square of the same area, and the error of that is part of R. Edges at the border of the
image, or on a nearer box, are not used. Errors of edges last for some frames: R is multiplied by their number, so that
sigmas do not depend on the frame rate. Velocities are a random walk.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.size_models.size_model import BORDER_PX, BoxNoise
from track_range.ranging.world.object_motion import MOTION_STATES, ObjectMotion
from track_range.ranging.world.road_plane import RoadPlane
from track_range.tracking.tracks import Tracks

# length, width, height in m and the standard deviations of their logarithms, by class
_SIZES = {
    "person": ((0.5, 0.6, 1.72), (0.2, 0.2, 0.08)),
    "bicycle": ((1.75, 0.6, 1.72), (0.1, 0.2, 0.08)),
    "car": ((4.3, 1.8, 1.55), (0.11, 0.07, 0.12)),
    "motorcycle": ((2.1, 0.8, 1.6), (0.1, 0.2, 0.1)),
    "bus": ((11.5, 2.55, 3.1), (0.15, 0.05, 0.1)),
    "truck": ((8.5, 2.5, 3.2), (0.3, 0.07, 0.15)),
}
_SIZE_OF_CLASS = np.log([_SIZES.get(name, _SIZES["car"])[0] for name in ROAD_CLASSES])
_SPREAD_OF_CLASS = np.array([_SIZES.get(name, _SIZES["car"])[1] for name in ROAD_CLASSES])
_ON_ROAD = np.array([name in _SIZES for name in ROAD_CLASSES])
_N = 7
_PLACE, _VELOCITY, _SIZE = slice(0, 2), slice(2, 4), slice(4, 7)
# rows of the state of a track after its mean and covariance: time and heading
_TIME, _HEADING = _N + _N * _N, _N + _N * _N + 1

_START_MPS = 20.0  # standard deviation of a velocity before it is measured
# random walk of the velocity per root of a second, along and across a heading: drivers brake with
# 2 m/s2 for a second, and turn less
_WALK_MPS = 0.9
_NOISE_S = 0.15  # time for which errors of edges last
_BORDER_FRACTION = 0.015  # of a box that is taken to be cut, beside pixels
_SHAPE = 0.015  # error of the outline of a cuboid, as a fraction of the size of the box
_HEADING_MPS, _HEADING_SIGMAS = 0.8, 3.0  # smallest speed that shows a heading
_MAX_STEP_S = 2.0  # longest time without a box, after which a track starts again
_OTHER = 4.0  # standard deviations of two edges that belong to another object
_GATE = 3.0  # of an edge, in standard deviations; beyond, its weight falls
_PLANE_SIGMA = 0.01  # relative, of all lengths: roads are no planes, and lenses no pinholes
_FOOT_M = 0.25  # of the middle of a footprint by the overhang of bodies over their wheels
_MAX_SIGMA_MPS = 3.0  # largest standard deviation of a reported speed
_STANDS_MPS = 0.7  # speed below which an object stands, unless it moves by three sigmas
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
_STEPS = np.array([0.05, 0.05, 0.02, 0.02, 0.02])  # of derivatives by X, Y, l, w, h
_BOX_NOISE = BoxNoise(px=0.5)


@dataclass(frozen=True, slots=True)
class RoadStates:
    """Filtered states of N tracks; NaN = unknown."""

    mean: FloatArray  # (N, 7)
    covariance: FloatArray  # (N, 7, 7)

    def motion(self, plane: RoadPlane) -> ObjectMotion:
        """Speed, heading and place of the tracks, with the errors of the plane."""
        place, velocity = self.mean[:, _PLACE], self.mean[:, _VELOCITY]
        own = self.covariance[:, _VELOCITY, _VELOCITY]
        length = np.linalg.norm(velocity, axis=1)
        along = velocity / np.maximum(length, 1e-9)[:, None]
        noise = np.trace(own, axis1=1, axis2=2)
        across = noise - np.einsum("ni,nij,nj->n", along, own, along)
        # noise across a velocity makes it longer than the speed
        speed = np.sqrt(np.maximum(length**2 - across, 0.0))
        _, shared = plane.shared_covariance(place, velocity)
        variance = np.einsum("ni,nij,nj->n", along, own + shared, along)
        sigma = np.sqrt(variance + (_PLANE_SIGMA * speed) ** 2)
        # against a sigma of nothing at rest, where the length says little
        sigma = np.where(length < 2 * np.sqrt(noise), np.sqrt(noise + speed**2), sigma)
        heading_rad = np.arctan2(velocity[:, 1], velocity[:, 0])
        stands = (speed < _STANDS_MPS) & (speed < _HEADING_SIGMAS * sigma)
        axis = heading_rad - plane.theta[6]  # from the direction in which the camera looks
        codes = [MOTION_STATES.index(name) for name in ("moving", "oncoming", "crossing", "parked")]
        sides = [np.abs(np.sin(axis)) > math.sqrt(0.5), np.cos(axis) < 0]
        state = np.select([stands, *sides], [codes[3], codes[2], codes[1]], codes[0])
        is_known = np.isfinite(length) & (sigma <= _MAX_SIGMA_MPS)
        unknown = np.where(is_known, 0.0, np.nan)
        return ObjectMotion(
            speed_mps=speed + unknown,
            speed_sigma_mps=sigma + unknown,
            heading_deg=np.where(stands, np.nan, np.degrees(heading_rad)) + unknown,
            world_x_m=place[:, 0],
            world_y_m=place[:, 1],
            state=state + unknown,
            state_probability=unknown + np.nan,
        )


class RoadMotions:
    """Filters of all tracks of one camera that stands still."""

    def __init__(self, plane: RoadPlane) -> None:
        self.plane = plane
        self._tracks = TrackState(np.full(_HEADING + 1, np.nan))

    def update(self, tracks: Tracks, time_s: float) -> ObjectMotion:
        """Motion of the N tracks of a frame at `time_s`."""
        return self.states(tracks, time_s).motion(self.plane)

    def states(self, tracks: Tracks, time_s: float) -> RoadStates:
        """Filtered states of the N tracks of a frame at `time_s`."""
        columns = self._tracks.get(tracks.track_id).T.copy()
        n = len(columns)
        mean, covariance = columns[:, :_N], columns[:, _N:_TIME].reshape(n, _N, _N)
        step_s = time_s - columns[:, _TIME]
        mean, covariance = _predicted(mean, covariance, step_s)
        is_new = ~np.isfinite(mean[:, 0]) | ~(step_s <= _MAX_STEP_S)
        starts = self._starts(tracks)
        mean[is_new], covariance[is_new] = (part[is_new] for part in starts)
        heading = np.where(is_new, np.nan, columns[:, _HEADING])
        used = self._usable_edges(tracks) & np.isfinite(mean[:, :1])
        rows = np.flatnonzero(used[:, 3] | (used.sum(axis=1) >= 2))
        if len(rows):
            mean[rows], covariance[rows], is_other = self._corrected(
                mean[rows],
                covariance[rows],
                heading[rows],
                tracks.select(rows),
                used[rows],
                np.where(is_new, 1.0, step_s)[rows],
            )
            other = rows[is_other]  # the box of another object, by a change of identities
            mean[other], covariance[other] = (part[other] for part in starts)
            heading[other] = np.nan
        before, heading = heading, _headings(mean, covariance, heading)
        first = np.flatnonzero(np.isnan(before) & np.isfinite(heading))
        mean[first, _PLACE] += self._turned_m(mean[first], tracks.class_id[first], heading[first])
        seen_s = np.where(tracks.observed | is_new, time_s, columns[:, _TIME])
        seen_s = np.where(np.isfinite(mean[:, 0]), time_s, seen_s)
        columns = np.concatenate(
            [mean, covariance.reshape(n, -1), seen_s[:, None], heading[:, None]], axis=1
        )
        known_s = self._tracks.known[_TIME]
        self._tracks.put(tracks.track_id, columns.T, keep_known=time_s - known_s < _MAX_STEP_S)
        return RoadStates(mean, covariance)

    def _starts(self, tracks: Tracks) -> tuple[FloatArray, FloatArray]:
        """(N, 7) and (N, 7, 7) first states: the middle of the lower edge, moved back by half of the
        footprint; NaN above the horizon and for boxes that are predicted, or cut at the bottom.
        """
        boxes, class_id = tracks.xyxy_px, tracks.class_id
        feet = np.stack([(boxes[:, 0] + boxes[:, 2]) / 2, boxes[:, 3]], axis=1)
        place = self.plane.on_road_m(feet)
        away = place - self.plane.theta[[7, 8]]
        distance = np.linalg.norm(away, axis=1)[:, None]
        half = np.sqrt(np.exp(_SIZE_OF_CLASS[class_id][:, :2].sum(axis=1)))[:, None] / 2
        place = place + half * away / distance
        below = self.plane.on_road_m(feet + np.array([0.0, 3.0]))
        is_usable = self._usable_edges(tracks)[:, 3] & _ON_ROAD[class_id]
        place[~is_usable] = np.nan
        spread = np.linalg.norm(place - below, axis=1) + 1.5
        mean = np.concatenate([place, np.zeros((len(place), 5))], axis=1)
        variance = np.concatenate(
            [
                np.repeat(spread[:, None] ** 2, 2, axis=1),
                np.full((len(place), 2), _START_MPS**2),
                _SPREAD_OF_CLASS[class_id] ** 2,
            ],
            axis=1,
        )
        return mean, variance[:, :, None] * np.eye(_N)

    def _turned_m(self, mean: FloatArray, class_id: IntArray, heading: FloatArray) -> FloatArray:
        """(M, 2) moves of the middles of M footprints that are no longer squares, so that their near
        sides stay where they are.
        """
        away = mean[:, _PLACE] - self.plane.theta[[7, 8]]
        bearing = np.arctan2(away[:, 1], away[:, 0])
        length, width = np.exp(mean[:, 4:6] + _SIZE_OF_CLASS[class_id][:, :2]).T / 2
        square = np.sqrt(length * width) * (np.abs(np.cos(bearing)) + np.abs(np.sin(bearing)))
        turn = bearing - heading
        near = length * np.abs(np.cos(turn)) + width * np.abs(np.sin(turn))
        along = away / np.linalg.norm(away, axis=1)[:, None]
        return np.asarray((near - square)[:, None] * along)

    def _usable_edges(self, tracks: Tracks) -> BoolArray:
        """(N, 4) whether each edge of a box shows the object: it is observed, inside the image, and
        not on a nearer box.
        """
        boxes = tracks.xyxy_px
        width_px, height_px = self.plane.size_px
        size_px = boxes[:, 2:] - boxes[:, :2]
        margin = BORDER_PX + _BORDER_FRACTION * size_px.max(axis=1)
        # what the image cuts at a side or below shows other corners than those of the outline
        is_cut = (boxes[:, 0] < margin) | (boxes[:, 2] > width_px - 1 - margin)
        is_cut |= boxes[:, 3] > height_px - 1 - margin
        inside = np.repeat(~is_cut[:, None], 4, axis=1)
        inside[:, 1] &= boxes[:, 1] > margin
        middle = (boxes[:, :2] + boxes[:, 2:]) / 2
        x = np.stack([boxes[:, 0], middle[:, 0], boxes[:, 2], middle[:, 0]], axis=1)[:, :, None]
        y = np.stack([middle[:, 1], boxes[:, 1], middle[:, 1], boxes[:, 3]], axis=1)[:, :, None]
        x1, y1, x2, y2 = boxes.T
        within = (x > x1) & (x < x2) & (y > y1) & (y < y2)
        is_nearer = y2[None] > boxes[:, 3:]
        hidden = (within & is_nearer[:, None]).any(axis=2)
        return np.asarray(inside & ~hidden & tracks.observed[:, None])

    def _corrected(
        self,
        mean: FloatArray,
        covariance: FloatArray,
        heading: FloatArray,
        tracks: Tracks,
        used: BoolArray,
        step_s: FloatArray,
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        """States of M tracks after their boxes, and whether a box is that of another object, by
        two edges; `used` (M, 4) are the edges that count.
        """
        boxes, class_id = tracks.xyxy_px, tracks.class_id
        free = np.concatenate([mean[:, _PLACE], mean[:, _SIZE]], axis=1)
        moved = np.concatenate([free[None], free + np.diag(_STEPS)[:, None]])
        expected = self._outlines(moved, class_id, heading)
        H = np.zeros((len(mean), 4, _N))
        slopes = (expected[1:] - expected[0]) / _STEPS[:, None, None]
        H[:, :, [0, 1, 4, 5, 6]] = slopes.transpose(1, 2, 0)
        size_px = boxes[:, 2:] - boxes[:, :2]
        sigma = np.hypot(_BOX_NOISE.sigma_px(size_px, class_id), _SHAPE * size_px)
        n_same = np.maximum(2 * _NOISE_S / step_s, 1.0)  # frames with the same errors
        R = np.tile(sigma**2, 2) * n_same[:, None]
        # of a footprint whose direction is not known: its sides end up to a third of it elsewhere
        turned = np.isnan(heading)[:, None] & (_SIZE_OF_CLASS[class_id][:, :1] > 1.0)
        R += np.where(turned, (0.25 * size_px[:, :1]) ** 2, 0.0) * np.array([1.0, 0.3, 1.0, 0.3])
        residual = boxes - expected[0]
        is_used = used & np.isfinite(expected[0]) & np.isfinite(H).all(axis=2)
        residual, H = np.where(is_used, residual, 0.0), np.where(is_used[:, :, None], H, 0.0)
        S = H @ covariance @ H.transpose(0, 2, 1)
        spread = np.sqrt(np.diagonal(S, axis1=1, axis2=2) + R)
        is_other = np.sort(np.abs(residual) / spread, axis=1)[:, 2] > _OTHER
        is_other |= np.isnan(expected[0]).any(axis=1)  # it left, behind the camera
        R = R * np.maximum(np.abs(residual) / (_GATE * spread), 1.0) ** 2
        S = S + R[:, :, None] * np.eye(4)
        K = np.linalg.solve(S, H @ covariance).transpose(0, 2, 1)
        mean = mean + (K @ residual[:, :, None])[:, :, 0]
        covariance = covariance - K @ S @ K.transpose(0, 2, 1)
        return mean, (covariance + covariance.transpose(0, 2, 1)) / 2, is_other

    def _outlines(self, free: FloatArray, class_id: IntArray, heading: FloatArray) -> FloatArray:
        """(K, M, 4) boxes of the cuboids of (K, M, 5) places and log sizes over those of the class."""
        size = np.exp(free[:, :, 2:] + _SIZE_OF_CLASS[class_id])
        side = np.sqrt(size[:, :, 0] * size[:, :, 1])[:, :, None]
        is_turned = np.isfinite(heading)
        size[:, :, :2] = np.where(is_turned[:, None], size[:, :, :2], side)
        c, s = np.cos(np.nan_to_num(heading)), np.sin(np.nan_to_num(heading))
        corners = _CORNERS * size[:, :, None]  # (K, M, 8, 3)
        x, y = corners[:, :, :, 0], corners[:, :, :, 1]
        turned = [c[:, None] * x - s[:, None] * y, s[:, None] * x + c[:, None] * y]
        place = free[:, :, None, :2]
        world = np.stack(
            [turned[0] + place[..., 0], turned[1] + place[..., 1], corners[..., 2]], -1
        )
        pixels = self.plane.pixels(world.reshape(-1, 3)).reshape(*world.shape[:3], 2)
        return np.concatenate([pixels.min(axis=2), pixels.max(axis=2)], axis=2)


def _predicted(
    mean: FloatArray, covariance: FloatArray, step_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """States after steps (N,) with velocities that are a random walk."""
    n, dt = len(mean), step_s
    F = np.tile(np.eye(_N), (n, 1, 1))
    F[:, 0, 2] = F[:, 1, 3] = dt
    Q = np.zeros((n, _N, _N))
    q = _WALK_MPS**2
    for axis in (0, 1):
        Q[:, axis, axis] = q * dt**3 / 3
        Q[:, axis, axis + 2] = Q[:, axis + 2, axis] = q * dt**2 / 2
        Q[:, axis + 2, axis + 2] = q * dt
    mean = (F @ mean[:, :, None])[:, :, 0]
    return mean, F @ covariance @ F.transpose(0, 2, 1) + Q


def _headings(mean: FloatArray, covariance: FloatArray, before: FloatArray) -> FloatArray:
    """(N,) headings by velocities that are known well enough, else those before."""
    velocity = mean[:, _VELOCITY]
    speed = np.linalg.norm(velocity, axis=1)
    sigma = np.sqrt(np.trace(covariance[:, _VELOCITY, _VELOCITY], axis1=1, axis2=2) / 2)
    is_shown = (speed > _HEADING_MPS) & (speed > _HEADING_SIGMAS * sigma)
    return np.where(is_shown, np.arctan2(velocity[:, 1], velocity[:, 0]), before)
