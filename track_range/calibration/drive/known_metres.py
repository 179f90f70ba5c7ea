"""Known metres in a video, given as on the command line: 'T_S,X1,Y1,X2,Y2=METRES', with the box of
the object at the time T_S.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from track_range.calibration.drive.drive_video import DriveVideo
from track_range.detection.boxes import iou
from track_range.detection.detections import Detections
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted
from track_range.ranging.cameras.measurements import KnownLane, KnownObject
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.stereo.geometry.frames import Frame

# Plausible known distances, heights and widths of objects, and lane widths, m.
DISTANCE_M, SIZE_M, LANE_M = (1.0, 200.0), (0.2, 6.0), (1.5, 30.0)
_MIN_IOU = 0.4  # smallest IoU of a detection with a box of the user whose class it gives
_FRAME_S = 0.5  # length of the part that is read for the frame of a measurement

Detect = Callable[[Frame], Detections]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownMeasurements:
    """Everything that the user measured."""

    objects: tuple[KnownMetres, ...] = ()
    lanes: tuple[KnownLane, ...] = ()
    camera_height_m: float | None = None  # height of the camera above the road; None = unknown

    @property
    def are_given(self) -> bool:
        """Whether there is a measurement that may show the focal length."""
        return bool(self.objects or self.lanes or self.camera_height_m is not None)

    def check(self, drive: DriveVideo) -> None:
        """Raise UsageError for a measurement outside the image or the video."""
        for known in self.objects:
            hint = "a box inside the image of {} px; measure it in the original video"
            drive.check_inside(known.text, hint, known.xyxy_px, known.time_s)
        for lane in self.lanes:
            x1, x2 = sorted((lane.x1_px, lane.x2_px))
            hint = "columns and a row inside the image of {} px"
            name = f"--known-lane-width {lane.name}"
            drive.check_inside(name, hint, (x1, lane.y_px, x2, lane.y_px), lane.time_s)


def known_objects(
    objects: Sequence[KnownMetres], drive: DriveVideo, detect: Detect
) -> tuple[KnownObject, ...]:
    """The measured objects with their classes; UsageError if the detector finds none in a box
    without a class.
    """
    known = []
    for metres in objects:
        name = metres.class_name or _detected_class(metres, drive, detect)
        if not name:
            raise UsageError(
                f"{metres.text}: expected the box of an object, but the detector finds none there; "
                f"correct the box, or add the class after the box: '{metres.text},van=...'."
            )
        known.append(
            KnownObject(
                name=metres.text,
                xyxy_px=metres.xyxy_px,
                size_class=SIZE_CLASSES.index(name),
                distance_m=metres.distance_m,
                height_m=metres.height_m,
                width_m=metres.width_m,
            )
        )
    return tuple(known)


def _detected_class(metres: KnownMetres, drive: DriveVideo, detect: Detect) -> str:
    """Class of the detection that overlaps most with a box; "" = none."""
    with drive.opened(max(metres.time_s - 0.02, 0), _FRAME_S) as recording:
        frame = next(recording.frames, None)
        if frame is None:
            return ""
        detections = detect(frame)
    if not len(detections):
        return ""
    overlap = iou(np.array([metres.xyxy_px]), detections.xyxy_px)[0]
    best = int(np.argmax(overlap))
    return SIZE_CLASSES[int(detections.class_id[best])] if overlap[best] >= _MIN_IOU else ""
