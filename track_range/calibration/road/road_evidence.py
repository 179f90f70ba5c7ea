"""Evidence of a video about its camera (boxes of road users, rows of the horizon), and known metres
in the video.

Frames are read at `STEP_S`, as close as the tracker needs them. The horizon comes from the lines of
the ego lane, where they meet, and from the direction of travel (epipole), which is parallel to the
road. Known metres are given as on the command line: 'T_S,X1,Y1,X2,Y2=METRES', with the box of the
object at the time T_S.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from track_range.detection.detections import Detections
from track_range.detection.lanes.edges import EdgeLaneFinder
from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted
from track_range.foundation.robust_statistics import MAD_TO_SIGMA
from track_range.ranging.cameras.measurements import (
    HorizonRow,
    KnownLane,
    SceneBoxes,
    unhidden,
)
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.tracking.registry import create_tracker

STEP_S = 0.1  # time between the frames that are read
_TIME_EPSILON_S = 0.004  # tolerance of that time, for frame rates that divide it
_MIN_ROWS = 5  # smallest number of rows from which the horizon is taken
# Standard deviations of the horizon from lanes and from the direction of travel that do not average
# out: slopes and curves of the road, and the vehicle's attitude.
_LANE_SIGMA_RAD, _TRAVEL_SIGMA_RAD = 0.006, 0.006
_IDS_PER_PART = 1_000_000  # difference between the track ids of two parts of a video
# Plausible known distances, heights and widths of objects, and lane widths, m.
DISTANCE_M, SIZE_M, LANE_M = (1.0, 200.0), (0.2, 6.0), (1.5, 30.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownMetres:
    """Known metres of one box at one time; NaN = unknown."""

    text: str  # time and box as given
    time_s: float  # seconds from the first frame
    xyxy_px: tuple[float, float, float, float]  # the box in px of the video
    class_name: str = ""  # class of the object; "" = as detected
    distance_m: float = math.nan
    height_m: float = math.nan
    width_m: float = math.nan


def known_metres(
    distances: Sequence[str], heights: Sequence[str], widths: Sequence[str]
) -> tuple[KnownMetres, ...]:
    """Measurements from texts of options, one object by time and box; UsageError for invalid or
    implausible texts.
    """
    known: dict[str, KnownMetres] = {}
    for flag, key, texts, limits in (
        ("--known-distance", "distance_m", distances, DISTANCE_M),
        ("--known-height", "height_m", heights, SIZE_M),
        ("--known-width", "width_m", widths, SIZE_M),
    ):
        for text in texts:
            parts, (time_s, x1, y1, x2, y2), class_name, metres = _parsed(
                text, flag, "T_S,X1,Y1,X2,Y2", limits
            )
            if not (x2 > x1 and y2 > y1 and time_s >= 0):
                raise UsageError(
                    f"{flag} {quoted(text)}: expected a time and a box with X1 < X2 and Y1 < Y2 in "
                    "px of the video."
                )
            place = ",".join(parts)
            before = known.get(
                place,
                KnownMetres(
                    text=place, time_s=time_s, xyxy_px=(x1, y1, x2, y2), class_name=class_name
                ),
            )
            if not math.isnan(getattr(before, key)):
                raise UsageError(
                    f"{flag} {quoted(text)}: expected one value for this box, found two; omit one."
                )
            added: dict[str, Any] = {key: metres}
            known[place] = replace(before, **added)
    return tuple(known.values())


def known_lanes(texts: Sequence[str]) -> tuple[KnownLane, ...]:
    """Lane widths from the texts 'T_S,X1,X2,Y=METRES' of the option; UsageError for invalid or
    implausible texts.
    """
    lanes, flag = [], "--known-lane-width"
    for text in texts:
        parts, (time_s, x1, x2, y), _, width_m = _parsed(text, flag, "T_S,X1,X2,Y", LANE_M)
        if x1 == x2:
            raise UsageError(f"{flag} {quoted(text)}: expected two different columns X1 and X2.")
        lanes.append(
            KnownLane(
                name=",".join(parts), time_s=time_s, x1_px=x1, x2_px=x2, y_px=y, width_m=width_m
            )
        )
    return tuple(lanes)


def _parsed(
    text: str, flag: str, form: str, limits: tuple[float, float]
) -> tuple[list[str], list[float], str, float]:
    """Parts before the equals sign, their numbers and the class behind them, and the metres."""
    place, equals, value = text.partition("=")
    parts = [part.strip() for part in place.split(",")]
    n_numbers = form.count(",") + 1
    class_name = parts[-1] if n_numbers == 5 and parts[-1] in SIZE_CLASSES else ""
    texts = parts[:-1] if class_name else parts
    metres = _number(value)
    if not equals or not limits[0] <= metres <= limits[1]:
        raise UsageError(
            f"{flag} {quoted(text)}: expected '{form}=METRES' with {limits[0]:g} to {limits[1]:g} "
            "m behind the equals sign."
        )
    numbers = [_number(part) for part in texts]
    if len(numbers) != n_numbers or not all(map(math.isfinite, numbers)):
        raise UsageError(
            f"{flag} {quoted(text)}: expected '{form}=METRES', found {len(texts)} values before "
            "the equals sign."
        )
    return parts, numbers, class_name, metres


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


@dataclass(slots=True)
class RoadEvidence:
    """The evidence so far."""

    camera: PinholeCamera  # an approximate model
    n_frames: int = 0
    # of tracks, not hidden by others, by frame
    boxes: list[SceneBoxes] = field(default_factory=list)
    lane_rows: list[float] = field(default_factory=list)  # rows of the horizon from lanes, px
    travel_rows: list[float] = field(default_factory=list)  # rows of the direction of travel, px
    _n_parts: int = 0

    def add(
        self,
        frames: Iterable[Frame],
        detect: Callable[[Frame], Detections],
        advance: Callable[[int, int | None], None] | None = None,
        has_horizon: bool = True,
    ) -> None:
        """Add a part of the video, perhaps without horizon; `advance` is called with the number of
        frames so far.
        """
        tracker, lanes, motion = (
            create_tracker("deepsort"),
            EdgeLaneFinder(),
            ImageMotionEstimator(self.camera),
        )
        self._n_parts += 1
        last_s = -np.inf
        for frame in frames:
            if frame.time_s - last_s < STEP_S - _TIME_EPSILON_S:
                continue
            last_s = frame.time_s
            detections = detect(frame)
            tracks = tracker.update(detections, frame.time_s, frame.left)
            rows = np.flatnonzero(tracks.observed & unhidden(tracks.xyxy_px))
            ids = tracks.track_id[rows] + self._n_parts * _IDS_PER_PART
            self.boxes.append(SceneBoxes(tracks.xyxy_px[rows], tracks.class_id[rows], ids))
            if has_horizon:
                if (row := lanes.find(frame.left, frame.time_s).horizon_px()) is not None:
                    self.lane_rows.append(row[0])
                epipole_px = motion.update(frame.left, frame.time_s, detections.xyxy_px).epipole_px
                if np.isfinite(epipole_px[1]):
                    self.travel_rows.append(epipole_px[1])
            self.n_frames += 1
            if advance is not None:
                advance(self.n_frames, None)

    @property
    def scene(self) -> SceneBoxes:
        """All boxes."""
        return SceneBoxes.joined(self.boxes)

    @property
    def horizon(self) -> tuple[HorizonRow, ...]:
        """The row of the horizon from lanes and from the direction of travel, where enough frames
        have a horizon.
        """
        rows = (
            _row(self.lane_rows, _LANE_SIGMA_RAD * self.camera.fy_px, "lane lines"),
            _row(self.travel_rows, _TRAVEL_SIGMA_RAD * self.camera.fy_px, "direction of travel"),
        )
        return tuple(row for row in rows if row is not None)


def _row(rows_px: Sequence[float], common_px: float, source: str) -> HorizonRow | None:
    """Median of the rows; its sigma covers independent rows and a part common to all rows."""
    if len(rows_px) < _MIN_ROWS:
        return None
    values: FloatArray = np.array(rows_px)
    middle = float(np.median(values))
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(values - middle)))
    return HorizonRow(
        middle, float(np.hypot(common_px, 1.25 * scatter / np.sqrt(len(values)))), source
    )
