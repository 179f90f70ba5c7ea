"""LineCounter: crossings of lines, and entries and exits of zones, frame by frame.

What counts is one point of a road user: the middle of its footprint on the known plane of the road, else the middle
of the lower edge of its box. It has crossed a line when it is beyond a band on the other side, so that a point that
jitters on the line counts once; the time is that at which its way met the line, between two frames, and the speed is
the filtered one when it leaves the band.
"""

import math
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, STATIC_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.world.road_plane import RoadPlane
from track_range.results.counts.places import Place, parsed_places

KMH = 3.6  # km/h per m/s
# half width of the band, px and as a fraction of the height of the box
_BAND_PX, _BAND_FRACTION = 2.0, 0.05
_OUTSIDE = 0.05  # of the image beyond its border, up to which a point counts
_JUMP_M, _JUMP_MPS = 1.5, 40.0  # way between two frames that no road user makes
_FASTER = 1.5  # than its speed; a way that no road user of this speed makes
_AWAY_S = 1.0  # time without a row, in which another track may have counted the object
# how far from where it would be a road user is at most, as a length and as a fraction of its way
_NEAR_M, _NEAR_FRACTION = 2.5, 0.25
_FORGET_S = 5.0  # time after which a track without a box is forgotten

# (N, 2) points that count of the tracks of a frame, in px of the video
Anchors = Callable[[FrameResult], FloatArray]


@dataclass(frozen=True, slots=True)
class Crossing:
    """A road user at a line, or at the border of a zone; NaN = unknown."""

    time_s: float
    track_id: int
    class_name: str
    kind: str  # "line", "enter" or "exit"
    place: str  # name of the line or zone
    direction: str  # up, down, left or right in the image; "" for zones
    speed_kmh: float
    speed_sigma_kmh: float
    heading_deg: float
    x_m: float
    y_m: float
    x_px: float
    y_px: float
    dwell_s: float = math.nan  # of an exit: time in the zone
    mean_speed_kmh: float = math.nan  # of an exit: mean speed in the zone


@dataclass(slots=True)
class _Track:
    """What is known of a track at one place."""

    side: int = 0  # 1 = inside, or right of the line; 0 = not yet known
    time_s: float = math.nan  # of the last frame
    at_px: FloatArray = field(default_factory=lambda: np.full(2, np.nan))
    inside_px: float = math.nan
    met_s: float = math.nan  # when its way last met the border
    met_px: FloatArray = field(default_factory=lambda: np.full(2, np.nan))
    has_met: bool = False  # whether that was between the ends of a line
    entered_s: float = math.nan
    speeds_kmh: list[float] = field(default_factory=list)
    last: Crossing | None = None  # the values of the last frame


