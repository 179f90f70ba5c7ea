r"""LateralMotion: lateral position and speed of tracks relative to the camera, with a Kalman filter
per track.

         o ---> u      The state is the lateral position x of the object's centre and its lateral speed u along the
        /              current x axis. The camera yaws with the rate w (positive = to the right) at the speed V along
    z  /               its axis and U to the right of it:
      / x                  x' = u - U - w z        u' = -w (z' + V)
     []                so that a static object has u = 0 in a bend and aside, too. Without w, it does not turn.

The measurement is the middle of the box's left and right edges, each at its depth: the near edge at
the distance d, the inner edge of an object beside the axis at up to d + L, since the box of a
parked car ends at its far corner:

    x_inner = b (d + L)      b: bearing of the inner edge (x / z), L: length of the class, at most so far that the
                             object keeps the smallest width of its class

A box that is truncated at the left or right image border is not a measurement: the bearing of its
visible part stays constant while the object passes, as on a collision course.

A camera that does not look along the drive sees the sides of vehicles, whose length is taken to be
parallel to the drive. Each edge b of the box belongs to one corner of a rectangle of the length and
width of the class, at (dx, dz) from its centre:

    x = max over the corners of (b (z + dz) - dx), left edge        x = min over the corners, right edge

at the depth z of the centre, in front of which the ray through the middle of the box enters the
rectangle at the distance d. x is the mean of both edges, or that of the edge that the border of the
image does not cut.

The boxes of a track that is not confirmed yet have no distance. They are remembered, and when the
track has a distance d with the rate v, they are filtered first, at the distances d + v (t_i - t).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.foundation.track_state import TrackState
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting, looks_ahead
from track_range.tracking.tracks import Tracks

# standard deviation of u for a new track: lateral speed of a runner, or of a car in town
_INITIAL_RATE_SIGMA_MPS = 5.0
# random walk of u in m/s per square root of a second, tuned on simulated drives
_ACCELERATION_NOISE = 0.7
# of a box centre: px, plus a fraction of the box width
_CENTRE_SIGMA_PX, _CENTRE_SIGMA_FRACTION = 1.0, 0.02
_GATE_SIGMA = 5.0  # gate in standard deviations of the innovation; measurements outside are ignored
# without a measurement inside the gate, or any, after which a filter restarts
_OUTSIDE_S, _MAX_GAP_S = 0.25, 1.0
# from the border of a box that it cuts: px, plus a fraction of its height
_BORDER_PX, _BORDER_FRACTION = 2.0, 0.1
# the same fraction until a box that was cut is whole again: of near vehicles that pass, detectors
# end boxes up to a third of the height before the border, which looks like a motion to the path
_STAYS_CUT_FRACTION = 0.4
# longest time for which the lateral speed from before a box was cut counts as current
_MAX_CUT_S = 0.3
# of the smallest width of its class; in a narrower box, a part of the object is hidden
_LEAST_WIDTH_FRACTION = 0.8
_SIZES_M = {  # typical length and smallest width of each class, m
    "person": (0.3, 0.4),
    "bicycle": (1.7, 0.4),
    "car": (4.2, 1.5),
    "motorcycle": (2.1, 0.5),
    "bus": (11.0, 2.3),
    "truck": (8.0, 2.0),
    "traffic light": (0.3, 0.2),
    "traffic sign": (0.1, 0.4),
}
LENGTH_M, _MIN_WIDTH_M = np.array([_SIZES_M[name] for name in ROAD_CLASSES]).T
TYPICAL_WIDTH_M = 1.2 * _MIN_WIDTH_M
# relative standard deviation of the half size of a vehicle, from the edge that is not cut to its
# middle
_HALF_SIGMA = 0.15


def sides_cut(
    tracks: Tracks, camera: PinholeCamera, fraction: float = _BORDER_FRACTION
) -> BoolArray:
    """(2, N) whether the left, and the right, image border cuts the boxes of the tracks, which end
    within a `fraction` of their height from it.
    """
    x1_px, y1_px, x2_px, y2_px = tracks.xyxy_px.T
    border_px = _BORDER_PX + fraction * (y2_px - y1_px)
    return np.array([x1_px <= border_px, x2_px >= camera.width_px - 1 - border_px])


@dataclass(frozen=True, slots=True)
class LateralMotion:
    """Lateral motion of N tracks relative to the camera."""

    state: ConstantVelocity  # x in m, positive = right, and u in m/s, (N,) each; NaN = unknown
    # (N,) half the width of the object, from its current box; NaN = unknown distance
    half_width_m: FloatArray
    # (N,) False = only extrapolated, since the left or right image border cuts the box
    is_current: BoolArray
    # (N,) whether one of these borders cuts the box now
    is_cut: BoolArray


class _LateralState(NamedTuple):
    """State of the filters of N tracks, (N,) each: the rows of `TrackState`, in this order; NaN =
    new track.
    """

    x: FloatArray
    u: FloatArray
    P_xx: FloatArray
    P_xu: FloatArray
    P_uu: FloatArray
    time_s: FloatArray  # of the state
    measured_s: FloatArray  # time of the last measurement
    cut_left: FloatArray  # 1 = the left border cut the last box
    cut_right: FloatArray


_KNOWN_ROW = _LateralState._fields.index("measured_s")


class _Unconfirmed(NamedTuple):
    """The boxes of a frame without a distance, and the motion of the camera up to it."""

    tracks: Tracks
    time_s: float
    yaw_rad_s: float
    right_mps: float


class LateralFilters:
    """Kalman filters of the lateral motion of all tracks of a video, relative to one camera.

    Example:
        >>> import numpy as np, track_range as tr
        >>> camera = tr.PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
        >>> tracks = tr.Tracks.empty()
        >>> tr.LateralFilters(camera).update(tracks, np.zeros(0), time_s=0.0).half_width_m.tolist()
        []
    """

    def __init__(self, camera: PinholeCamera, mounting: Mounting | None = None) -> None:
        """Start without tracks; boxes are in the pixels of `camera` (undistorted), which has a
        `mounting`; None = it looks along the drive.
        """
        self._camera = camera
        self._drive: tuple[float, float] | None = None  # its direction along x and z
        if mounting is not None and not looks_ahead(mounting):
            right, _, forward = mounting.velocity_mps(1.0).tolist()
            self._drive = right, forward
        self._mounting = mounting
        self._tracks = TrackState(np.full(len(_LateralState._fields), np.nan))
        self._unconfirmed: list[_Unconfirmed] = []  # frames of the last `_MAX_GAP_S`

    def last(self, track_id: IntArray) -> ConstantVelocity:
        """Lateral positions and speeds of the tracks (N,) in the last frame; NaN = unknown."""
        return ConstantVelocity(*_LateralState._make(self._tracks.get(track_id))[:5])

    def remember(
        self, unconfirmed: Tracks, time_s: float, *, yaw_rad_s: float, right_mps: float
    ) -> None:
        """Keep the boxes of a frame whose tracks are not confirmed yet, for `start`; the camera's
        motion is that of `update`.
        """
        self._unconfirmed = [
            seen for seen in self._unconfirmed if time_s - seen.time_s <= _MAX_GAP_S
        ]
        if len(unconfirmed):
            self._unconfirmed.append(_Unconfirmed(unconfirmed, time_s, yaw_rad_s, right_mps))

    def start(
        self,
        tracks: Tracks,
        distance: ConstantVelocity,
        time_s: float,
        *,
        own_mps: FloatArray | float = 0.0,
    ) -> None:
        """Start the filters of new tracks with the boxes from before they were confirmed, by the
        distances (N,) and their rates at `time_s`; `update` follows.

        An error of the rate is one of the lateral speed, in proportion to the bearing.
        """
        if not self._unconfirmed:
            return
        last = _LateralState._make(self._tracks.get(tracks.track_id))
        is_new = np.isnan(last.time_s) & np.isfinite(distance.v)
        if not is_new.any():
            return
        earlier = np.concatenate([seen.tracks.track_id for seen in self._unconfirmed])
        is_new &= np.isin(tracks.track_id, earlier)
        if not is_new.any():
            return
        new_ids = tracks.track_id[is_new]
        objects_mps = np.broadcast_to(own_mps, len(tracks))[is_new]
        now = ConstantVelocity(*(column[is_new] for column in distance.columns))
        replay = LateralFilters(self._camera, self._mounting)
        for seen in self._unconfirmed:
            _, boxes, rows = np.intersect1d(seen.tracks.track_id, new_ids, return_indices=True)
            if not len(rows):
                continue
            replay.update(
                seen.tracks.select(boxes),
                now.x[rows] + (seen.time_s - time_s) * now.v[rows],
                seen.time_s,
                distance_sigma_m=np.sqrt(now.P_xx[rows]),
                yaw_rad_s=seen.yaw_rad_s,
                own_mps=objects_mps[rows],
                right_mps=seen.right_mps,
            )
        state = _LateralState._make(replay._tracks.get(new_ids))
        rate_variance = (state.x / now.x) ** 2 * now.P_vv
        state = state._replace(P_uu=state.P_uu + rate_variance)
        n_known = self._tracks.known.shape[-1]
        self._tracks.put(new_ids, np.array(state), keep_known=np.ones(n_known, np.bool_))

    def update(
        self,
        tracks: Tracks,
        distance_m: FloatArray,
        time_s: float,
        *,
        distance_sigma_m: FloatArray | float = 0.0,
        yaw_rad_s: float = math.nan,
        own_mps: FloatArray | float = 0.0,
        right_mps: float = 0.0,
    ) -> LateralMotion:
        """Lateral motion of N tracks after the measurements of a frame, not earlier than the
        previous one.

        Predicted boxes and boxes truncated at the left or right border are not measured. The
        distances z (N,), NaN = unknown, have standard deviations of the errors that change from
        frame to frame. `yaw_rad_s` is the camera's yaw rate w, positive = to the right, NaN =
        unknown; `own_mps` (N,) the objects' own speed z' + V, 0 = unknown; `right_mps` the camera's
        speed U to the right of its axis, NaN = unknown.
        """
        last = _LateralState._make(self._tracks.get(tracks.track_id))
        was_cut = np.array([last.cut_left, last.cut_right]) > 0  # False for NaN
        is_cut = sides_cut(tracks, self._camera)
        is_cut |= was_cut & sides_cut(tracks, self._camera, _STAYS_CUT_FRACTION)
        x, sigma_m, half_width_m, is_whole = self._measured(tracks, distance_m, is_cut)
        R = sigma_m**2 + (x * distance_sigma_m / distance_m) ** 2
        valid = tracks.observed & is_whole & np.isfinite(x)

        since_s = time_s - last.measured_s
        is_stale = ~(since_s <= _MAX_GAP_S)
        dt = time_s - last.time_s
        state = ConstantVelocity(*last[:5]).predict(dt, q=_ACCELERATION_NOISE**2)
        turned = (yaw_rad_s if math.isfinite(yaw_rad_s) else 0.0) * dt
        moved_m = turned * np.where(np.isnan(distance_m), 0.0, distance_m)
        moved_m += (right_mps if math.isfinite(right_mps) else 0.0) * dt
        turned_mps = turned * own_mps
        turned_mps[np.isnan(turned_mps)] = 0.0
        state = ConstantVelocity(
            state.x - moved_m, state.v - turned_mps, state.P_xx, state.P_xv, state.P_vv
        )
        innovation = x - state.x
        is_in_gate = ~is_stale & (innovation**2 < _GATE_SIGMA**2 * (state.P_xx + R))
        is_measured = valid & is_in_gate
        starts = valid & ~is_in_gate & ~(since_s < _OUTSIDE_S)
        state = state.update(innovation, R, valid=is_measured)

        columns = np.array(state.columns)
        columns[:, is_stale] = np.nan
        if starts.any():
            zero = 0 * x
            initial = np.array([x, zero, R, zero, zero + _INITIAL_RATE_SIGMA_MPS**2])
            columns = np.where(starts, initial, columns)
        measured_s = np.where(is_measured | starts, time_s, last.measured_s)
        new = np.empty((len(_LateralState._fields), len(tracks)))
        new[:5], new[5], new[6], new[7:] = columns, time_s, measured_s, is_cut
        known_s = self._tracks.known[_KNOWN_ROW]
        self._tracks.put(tracks.track_id, new, keep_known=time_s - known_s <= _MAX_GAP_S)
        is_in_part = np.asarray(is_cut.any(axis=0))
        is_current = ~is_in_part | (time_s - measured_s <= _MAX_CUT_S)
        return LateralMotion(ConstantVelocity(*columns), half_width_m, is_current, is_in_part)

    def _measured(
        self, tracks: Tracks, distance_m: FloatArray, is_cut: BoolArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Lateral position of the centre, its standard deviation, half the width in m, and whether
        a box is whole, by the sides (2, N) at which it `is_cut`.
        """
        left_px, right_px = edges_px = tracks.xyxy_px[:, ::2].T
        left, right = (edges_px - self._camera.cx_px) / self._camera.fx_px
        d, L = distance_m, LENGTH_M[tracks.class_id]
        slack_m = np.maximum((right - left) * d - _MIN_WIDTH_M[tracks.class_id], 0.0)
        left_m = left * d + np.minimum(np.maximum(left, 0.0) * L, slack_m)
        right_m = right * d - np.minimum(np.maximum(-right, 0.0) * L, slack_m)
        sigma_m = (
            (_CENTRE_SIGMA_PX + _CENTRE_SIGMA_FRACTION * (right_px - left_px))
            * d
            / self._camera.fx_px
        )
        if self._drive is not None:
            x_m, half_m = _beside(left, right, d, tracks.class_id, is_cut, self._drive)
            sigma_m = np.hypot(sigma_m, _HALF_SIGMA * half_m * is_cut.any(axis=0))
            return x_m, sigma_m, half_m, np.asarray(~is_cut.all(axis=0))
        is_whole = ~is_cut.any(axis=0)
        is_whole &= (right - left) * d > _LEAST_WIDTH_FRACTION * _MIN_WIDTH_M[tracks.class_id]
        return (left_m + right_m) / 2, sigma_m, (right_m - left_m) / 2, is_whole


def _beside(
    left: FloatArray,
    right: FloatArray,
    d: FloatArray,
    class_id: IntArray,
    is_cut: BoolArray,
    drive: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """(N,) lateral positions of the centres, and half the widths in the image, of vehicles parallel
    to the `drive`, by the bearings of their left and right edges, of which some `is_cut` (2, N).
    """
    along_x, along_z = drive
    half_length, half_width = LENGTH_M[class_id] / 2, TYPICAL_WIDTH_M[class_id] / 2
    middle = (left + right) / 2
    with np.errstate(divide="ignore"):
        into_end = half_length / np.abs(middle * along_x + along_z)
        into_side = half_width / np.abs(middle * along_z - along_x)
    z = d + np.minimum(into_end, into_side)
    ends, sides = np.array([[1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0]])[..., None]
    dx = ends * half_length * along_x + sides * half_width * along_z
    dz = ends * half_length * along_z - sides * half_width * along_x
    from_left = (left * (z + dz) - dx).max(axis=0)
    from_right = (right * (z + dz) - dx).min(axis=0)
    x = np.where(
        is_cut[0], from_right, np.where(is_cut[1], from_left, (from_left + from_right) / 2)
    )
    return x, dx.max(axis=0)
