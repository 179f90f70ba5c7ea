"""SafetyMeasures: surrogate measures of safety, with one definition each (sources:
docs/concepts/warnings.md).

    gap          g = d - f                     from the front of the ego vehicle, f ahead of the camera
    headway      g / V                         V: ego speed (the "time gap" of SAE J2944)
    TTC          g / c = (g / d) T              c: closing speed; time to collision of the front, T of the camera
    DRAC         c^2 / 2 g                     required deceleration of the ego vehicle
    MDRAC        c^2 / 2 (g - c T_r)           the same after the reaction time T_r
    TET, TIT     int [TTC < T*] dt, int (T* - TTC) dt over TTC < T*
    PET          time between the first one leaving and the second one reaching the place at which two paths cross

Headway and decelerations are given for road users on the ego path, whose width overlaps the ego
vehicle's width there. TTC is given for those that probably are, by the standard deviation of their
offset, and for those that will be there, with a probability of contact of at least one half.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.special import ndtr

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.warning.warnings import Warnings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.tracking.tracks import Tracks

TTC_LIMIT_S = 3.0  # T*, and T_r is `WarningSettings.reaction_s`: the defaults of SUMO's SSM device
# largest standard deviation of a TTC relative to it: the closing speed is two of its own. An error
# of the scale is none of the TTC, so that it needs no calibration.
_MAX_RELATIVE_SIGMA = 0.5
# smallest probability that a road user is on the path, or of a contact, of a TTC
_LIKELY = 0.5
_MIN_GAP_M = 0.1  # smallest gap of a deceleration
_LEAST_M = 1e-6  # standard deviation of an offset without one
_MIN_EGO_MPS = 0.5  # smallest ego speed of a headway
# smallest speed along the road of a lead: it does not come towards the ego vehicle
_MIN_OWN_MPS = -2.0
# width of a lane; standard deviation of the ego path from the middle of its lane
_LANE_M, _LANE_SIGMA_M = 3.5, 0.3
_USUAL = WarningSettings()  # of a usual car
_LANES = np.array([[-1.0], [0.0], [1.0]])
MAX_GAP_S = 1.0  # longest interruption of a track that counts for TET and TIT
# (road classes,) half the typical width, m
HALF_WIDTH_M = np.array([0.3, 0.3, 0.9, 0.4, 1.25, 1.25, 0.0, 0.0])
_IS_ROAD_USER = HALF_WIDTH_M > 0
_IS_VEHICLE = _IS_ROAD_USER & (np.array(ROAD_CLASSES) != "person")


def apart_m(
    path_offset_m: FloatArray, class_id: IntArray, settings: WarningSettings | None = None
) -> FloatArray:
    """(N,) distance between the edges of objects and of the ego path, negative = on the path, NaN =
    unknown.
    """
    ego_width_m = (settings or _USUAL).ego_width_m
    return np.asarray(np.abs(path_offset_m) - ego_width_m / 2 - HALF_WIDTH_M[class_id])


@dataclass(frozen=True, slots=True)
class SafetyMeasures:
    """Measures of N tracks of one frame, (N,) each; NaN = unknown, or not on the path.

    Attributes:
        gap_m: distance from the front of the ego vehicle, at least 0, of all tracks.
        ttc_front_s: TTC of road users where its sigma is at most half of it.
        headway_s: gap over ego speed.
        drac_mps2: deceleration that avoids a contact.
        mdrac_mps2: the same after the reaction time.
        tet_s: time with a TTC below `TTC_LIMIT_S`, of the track so far.
        tit_s2: integral of the time by which the TTC was below this limit.
        lane_index: -1 = lane to the left, 0 = ego lane, 1 = to the right; of all tracks, NaN =
            beyond these.
        lane_index_sigma: its standard deviation.
        is_lead: whether it is the next vehicle ahead on the path.
    """

    gap_m: FloatArray
    ttc_front_s: FloatArray
    headway_s: FloatArray
    drac_mps2: FloatArray
    mdrac_mps2: FloatArray
    tet_s: FloatArray
    tit_s2: FloatArray
    lane_index: FloatArray
    lane_index_sigma: FloatArray
    is_lead: BoolArray

    @classmethod
    def unknown(cls, n: int) -> SafetyMeasures:
        """Measures of n tracks about which nothing is known."""
        numbers = {
            field.name: np.full(n, np.nan) for field in fields(cls) if field.name != "is_lead"
        }
        return cls(**numbers, is_lead=np.zeros(n, np.bool_))


class SafetyMonitor:
    """Measures of all tracks of a video, frame by frame; TET and TIT are sums over the frames so
    far.
    """

    def __init__(self, settings: WarningSettings | None = None) -> None:
        """Start without tracks; None = default settings."""
        self._settings = settings or _USUAL
        self._tracks = TrackState(np.array([0.0, 0.0, np.nan]))  # TET, TIT, time

    def update(
        self,
        tracks: Tracks,
        time_s: float,
        *,
        distance_m: FloatArray,
        closing_mps: FloatArray,
        ttc_s: FloatArray,
        ego_mps: float,
        warnings: Warnings,
        lane_edges_m: tuple[float, float] | None = None,
    ) -> SafetyMeasures:
        """Measures of N tracks (N,) at `time_s`.

        `distance_m` is filtered, `ttc_s` (2, N) the time to collision of the camera with its
        standard deviation, `ego_mps` NaN = unknown. `lane_edges_m` are the left and the right
        line of the ego lane relative to the ego path, positive = right; None = not seen, the ego
        path is then the middle of its lane.
        """
        settings, class_id = self._settings, tracks.class_id
        gap_m = np.maximum(distance_m - settings.front_m, 0.0)
        is_user = _IS_ROAD_USER[class_id]
        is_on_path = (apart_m(warnings.path_offset_m, class_id, settings) < 0) & is_user

        # Time to collision, where the object is probably on the path, and headway.
        overlap = _overlap(warnings, HALF_WIDTH_M[class_id] + settings.ego_width_m / 2)
        # unknown without a probability of contact: the motion is then too uncertain
        will_be_on_path = (np.maximum(overlap, warnings.probability) >= _LIKELY) & is_user
        camera_s, sigma_s = ttc_s
        is_significant = ~(sigma_s > _MAX_RELATIVE_SIGMA * camera_s)  # True for an unknown sigma
        is_on_course = will_be_on_path & is_significant
        front_s = np.where(is_on_course, camera_s, np.nan) * gap_m / distance_m
        has_headway = is_on_path & (ego_mps >= _MIN_EGO_MPS)
        headway_s = np.where(has_headway, gap_m / max(ego_mps, _MIN_EGO_MPS), np.nan)

        # Required decelerations.
        closing_on_path_mps = np.where(is_on_path & (closing_mps > 0), closing_mps, np.nan)
        left_m = gap_m - closing_on_path_mps * settings.reaction_s
        drac_mps2 = _required_deceleration(closing_on_path_mps, gap_m)
        mdrac_mps2 = _required_deceleration(closing_on_path_mps, left_m)

        tet_s, tit_s2 = self._exposure(tracks.track_id, front_s, time_s)
        lane_index, lane_index_sigma = _lane_index(
            warnings.path_offset_m, warnings.path_offset_sigma_m, lane_edges_m
        )

        # The lead: the nearest vehicle ahead that does not come towards the ego vehicle.
        is_lead = is_on_path & _IS_VEHICLE[class_id] & np.isfinite(gap_m)
        is_lead &= ~(ego_mps - closing_mps < _MIN_OWN_MPS)
        is_lead &= gap_m == np.where(is_lead, gap_m, np.inf).min(initial=np.inf)
        return SafetyMeasures(
            gap_m=gap_m,
            ttc_front_s=front_s,
            headway_s=headway_s,
            drac_mps2=drac_mps2,
            mdrac_mps2=mdrac_mps2,
            tet_s=tet_s,
            tit_s2=tit_s2,
            lane_index=lane_index,
            lane_index_sigma=lane_index_sigma,
            is_lead=is_lead,
        )

    def _exposure(
        self, track_id: IntArray, ttc_s: FloatArray, time_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """TET and TIT (N,) of the tracks so far."""
        below_s = TTC_LIMIT_S - ttc_s
        tet_s, tit_s2, last_s = self._tracks.get(track_id)
        elapsed_s = time_s - last_s
        dt = np.where(elapsed_s <= MAX_GAP_S, elapsed_s, 0.0)
        tet_s = tet_s + dt * (below_s > 0)
        tit_s2 = tit_s2 + dt * np.fmax(below_s, 0.0)
        state = np.array([tet_s, tit_s2, np.full(len(dt), time_s)])
        is_recent = time_s - self._tracks.known[2] <= MAX_GAP_S
        self._tracks.put(track_id, state, keep_known=is_recent)
        return tet_s, tit_s2


def _overlap(warnings: Warnings, reach_m: FloatArray) -> FloatArray:
    """(N,) probability that the offsets from the ego path are at most `reach_m`; NaN = unknown."""
    offset_m, sigma_m = warnings.path_offset_m, warnings.path_offset_sigma_m
    sigma_m = np.full_like(offset_m, _LEAST_M) if sigma_m is None else np.fmax(sigma_m, _LEAST_M)
    return np.asarray(ndtr((reach_m - offset_m) / sigma_m) - ndtr((-reach_m - offset_m) / sigma_m))


def _required_deceleration(closing_mps: FloatArray, gap_m: FloatArray) -> FloatArray:
    """(N,) deceleration in m/s^2 that ends the closing speed within the gap."""
    return np.asarray(closing_mps * closing_mps / (2 * np.maximum(gap_m, _MIN_GAP_M)))


def lane_edges_m(lanes: LaneLines | None, camera: PinholeCamera) -> tuple[float, float] | None:
    """Left and right line of the ego lane relative to the camera, for a lane of usual width; None =
    not both seen.

    The camera looks along the lane: x of its axis between the lines in the lowest common row is its
    place in the lane.
    """
    if lanes is None or lanes.left is None or lanes.right is None:
        return None
    y_px = np.array(min(lanes.left.y_bottom_px, lanes.right.y_bottom_px))
    left_px, right_px = float(lanes.left.x_px(y_px)), float(lanes.right.x_px(y_px))
    if not left_px < camera.cx_px < right_px:
        return None
    place = (camera.cx_px - left_px) / (right_px - left_px)
    return -_LANE_M * place, _LANE_M * (1 - place)


def _lane_index(
    offset_m: FloatArray, sigma_m: FloatArray | None, edges_m: tuple[float, float] | None
) -> tuple[FloatArray, FloatArray]:
    """(N,) most probable lane of objects at these offsets from the ego path, and its standard
    deviation.
    """
    left_m, right_m = edges_m or (-_LANE_M / 2, _LANE_M / 2)
    own_sigma_m = np.zeros_like(offset_m) if sigma_m is None else np.fmax(sigma_m, 0.0)
    total_sigma_m = np.hypot(own_sigma_m, _LANE_SIGMA_M)
    limits = np.array([[2 * left_m - right_m], [left_m], [right_m], [2 * right_m - left_m]])
    below = ndtr((limits - offset_m) / total_sigma_m)
    p = below[1:] - below[:-1]
    index, total = p.argmax(axis=0) - 1.0, p.sum(axis=0)
    is_known = total > 0.5  # False for NaN
    variance = (p * (_LANES - index) ** 2).sum(axis=0) / np.where(is_known, total, 1.0)
    return np.where(is_known, index, np.nan), np.where(is_known, np.sqrt(variance), np.nan)


def post_encroachment_s(
    ego: FloatArray,
    track: FloatArray,
    *,
    half_width_m: float,
    settings: WarningSettings | None = None,
) -> float:
    """PET of a track whose path crosses the ego path; NaN = no crossing, or the two have not both
    passed it.

    `ego` (M, 3) and `track` (N, 3) are times in s with positions in m in the frame `map`, of the
    camera and of the object's middle, in the order of time. The place of the encounter is where the
    track is nearer to the ego path than `half_width_m` and half of the ego vehicle; the ego vehicle
    is there from its front to its rear.
    """
    settings = settings or _USUAL
    step = np.hypot(*np.diff(ego[:, 1:], axis=0).T)
    moved = np.concatenate([[True], step > 1e-3])  # rows of a standing vehicle have no direction
    ego = ego[moved]
    if len(ego) < 2 or len(track) < 2:
        return np.nan
    along = np.diff(ego[:, 1:], axis=0)
    length = np.hypot(*along.T)
    s_ego = np.concatenate([[0.0], np.cumsum(length)])
    # Place s along the ego path and offset e from it of each position of the track.
    away = track[:, None, 1:] - ego[None, :-1, 1:]
    part = np.clip((away * along).sum(axis=2) / length**2, 0.0, 1.0)
    residual = away - part[:, :, None] * along
    nearest = np.hypot(residual[..., 0], residual[..., 1]).argmin(axis=1)
    row = np.arange(len(track))
    s = s_ego[nearest] + part[row, nearest] * length[nearest]
    x, y = residual[row, nearest].T
    e = (along[nearest, 0] * y - along[nearest, 1] * x) / length[nearest]
    reach_m = half_width_m + settings.ego_width_m / 2
    is_there = (np.hypot(x, y) < reach_m) & (s > 0) & (s < s_ego[-1])
    inside = np.flatnonzero(is_there)
    if not len(inside):
        return np.nan
    before, after = e[: inside[0]], e[inside[-1] + 1 :]
    if not (len(before) and len(after) and before[-1] * after[0] < 0):
        return np.nan
    place_m = float(np.median(s[inside]))
    arrives_s, leaves_s = np.interp(
        [place_m - settings.front_m, place_m - settings.front_m + settings.ego_length_m],
        s_ego,
        ego[:, 0],
    )
    first_s, last_s = track[inside[0], 0], track[inside[-1], 0]
    return float(max(arrives_s - last_s, first_s - leaves_s, 0.0))