class LineCounter:
    """Counts at lines and in zones; frames must be passed in order.

    Example:
        >>> import numpy as np, track_range as tr
        >>> counter = tr.LineCounter.of(["north=300,520,980,540"])
        >>> run = tr.Run.mono("street.mp4", static_camera=True, ground="ground.yaml")
        >>> for frame in run:
        ...     for crossing in counter.update(frame):
        ...         print(crossing.class_name, crossing.direction, crossing.speed_kmh)
    """

    def __init__(self, places: Sequence[Place], anchors: Anchors | None = None) -> None:
        self.places = tuple(places)
        self.crossings: tuple[Crossing, ...] = ()
        self.n_unsure = dict.fromkeys((place.name for place in places), 0)
        self._anchors = anchors or lower_middles
        self._tracks: dict[tuple[int, int], _Track] = {}
        self._before_s = math.nan  # time of the last frame

    @classmethod
    def of(
        cls,
        lines: Sequence[str] = (),
        zones: Sequence[str] = (),
        *,
        plane: RoadPlane | None = None,
    ) -> Self:
        """The counter of texts as in --count-line and --zone, in px of the undistorted images;
        ValueError for other texts. The middles of footprints count if the plane is given.
        """
        return cls(parsed_places(lines, zones), anchors_of(plane, lambda xy_px: xy_px))

    def update(self, result: FrameResult) -> tuple[Crossing, ...]:
        """The crossings that this frame completes."""
        completed: list[Crossing] = []
        tracks = result.tracks
        before_s, self._before_s = self._before_s, result.time_s
        if not self.places or not len(tracks):
            return ()
        at_px = self._anchors(result)
        height_px = tracks.xyxy_px[:, 3] - tracks.xyxy_px[:, 1]
        band_px = np.maximum(_BAND_PX, _BAND_FRACTION * height_px)
        seen = set(tracks.track_id[tracks.observed].tolist())
        for number, place in enumerate(self.places):
            inside_px = place.inside_px(at_px)
            for row, track_id in enumerate(tracks.track_id.tolist()):
                now = self._now(result, row, at_px[row])
                if now.class_name in STATIC_CLASSES or math.isnan(inside_px[row]):
                    continue
                track = self._tracks.get((track_id, number))
                if track and track.last and _is_other(track.last, now, before_s):
                    track.has_met |= track.inside_px * float(inside_px[row]) < 0
                    self._end(track, place)
                    track = None
                track = track or self._continued(now, number, seen)
                self._tracks[track_id, number] = track
                _move(track, place, now, float(inside_px[row]))
                completed += _completed(track, place, now, float(band_px[row]))
        self._forget(result.time_s)
        self.crossings += tuple(completed)
        return tuple(completed)

    def finish(self) -> tuple[Crossing, ...]:
        """All crossings in the order of their times, after the last frame: who is still in a zone
        leaves it without a speed.
        """
        self._forget(math.inf)
        self.crossings = tuple(sorted(self.crossings, key=lambda one: (one.time_s, one.track_id)))
        return self.crossings

    def _continued(self, now: Crossing, number: int, seen: Set[int]) -> _Track:
        """The track that is no longer seen and whose way leads to here, which goes on under another
        number, else a new one.
        """
        for (track_id, place), track in self._tracks.items():
            is_gone = place == number and track_id not in seen and track_id != now.track_id
            if is_gone and track.last is not None and _leads(track.last, now):
                return self._tracks.pop((track_id, place))
        return _Track()

    @staticmethod
    def _now(result: FrameResult, row: int, at_px: FloatArray) -> Crossing:
        motion = result.motion
        speed, sigma, heading, x_m, y_m = (
            float(values[row])
            for values in (
                motion.speed_mps,
                motion.speed_sigma_mps,
                motion.heading_deg,
                motion.world_x_m,
                motion.world_y_m,
            )
        )
        return Crossing(
            time_s=result.time_s,
            track_id=int(result.tracks.track_id[row]),
            class_name=ROAD_CLASSES[int(result.tracks.class_id[row])],
            kind="",
            place="",
            direction="",
            speed_kmh=KMH * speed,
            speed_sigma_kmh=KMH * sigma,
            heading_deg=heading,
            x_m=x_m,
            y_m=y_m,
            x_px=float(at_px[0]),
            y_px=float(at_px[1]),
        )

    def _forget(self, time_s: float) -> None:
        """End the tracks that are gone."""
        for (track_id, number), track in list(self._tracks.items()):
            if time_s - track.time_s <= _FORGET_S:
                continue
            self._end(track, self.places[number])
            del self._tracks[track_id, number]

    def _end(self, track: _Track, place: Place) -> None:
        """End a track that is gone, or shows another object from now on."""
        # met the line, or began on it, and went on under another number, or out of the image
        if track.side == 0 or (track.has_met and not place.is_zone):
            self.n_unsure[place.name] += 1
        if place.is_zone and track.side > 0 and track.last is not None:
            gone = _exit(track, place, track.last, track.time_s)
            unknown = replace(gone, speed_kmh=math.nan, speed_sigma_kmh=math.nan)
            self.crossings += (unknown,)


def anchors_of(plane: RoadPlane | None, recorded: Callable[[FloatArray], FloatArray]) -> Anchors:
    """The points that count, by a plane of the road if it is known; `recorded` moves points (N, 2)
    of the undistorted images to the video.
    """

    def anchors(result: FrameResult) -> FloatArray:
        feet = lower_middles(result)
        if plane is not None:
            motion = result.motion
            on_road = [motion.world_x_m, motion.world_y_m, np.zeros(len(feet))]
            middles = plane.pixels(np.stack(on_road, axis=1))
            # a track that left the image is not followed behind the camera
            (width, height), margin = plane.size_px, _OUTSIDE * max(plane.size_px)
            is_gone = (middles < -margin) | (middles > [width + margin, height + margin])
            middles[is_gone.any(axis=1)] = np.nan
            feet = middles  # NaN until the place of a new track is known
        return recorded(feet)

    return anchors


