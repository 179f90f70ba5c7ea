"""Known metres as the command line takes them: 'T_S,X1,Y1,X2,Y2=METRES', with the box of the object at the time T_S."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted
from track_range.ranging.fitting.camera.measurements import KnownLane
from track_range.ranging.size_models.size_model import SIZE_CLASSES

# Plausible known distances, heights and widths of objects, and lane widths, m.
DISTANCE_M, SIZE_M, LANE_M = (1.0, 200.0), (0.2, 6.0), (1.5, 30.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownMetres:
    """Known metres of one box at one time; NaN = unknown.

    Attributes:
        text: time and box as given.
        time_s: seconds from the first frame.
        xyxy_px: the box in px of the video.
        class_name: class of the object; "" = as detected.
        distance_m, height_m, width_m: the metres.
    """

    text: str
    time_s: float
    xyxy_px: tuple[float, float, float, float]
    class_name: str = ""
    distance_m: float = math.nan
    height_m: float = math.nan
    width_m: float = math.nan


def known_metres(distances: Sequence[str], heights: Sequence[str], widths: Sequence[str]) -> tuple[KnownMetres, ...]:
    """Measurements of objects from the texts of the options; those of equal time and box are of one object.

    Raises UsageError if a text is not a measurement, or a value is not plausible.
    """
    metres_of: dict[str, dict[str, float]] = {}
    for flag, key, texts, limits in (
        ("--known-distance", "distance_m", distances, DISTANCE_M),
        ("--known-height", "height_m", heights, SIZE_M),
        ("--known-width", "width_m", widths, SIZE_M),
    ):
        for text in texts:
            place, metres = _split(text, flag, "'T_S,X1,Y1,X2,Y2=METRES'", limits)
            known = metres_of.setdefault(",".join(place), {})
            if key in known:
                raise UsageError(f"{flag} {quoted(text)}: expected one value for this box, found two; omit one.")
            known[key] = metres
    return tuple(_object(place, metres) for place, metres in metres_of.items())


def known_lanes(texts: Sequence[str]) -> tuple[KnownLane, ...]:
    """Lane widths from the texts 'T_S,X1,X2,Y=METRES' of the option.

    Raises UsageError if a text is not a measurement, or a value is not plausible.
    """
    lanes = []
    for text in texts:
        place, width_m = _split(text, "--known-lane-width", "'T_S,X1,X2,Y=METRES'", LANE_M)
        numbers = _numbers(place, text, "--known-lane-width", "'T_S,X1,X2,Y=METRES'", 4)
        lanes.append(
            KnownLane(
                name=",".join(place),
                time_s=numbers[0],
                x1_px=numbers[1],
                x2_px=numbers[2],
                y_px=numbers[3],
                width_m=width_m,
            )
        )
        if numbers[1] == numbers[2]:
            raise UsageError(f"--known-lane-width {quoted(text)}: expected two different columns X1 and X2.")
    return tuple(lanes)


def _object(place: str, metres: dict[str, float]) -> KnownMetres:
    parts = place.split(",")
    class_name = parts.pop() if parts[-1] in SIZE_CLASSES else ""
    time_s, x1, y1, x2, y2 = _numbers(parts, place, "--known-distance", "'T_S,X1,Y1,X2,Y2=METRES'", 5)
    if not (x2 > x1 and y2 > y1 and time_s >= 0):
        raise UsageError(f"{quoted(place)}: expected a time and a box with X1 < X2 and Y1 < Y2 in px of the video.")
    return KnownMetres(text=place, time_s=time_s, xyxy_px=(x1, y1, x2, y2), class_name=class_name, **metres)


def _split(text: str, flag: str, form: str, limits: tuple[float, float]) -> tuple[list[str], float]:
    """Parts before the equals sign, and the metres behind it."""
    place, equals, value = text.partition("=")
    try:
        metres = float(value)
    except ValueError:
        metres = math.nan
    if not equals or not limits[0] <= metres <= limits[1]:
        raise UsageError(
            f"{flag} {quoted(text)}: expected {form} with {limits[0]:g} to {limits[1]:g} m behind the equals sign."
        )
    return [part.strip() for part in place.split(",")], metres


def _numbers(parts: Sequence[str], text: str, flag: str, form: str, n: int) -> list[float]:
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != n or not all(map(math.isfinite, numbers)):
        raise UsageError(f"{flag} {quoted(text)}: expected {form}, found {len(parts)} values before the equals sign.")
    return numbers
