"""EventFinder: finds the events of a drive, frame by frame.

An event of a kind lasts while its condition (`Conditions`) holds for a track, with interruptions of
up to `EventSettings.max_gap_s`. A new track that continues an event at the same place, after the
tracker lost the first one, belongs to the same event. One alarm is one event: `pedestrian_on_path`
for a person, `cut_in` for a vehicle that has just cut in, else `forward_collision`; a hard approach
during an alarm is part of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, SAME_OBJECT_GROUP
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.track_state import TrackState
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.registry import methods
from track_range.ranging.warning.safety import (
    HALF_WIDTH_M,
    TTC_LIMIT_S,
    SafetyMeasures,
    SafetyMonitor,
    apart_m,
    post_encroachment_s,
)
from track_range.ranging.warning.settings import WarningSettings
from track_range.results.events.event import (
    WARNING_KINDS,
    Event,
    EventKind,
    EventSettings,
    probability_words,
)
from track_range.results.rows.supported import supported_values

# largest difference of two tracks of one object: m, plus a fraction
_NEAR_M, _NEAR_FRACTION = 2.0, 0.15
_NEAR_ACROSS_M = 1.5  # largest lateral difference between two tracks of one object, m
_SITUATION = (
    *("distance_m", "sigma_m", "closing_mps", "closing_sigma_mps"),
    *("probability", "apart_m"),
)
_MEASURES = ("gap_m", "ttc_front_s", "headway_s", "drac_mps2", "mdrac_mps2")
_SMALLEST = ("gap_m", "ttc_front_s", "headway_s")
_LARGEST = ("closing_mps", "probability", "drac_mps2", "mdrac_mps2")
_PATH_S = 30.0  # time for which positions of tracks are kept, s
_RECENT_S = 2.5  # the same of frames with which a value has to agree
# distance from the edge of the ego path at which an object is clearly in it or beside it, m
_MARGIN_M = 0.3
_PERSON = ROAD_CLASSES.index("person")
_IS_VEHICLE = np.array(
    [name in ("bicycle", "car", "motorcycle", "bus", "truck") for name in ROAD_CLASSES]
)

_MIN_ALONG_MPS = 2.0  # of a vehicle that moves in the direction of the ego vehicle
_MAX_CUT_IN_M = 40.0  # farther away, the lateral position is too uncertain
_MIN_CLOSING_MPS = 2.0  # of a hard approach; below, a touch at walking speed
_MAX_SPEED_MPS = 70.0  # of a road user; above, the track is wrong
_CLEAR_SIGMAS = 2.0  # a gap of fewer standard deviations does not exclude a contact
# of a hard approach, more than tyres allow; above, it was a contact, or wrong
_MAX_BRAKING_MPS2 = 15.0
_LEAST_SHOWN_MPS2 = 0.05  # a smaller required deceleration would be shown as 0.0


# probability of contact below which an alarm is for a cut-in, the smallest one that starts another:
# that of people
_LEAST_ON = WarningSettings().person_probability


Place = tuple[float, float, float]  # time in s, x and y in m in the frame `map`


@dataclass(frozen=True, slots=True)
class Situation:
    """Values of the N tracks of a frame from which events are found, (N,) each; NaN = unknown."""

    distance_m: FloatArray  # filtered, else measured
    sigma_m: FloatArray
    closing_mps: FloatArray
    closing_sigma_mps: FloatArray
    offset_m: FloatArray  # lateral, from the ego path
    # between the edges of object and ego path, negative = the object is in the path
    apart_m: FloatArray
    probability: FloatArray  # of contact
    safety: SafetyMeasures

    @classmethod
    def of(cls, result: FrameResult) -> Situation:
        """The situation in a frame."""
        unknown = np.full(len(result.tracks), np.nan)
        distance_m = sigma_m = unknown
        first = result.ranges.get("fused_kf", result.ranges.get("fused"))
        if first is not None:
            last = result.ranges.get("fused", first)
            is_known = np.isfinite(first.distance_m)
            distance_m = np.where(is_known, first.distance_m, last.distance_m)
            sigma_m = np.where(is_known, first.sigma_m, last.sigma_m)
        warnings, safety = result.warnings, result.safety
        offset_m, class_id = warnings.path_offset_m, result.tracks.class_id
        if not result.alarms.has_safety:  # rows of earlier versions, and views to the side
            safety = SafetyMonitor().update(
                result.tracks,
                result.time_s,
                distance_m=distance_m,
                closing_mps=result.closing_mps,
                ttc_s=np.array([result.approach.ttc_s, result.approach.ttc_sigma_s]),
                ego_mps=result.ego_mps,
                warnings=warnings,
            )
        apart = apart_m(offset_m, class_id)
        return cls(
            distance_m=distance_m,
            sigma_m=sigma_m,
            closing_mps=result.closing_mps,
            closing_sigma_mps=result.closing_sigma_mps,
            offset_m=offset_m,
            apart_m=apart,
            probability=warnings.probability,
            safety=safety,
        )

    def columns(self, result: FrameResult) -> dict[str, Any]:
        """(N,) values of the tracks from which the supported ones follow, by name."""
        approach = result.approach
        return {
            "track_id": result.tracks.track_id,
            "time_s": np.full(len(result.tracks), result.time_s),
            "observed": result.tracks.observed,
            **{name: getattr(approach, name) for name in ("is_cut", "ttc_s", "ttc_sigma_s")},
            **{name: getattr(self, name) for name in _SITUATION[:4]},
            **{name: getattr(self.safety, name) for name in _MEASURES},
        }

    def values(self, row: int, names: Iterable[str]) -> dict[str, float]:
        """Values of a track, of the situation and of its `SafetyMeasures`, by name."""
        return {
            name: float(getattr(self.safety if name in _MEASURES else self, name)[row])
            for name in names
        }


class Conditions:
    """Which tracks meet the condition of which kind of event, frame by frame."""

    def __init__(self, settings: EventSettings) -> None:
        self._settings = settings
        # last time beside the path, time of entry, last time seen
        self._tracks = TrackState(np.full(3, np.nan))

    def update(self, result: FrameResult, now: Situation) -> Mapping[EventKind, BoolArray]:
        """(N,) whether each track meets the condition of a kind, by kind."""
        settings, classes = self._settings, result.tracks.class_id
        time_s, ego_mps = result.time_s, result.ego_mps
        beside_s, entered_s, _ = self._tracks.get(result.tracks.track_id)
        apart_m = now.apart_m
        beside_s = np.where(apart_m > _MARGIN_M, time_s, beside_s)
        is_in_path = apart_m < -_MARGIN_M
        is_vehicle = _IS_VEHICLE[classes]
        # False without ego speed
        is_along = is_vehicle & (ego_mps - now.closing_mps > _MIN_ALONG_MPS)
        came = (
            is_along & (time_s - beside_s <= settings.cut_in_s) & (now.distance_m < _MAX_CUT_IN_M)
        )
        enters = came & is_in_path & ~(beside_s <= entered_s)
        entered_s = np.where(enters, time_s, entered_s)
        is_recent = time_s - self._tracks.known[2] <= settings.cut_in_s
        state = np.stack([beside_s, entered_s, np.full(len(beside_s), time_s)])
        self._tracks.put(result.tracks.track_id, state, keep_known=is_recent)

        active = result.warnings.active
        has_cut_in = came & (time_s - entered_s <= settings.cut_in_s)
        cuts_in = active & (came & (apart_m > -_MARGIN_M) | has_cut_in)
        is_fast = ego_mps >= settings.min_ego_mps
        is_close = (
            is_along & is_in_path & is_fast & (now.safety.headway_s < settings.close_headway_s)
        )
        own_mps = (ego_mps if math.isfinite(ego_mps) else 0.0) - now.closing_mps
        is_critical = (now.probability >= settings.near_miss_probability) & (
            np.abs(own_mps) < _MAX_SPEED_MPS
        )
        is_oncoming = own_mps < (-_MIN_ALONG_MPS if math.isfinite(ego_mps) else -math.inf)
        return {
            "forward_collision": active & (classes != _PERSON) & ~cuts_in,
            "pedestrian_on_path": active & (classes == _PERSON),
            "cut_in": cuts_in
            | (
                has_cut_in
                & is_in_path
                & is_fast
                & (now.safety.headway_s < settings.cut_in_headway_s)
            ),
            "close_following": is_close,
            "hard_approach": is_vehicle
            & is_in_path
            & is_critical
            & ~is_oncoming
            & (now.closing_mps > _MIN_CLOSING_MPS)
            & (now.safety.drac_mps2 > settings.hard_approach_mps2)
            & (now.safety.drac_mps2 < _MAX_BRAKING_MPS2),
            "near_miss": is_critical
            & (now.safety.ttc_front_s < settings.near_miss_ttc_s)
            & (is_vehicle | (classes == _PERSON)),
        }


@dataclass(slots=True)
class _Open:
    kind: EventKind
    group: int  # of the class of its object, see `SAME_OBJECT_GROUP`
    start_s: float
    last_s: float
    track_id: int = 0  # last one of the tracks of its object
    track_ids: set[int] = field(default_factory=set)
    distance_m: float = math.nan  # where the object was last in the condition
    offset_m: float = math.nan
    warning_s: float = math.nan
    criticality: float = -math.inf
    # least distances and times, largest speeds
    extremes: dict[str, float] = field(default_factory=dict)
    first: dict[str, float] = field(default_factory=dict)  # values of the first frame
    peak: dict[str, float] = field(default_factory=dict)  # values of the most critical frame
    # where the object of a near miss was last seen
    last_seen: dict[str, float] = field(default_factory=dict)
    tet_s: float = 0.0
    tit_s2: float = 0.0
    paths: list[list[Place]] = field(default_factory=list)  # of its tracks
    peak_track_id: int = 0
    peak_class: int = 0


class EventFinder:
    """Finds the events of a drive from its frames in order, live or from the rows of a run."""

    def __init__(self, settings: EventSettings | None = None, *, is_off: bool = False) -> None:
        """`is_off`: there are no events, since the camera drives nowhere."""
        self.settings, self._is_off = settings or EventSettings(), is_off
        self._conditions = Conditions(self.settings)
        self._open: list[_Open] = []
        self._ended: list[tuple[Event, list[list[Place]]]] = []  # with the paths of its tracks
        self._alarms: list[_Open] = []  # alarms that have ended
        self._ego: list[Place] = []
        self._paths: dict[int, list[Place]] = {}  # of the tracks
        self._recent: list[dict[str, Any]] = []  # columns of the last frames

    def update(self, result: FrameResult) -> tuple[Event, ...]:
        """Events that ended before this frame and have not been returned yet, in the order of their
        ends.
        """
        if self._is_off:
            return ()
        ended = self._close(result.time_s)
        now = Situation.of(result)
        self._follow_paths(result)
        self._recent = [
            *(one for one in self._recent if result.time_s - one["time_s"][0] <= _RECENT_S),
            *([now.columns(result)] if len(result.tracks) else []),
        ]
        for kind, holds in self._conditions.update(result, now).items():
            for row in holds.nonzero()[0].tolist():
                self._extend(kind, result, now, row)
        for event in self._open:
            if event.kind == "near_miss":  # also after its condition has ended
                _follow(event, result, now)
        return ended

    def finish(self) -> tuple[Event, ...]:
        """All events of the drive in the order of their starts, including events in progress; ends
        the drive.
        """
        self._close(math.inf)
        return self.so_far()

    def so_far(self) -> tuple[Event, ...]:
        """Events that have ended, and events in progress that count, in the order of their
        starts.
        """
        in_progress = (_event(event) for event in self._open if self._counts(event))
        ended = (self._with_pet(event, paths) for event, paths in self._ended)
        return tuple(sorted((*ended, *in_progress), key=lambda event: event.start_s))

    def forget(self, before_s: float) -> None:
        """Drop the events that ended before a time, so that memory is bounded."""
        self._ended = [(event, paths) for event, paths in self._ended if event.end_s >= before_s]
        self._alarms = [alarm for alarm in self._alarms if alarm.last_s >= before_s]
        self._ego = [place for place in self._ego if place[0] >= before_s - _PATH_S]

    def _follow_paths(self, result: FrameResult) -> None:
        """Store the positions of the camera and of the tracks in the frame `map`."""
        pose, motion, time_s = result.ego_pose, result.motion, result.time_s
        if math.isnan(pose.x_m):
            return
        self._ego.append((time_s, pose.x_m, pose.y_m))
        self._paths = {
            i: path for i, path in self._paths.items() if time_s - path[-1][0] <= _PATH_S
        }
        columns = (result.tracks.track_id, motion.world_x_m, motion.world_y_m)
        for track_id, x_m, y_m in zip(*(column.tolist() for column in columns), strict=True):
            if math.isfinite(x_m):
                self._paths.setdefault(track_id, []).append((time_s, x_m, y_m))

    def _supported(self, track_id: int) -> dict[str, float]:
        """The supported values of a track in this frame, by name; NaN = none."""
        names = self._recent[-1]
        own = [one["track_id"] == track_id for one in self._recent]
        track = {
            name: np.concatenate(
                [one[name][rows] for one, rows in zip(self._recent, own, strict=True)]
            )
            for name in names
        }
        supported = supported_values(track, track["distance_m"], track["sigma_m"])
        return {name: float(values[-1]) for name, values in supported.items()}

    def _with_pet(self, event: Event, paths: list[list[Place]]) -> Event:
        """The event with the smallest PET of its tracks, from the known parts of the paths."""
        half_width_m = float(HALF_WIDTH_M[ROAD_CLASSES.index(event.class_name)])
        ego = np.array(self._ego).reshape(-1, 3)
        near = ego[(ego[:, 0] >= event.start_s - _PATH_S) & (ego[:, 0] <= event.end_s + _PATH_S)]
        times_s = [
            post_encroachment_s(near, np.array(path), half_width_m=half_width_m) for path in paths
        ]
        pet_s = float(np.fmin.reduce(times_s, initial=math.nan))
        return event if math.isnan(pet_s) else replace(event, pet_s=pet_s)

    def _close(self, time_s: float) -> tuple[Event, ...]:
        """End the events that have been interrupted for too long."""
        over = [event for event in self._open if time_s - event.last_s > self.settings.max_gap_s]
        if not over:
            return ()
        self._open = [
            event for event in self._open if time_s - event.last_s <= self.settings.max_gap_s
        ]
        self._alarms += [event for event in over if math.isfinite(event.warning_s)]
        counted = [(_event(event), event.paths) for event in over if self._counts(event)]
        self._ended += counted
        return tuple(event for event, _ in counted)

    def _counts(self, event: _Open) -> bool:
        """Whether an event that is over counts: it was long enough, and is not part of an alarm or
        a contact.
        """
        settings, duration_s = self.settings, event.last_s - event.start_s
        if event.kind == "close_following":
            return duration_s >= settings.min_following_s
        if event.kind not in ("hard_approach", "near_miss"):
            return True
        if duration_s < settings.min_critical_s - 1e-9:
            return False
        if event.kind == "hard_approach":
            alarms = (
                *self._alarms,
                *(alarm for alarm in self._open if math.isfinite(alarm.warning_s)),
            )
            return all(
                event.track_ids.isdisjoint(alarm.track_ids)
                or event.start_s > alarm.last_s
                or alarm.start_s > event.last_s
                for alarm in alarms
            )
        # Whether there was a contact is not measured: a box that covers the front of the ego
        # vehicle looks alike. A near miss is reported where the last measurement speaks against
        # one: the object was beside the ego path, or the gap that was left, closed at the last
        # known speed until the event was over, is larger than `near_miss_gap_m`.
        seen = event.last_seen
        unseen_s = event.last_s + settings.max_gap_s - seen["time_s"]
        speeds_mps = (seen["closing_mps"], event.extremes["closing_mps"])
        closing_mps = next((speed for speed in speeds_mps if math.isfinite(speed)), 0.0)
        left_m = seen["gap_m"] - max(closing_mps * unseen_s, 0.0)
        return seen["apart_m"] > 0 or left_m > settings.near_miss_gap_m

    def _extend(self, kind: EventKind, result: FrameResult, now: Situation, row: int) -> None:
        """Continue the event of this kind that the track in this row belongs to, or start one."""
        track_id, class_id = int(result.tracks.track_id[row]), int(result.tracks.class_id[row])
        values = now.values(row, (*_SITUATION, *_MEASURES)) | {"ego_mps": result.ego_mps}
        supported = {**values, **self._supported(track_id)}
        distance_m, offset_m, time_s = values["distance_m"], float(now.offset_m[row]), result.time_s
        group = int(SAME_OBJECT_GROUP[class_id])
        event = self._same(kind, track_id, result, distance_m, offset_m, group)
        if event is None:
            event = _Open(kind, group, start_s=time_s, last_s=time_s, first=values)
            self._open.append(event)
        if values["ttc_front_s"] < TTC_LIMIT_S:
            dt = time_s - event.last_s  # 0 in the first frame
            event.tet_s += dt
            event.tit_s2 += dt * (TTC_LIMIT_S - values["ttc_front_s"])
        event.last_s, event.track_id, event.distance_m, event.offset_m = (
            time_s,
            track_id,
            distance_m,
            offset_m,
        )
        if track_id not in event.track_ids:
            event.track_ids.add(track_id)
            event.paths += [self._paths[track_id]] if track_id in self._paths else []
        is_active = bool(result.warnings.active[row])
        if is_active and kind in WARNING_KINDS and math.isnan(event.warning_s):
            event.warning_s = time_s
        extremes = event.extremes
        if supported["distance_m"] < extremes.setdefault("distance_m", math.inf):
            extremes["distance_m"], extremes["sigma_m"] = (
                supported["distance_m"],
                values["sigma_m"],
            )
        for name in _SMALLEST:
            extremes[name] = float(np.fmin(extremes.get(name, math.nan), supported[name]))
        for name in _LARGEST:
            extremes[name] = float(np.fmax(extremes.get(name, math.nan), supported[name]))
        if kind in ("close_following", "cut_in") and math.isfinite(supported["headway_s"]):
            criticality = -supported["headway_s"]
        elif math.isfinite(supported["ttc_front_s"]):
            criticality = -supported["ttc_front_s"]
        else:
            criticality = -1e3 - float(np.nan_to_num(values["gap_m"]))
        if not event.peak or criticality > event.criticality:
            event.criticality, event.peak_track_id, event.peak_class = (
                criticality,
                track_id,
                class_id,
            )
            in_doubt = float(result.scale_doubt is not None)
            event.peak = {
                **values,
                "time_s": time_s,
                "frame": result.index,
                "scale_in_doubt": in_doubt,
                "is_by_pair": float(_is_by_pair(result, row)),
            }

    def _same(
        self,
        kind: EventKind,
        track_id: int,
        result: FrameResult,
        distance_m: float,
        offset_m: float,
        group: int,
    ) -> _Open | None:
        """The event in progress of this kind and object, or of an earlier track of the object that
        has ended.
        """
        same_kind = [event for event in self._open if event.kind == kind]
        same = next((event for event in same_kind if track_id in event.track_ids), None)
        if same is not None or not same_kind:
            return same
        present = set(result.tracks.track_id.tolist())
        for event in same_kind:
            elapsed_s = result.time_s - event.last_s
            moved_m = elapsed_s * np.nan_to_num(event.extremes["closing_mps"])
            is_near = (
                abs(event.distance_m - moved_m - distance_m) < _NEAR_M + _NEAR_FRACTION * distance_m
            )
            # unknown offsets may be the same
            is_near &= not abs(event.offset_m - offset_m) > _NEAR_ACROSS_M
            if event.group == group and event.track_id not in present and is_near:
                return event
        return None


def _follow(event: _Open, result: FrameResult, now: Situation) -> None:
    """Store the position of the object of a near miss."""
    is_seen = np.isin(result.tracks.track_id, list(event.track_ids)) & np.isfinite(now.safety.gap_m)
    for row in np.flatnonzero(is_seen).tolist():
        event.last_seen = {
            "time_s": result.time_s,
            **now.values(row, ("gap_m", "closing_mps", "apart_m")),
        }


def _is_by_pair(result: FrameResult, row: int) -> bool:
    """Whether both cameras measured the distance of a track in a frame."""
    return any(
        bool(np.isfinite(result.ranges[one.name].distance_m[row]))
        for one in methods()
        if "right_image" in one.needs
        and one.name in result.ranges
        and one.name not in result.shown_only
    )


def _event(event: _Open) -> Event:
    extremes, peak = event.extremes, event.peak
    measures: dict[str, Any] = {
        name: extremes[name] for name in ("gap_m", "drac_mps2", "mdrac_mps2")
    }
    for name in ("distance_m", "closing_mps", "headway_s", "probability"):
        measures[f"peak_{name}"] = peak[name]
    nearest_m = extremes["distance_m"]  # infinite = none is supported
    return Event(
        kind=event.kind,
        start_s=event.start_s,
        peak_s=peak["time_s"],
        end_s=event.last_s,
        warning_s=event.warning_s,
        frame=int(peak["frame"]),
        track_id=event.peak_track_id,
        class_name=ROAD_CLASSES[event.peak_class],
        min_distance_m=nearest_m if math.isfinite(nearest_m) else math.nan,
        min_distance_sigma_m=extremes.get("sigma_m", math.nan),
        min_ttc_s=extremes["ttc_front_s"],
        closing_mps=extremes["closing_mps"],
        ego_mps=peak["ego_mps"],
        probability=extremes["probability"],
        reason=_reason(event),
        headway_s=extremes["headway_s"],
        scale_in_doubt=int(peak["scale_in_doubt"]),
        **measures,
        tet_s=event.tet_s,
        tit_s2=event.tit_s2,
        peak_ttc_s=peak["ttc_front_s"],
        peak_distance_sigma_m=peak["sigma_m"],
    )


def _reason(event: _Open) -> str:
    """What was measured, with one standard deviation, and what follows from it as a prediction."""
    class_name, first, peak = ROAD_CLASSES[event.peak_class], event.first, event.peak
    name = class_name[:1].upper() + class_name[1:]
    if event.kind in ("forward_collision", "pedestrian_on_path"):
        where = "ahead"
        if event.kind == "pedestrian_on_path":
            where = "on the path" if first["apart_m"] < 0 else "near the path"
        return f"{name} {where} at {_metres(first)}{_closing(first)}: {_trigger(first)}."
    if event.kind == "cut_in":
        headway = ""
        if math.isfinite(peak["headway_s"]):
            headway = f", at a headway of {peak['headway_s']:.1f} s"
        return f"{name} cut in {_metres(peak)} ahead{headway}{_closing(peak)}."
    if event.kind == "close_following":
        return (
            f"Headway down to {peak['headway_s']:.1f} s behind a {class_name} "
            f"{_metres(peak)} ahead, for {event.last_s - event.start_s:.0f} s; own speed "
            f"{3.6 * peak['ego_mps']:.0f} km/h."
        )
    if event.kind == "hard_approach":
        needed = f"needed braking at {peak['drac_mps2']:.1f} m/s²"
        return f"{name} ahead at {_metres(peak)}{_closing(peak)}: {needed}{_predicted(peak)}."
    return f"{name} at {_metres(peak)}{_closing(peak)}: {_near(event)}"


def _trigger(first: dict[str, float]) -> str:
    """What started an alarm, with its numbers: a probable contact, or a vehicle that moves into the
    path at a short headway.
    """
    if first["probability"] < _LEAST_ON and first["gap_m"] < math.inf and first["ego_mps"] > 0:
        headway_s = first["gap_m"] / first["ego_mps"]
        return f"it moves into the path at a headway of {headway_s:.1f} s"
    when = ""
    if math.isfinite(first["ttc_front_s"]):
        when = f" in {first['ttc_front_s']:.1f} s"
    needed = ""
    if first["mdrac_mps2"] >= _LEAST_SHOWN_MPS2:
        needed = f", which after 1 s of reaction needs {first['mdrac_mps2']:.1f} m/s²"
    return f"contact{when} without braking{_predicted(first)}{needed}"


def _near(event: _Open) -> str:
    """How near a near miss was, by which cameras, and whether a contact is within its errors."""
    extremes = event.extremes
    gap_m, sigma_m = extremes["gap_m"], extremes.get("sigma_m", math.nan)
    smallest = _metres({"distance_m": gap_m, "sigma_m": sigma_m})
    cameras = "two cameras" if event.peak["is_by_pair"] else "one camera"
    shortest = ""
    if math.isfinite(extremes["ttc_front_s"]):
        shortest = f", smallest time to contact {extremes['ttc_front_s']:.1f} s"
    sentence = (
        f"smallest gap to the front {smallest}{shortest}{_predicted(extremes)}; by {cameras}."
    )
    if gap_m < _CLEAR_SIGMAS * sigma_m:
        sentence += " The gap is within two sigma of zero, so that a contact is not excluded."
    return sentence


def _metres(values: dict[str, float]) -> str:
    """A distance with its sigma, which gives the decimals: "31 ± 2 m", "3.1 ± 0.5 m"."""
    distance_m, sigma_m = values["distance_m"], values["sigma_m"]
    decimals = 0 if sigma_m >= 1 or (math.isnan(sigma_m) and distance_m >= 10) else 1
    sigma = f" ± {max(sigma_m, 0.1):.{decimals}f}" if math.isfinite(sigma_m) else ""
    return f"{distance_m:.{decimals}f}{sigma} m"


def _closing(values: dict[str, float]) -> str:
    closing_mps, sigma_mps = values["closing_mps"], values["closing_sigma_mps"]
    if not closing_mps > 0.5:  # also NaN
        return ""
    sigma = f" ± {max(sigma_mps, 0.1):.1f}" if math.isfinite(sigma_mps) else ""
    return f", closing at {closing_mps:.1f}{sigma} m/s"


def _predicted(values: dict[str, float]) -> str:
    probability = values["probability"]
    if math.isnan(probability):
        return ""
    return f" (predicted probability {probability_words(probability)})"


def events_of(
    results: Iterable[FrameResult], settings: EventSettings | None = None
) -> tuple[Event, ...]:
    """All events of a drive from its frames in order."""
    finder = EventFinder(settings)
    for result in results:
        finder.update(result)
    return finder.finish()
