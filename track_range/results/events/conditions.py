"""Conditions of the events for all tracks of a frame, as arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.track_state import TrackState
from track_range.pipeline.frame_result import FrameResult
from track_range.results.events.event import EventKind, EventSettings

_HALF_WIDTH_M = np.array([0.3, 0.3, 0.9, 0.4, 1.25, 1.25, 0.0, 0.0])
"""(road classes,) half of the typical width of each class, m."""

_EGO_HALF_WIDTH_M = 0.9

_MARGIN_M = 0.3  # distance from the edge of the ego path at which an object is clearly in it or beside it, m

_PERSON = ROAD_CLASSES.index("person")
_IS_VEHICLE = np.array([name in ("bicycle", "car", "motorcycle", "bus", "truck") for name in ROAD_CLASSES])

_MIN_ALONG_MPS = 2.0  # of a vehicle that moves in the direction of the ego vehicle
_MAX_CUT_IN_M = 40.0  # farther away, the lateral position is too uncertain
_MIN_CLOSING_MPS = 2.0  # of a hard approach; below, a touch at walking speed
_MAX_SPEED_MPS = 70.0  # of a road user; above, the track is wrong
_MAX_BRAKING_MPS2 = 15.0  # of a hard approach, more than tyres allow; above, it was a contact, or wrong


@dataclass(frozen=True, slots=True)
class Situation:
    """Values of the N tracks of a frame from which events are found, (N,) each; NaN = unknown."""

    distance_m: FloatArray  # filtered, else measured
    sigma_m: FloatArray
    gap_m: FloatArray  # from the front of the ego vehicle
    closing_mps: FloatArray
    ttc_s: FloatArray  # gap / closing speed
    headway_s: FloatArray  # gap / ego speed
    offset_m: FloatArray  # lateral, from the ego path
    apart_m: FloatArray  # between the edges of object and ego path, negative = the object is in the path
    probability: FloatArray  # of contact

    @classmethod
    def of(cls, result: FrameResult, settings: EventSettings) -> Situation:
        """The situation in a frame."""
        unknown = np.full(len(result.tracks), np.nan)
        distance_m = sigma_m = unknown
        first = result.ranges.get("fused_kf", result.ranges.get("fused"))
        if first is not None:
            last = result.ranges.get("fused", first)
            is_known = np.isfinite(first.distance_m)
            distance_m = np.where(is_known, first.distance_m, last.distance_m)
            sigma_m = np.where(is_known, first.sigma_m, last.sigma_m)
        gap_m = np.maximum(distance_m - settings.front_m, 0.0)
        closing_mps = result.closing_mps
        ttc_s = gap_m / np.where(closing_mps > 0.5, closing_mps, np.nan)
        headway_s = gap_m / result.ego_mps if result.ego_mps >= settings.min_ego_mps else unknown
        if result.warnings is None:
            return cls(distance_m, sigma_m, gap_m, closing_mps, ttc_s, headway_s, unknown, unknown, unknown)
        offset_m, probability = result.warnings.path_offset_m, result.warnings.probability
        apart_m = np.abs(offset_m) - (_EGO_HALF_WIDTH_M + _HALF_WIDTH_M[result.tracks.class_id])
        return cls(distance_m, sigma_m, gap_m, closing_mps, ttc_s, headway_s, offset_m, apart_m, probability)


class Conditions:
    """Which tracks meet the condition of which kind of event, frame by frame."""

    def __init__(self, settings: EventSettings) -> None:
        self._settings = settings
        self._tracks = TrackState(np.full(3, np.nan))  # last time beside the path, time of entry, last time seen

    def update(self, result: FrameResult, now: Situation) -> Mapping[EventKind, BoolArray]:
        """(N,) whether each track meets the condition of a kind, by kind."""
        settings, classes = self._settings, result.tracks.class_id
        time_s, ego_mps = result.time_s, result.ego_mps
        beside_s, entered_s, _ = self._tracks.get(result.tracks.track_id)
        apart_m = now.apart_m
        beside_s = np.where(apart_m > _MARGIN_M, time_s, beside_s)
        is_in_path = apart_m < -_MARGIN_M
        is_vehicle = _IS_VEHICLE[classes]
        is_along = is_vehicle & (ego_mps - now.closing_mps > _MIN_ALONG_MPS)  # False without ego speed
        came = is_along & (time_s - beside_s <= settings.cut_in_s) & (now.distance_m < _MAX_CUT_IN_M)
        enters = came & is_in_path & ~(beside_s <= entered_s)
        entered_s = np.where(enters, time_s, entered_s)
        is_recent = time_s - self._tracks.known[2] <= settings.cut_in_s
        state = np.stack([beside_s, entered_s, np.full(len(beside_s), time_s)])
        self._tracks.put(result.tracks.track_id, state, keep_known=is_recent)

        active = np.zeros(len(classes), np.bool_) if result.warnings is None else result.warnings.active
        has_cut_in = came & (time_s - entered_s <= settings.cut_in_s)
        cuts_in = active & (came & (apart_m > -_MARGIN_M) | has_cut_in)
        is_close = is_along & is_in_path & (now.headway_s < settings.close_headway_s)
        needed_mps2 = now.closing_mps**2 / (2 * np.maximum(now.gap_m, 0.1))
        own_mps = np.nan_to_num(ego_mps) - now.closing_mps
        is_critical = (now.probability >= settings.near_miss_probability) & (np.abs(own_mps) < _MAX_SPEED_MPS)
        is_oncoming = own_mps < (-_MIN_ALONG_MPS if math.isfinite(ego_mps) else -math.inf)
        return {
            "forward_collision": active & (classes != _PERSON) & ~cuts_in,
            "pedestrian_on_path": active & (classes == _PERSON),
            "cut_in": cuts_in | (has_cut_in & is_in_path & (now.headway_s < settings.cut_in_headway_s)),
            "close_following": is_close,
            "hard_approach": is_vehicle
            & is_in_path
            & is_critical
            & ~is_oncoming
            & (now.closing_mps > _MIN_CLOSING_MPS)
            & (needed_mps2 > settings.hard_approach_mps2)
            & (needed_mps2 < _MAX_BRAKING_MPS2),
            "near_miss": is_critical & (now.ttc_s < settings.near_miss_ttc_s) & (is_vehicle | (classes == _PERSON)),
        }