def lower_middles(result: FrameResult) -> FloatArray:
    """(N, 2) middles of the lower edges of the boxes."""
    boxes = result.tracks.xyxy_px
    return np.stack([(boxes[:, 0] + boxes[:, 2]) / 2, boxes[:, 3]], axis=1)


def _move(track: _Track, place: Place, now: Crossing, inside_px: float) -> None:
    """Move a track to its place in a frame."""
    at_px = np.array([now.x_px, now.y_px])
    if track.inside_px * inside_px < 0 or (inside_px == 0 and track.inside_px != 0):
        share = track.inside_px / (track.inside_px - inside_px)
        track.met_s = track.time_s + share * (now.time_s - track.time_s)
        track.met_px = track.at_px + share * (at_px - track.at_px)
        track.has_met = place.crosses(track.at_px, at_px)
    track.time_s, track.at_px, track.last = now.time_s, at_px, now
    if inside_px != 0:
        track.inside_px = inside_px
    if place.is_zone and track.side > 0 and math.isfinite(now.speed_kmh):
        track.speeds_kmh.append(now.speed_kmh)


def _is_other(last: Crossing, now: Crossing, before_s: float) -> bool:
    """Whether a track may show another object by a change of identities, which has crossed nothing:
    it moved as no road user does, its speed began again elsewhere, or it came back elsewhere after
    a time without a row in the last frame, at `before_s`.
    """
    step_s = now.time_s - last.time_s
    is_away = step_s > _AWAY_S and last.time_s < before_s
    began_again = math.isfinite(last.speed_kmh) and math.isnan(now.speed_kmh)
    own_mps = _FASTER * last.speed_kmh / KMH if began_again else _JUMP_MPS
    moved_m = math.hypot(now.x_m - last.x_m, now.y_m - last.y_m)
    return moved_m > _JUMP_M + (0.0 if is_away else own_mps * step_s)


def _leads(last: Crossing, now: Crossing) -> bool:
    """Whether a road user that went on at its speed is here now."""
    step_s = now.time_s - last.time_s
    moved_m = last.speed_kmh / KMH * step_s
    heading_rad = math.radians(last.heading_deg) if moved_m > 0 else 0.0
    x_m = now.x_m - last.x_m - moved_m * math.cos(heading_rad)
    y_m = now.y_m - last.y_m - moved_m * math.sin(heading_rad)
    return step_s <= _AWAY_S and math.hypot(x_m, y_m) < _NEAR_M + _NEAR_FRACTION * moved_m


def _completed(track: _Track, place: Place, now: Crossing, band_px: float) -> list[Crossing]:
    """The crossing that a track has completed, if any."""
    if abs(track.inside_px) <= band_px:
        return []
    side, before = (1 if track.inside_px > 0 else -1), track.side
    track.side = side
    if side == before or (before == 0 and not (place.is_zone and side > 0)):
        return []
    met_s = track.met_s if before else now.time_s
    has_met, track.has_met = track.has_met, False
    if place.is_zone and side > 0:
        track.entered_s, track.speeds_kmh = met_s, []
        # a track that begins in a zone has not entered it
        return [replace(now, time_s=met_s, kind="enter", place=place.name)] if before else []
    if place.is_zone:
        return [_exit(track, place, now, met_s)]
    if not has_met:
        return []
    x_px, y_px = track.met_px.tolist()
    direction = place.direction(side > 0)
    return [
        replace(
            now,
            time_s=met_s,
            kind="line",
            place=place.name,
            direction=direction,
            x_px=x_px,
            y_px=y_px,
        )
    ]


def _exit(track: _Track, place: Place, now: Crossing, time_s: float) -> Crossing:
    speeds = track.speeds_kmh
    mean_kmh = float(np.mean(speeds)) if speeds else math.nan
    dwell_s = time_s - track.entered_s
    return replace(
        now,
        time_s=time_s,
        kind="exit",
        place=place.name,
        dwell_s=dwell_s,
        mean_speed_kmh=mean_kmh,
    )
