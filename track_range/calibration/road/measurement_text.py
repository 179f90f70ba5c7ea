"""Known metres as the command line takes them: 'T_S,X1,Y1,X2,Y2=METRES', with the box of the object at the time T_S."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted
from track_range.ranging.fitting.camera.measurements import KnownLane
from track_range.ranging.size_models.size_model import SIZE_CLASSES

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


def known_metres(distances: Sequence[str], heights: Sequence[str], widths: Sequence[str]) -> tuple[KnownMetres, ...]:
    """Measurements of objects from the texts of the options; those of equal time and box are of one object.

    Raises UsageError if a text is not a measurement, or a value is not plausible.
    """
    known: dict[str, KnownMetres] = {}
    for flag, key, texts, limits in (
        ("--known-distance", "distance_m", distances, DISTANCE_M),
        ("--known-height", "height_m", heights, SIZE_M),
        ("--known-width", "width_m", widths, SIZE_M),
    ):
        for text in texts:
            parts, (time_s, x1, y1, x2, y2), class_name, metres = _parsed(text, flag, "T_S,X1,Y1,X2,Y2", limits)
            if not (x2 > x1 and y2 > y1 and time_s >= 0):
                raise UsageError(
                    f"{flag} {quoted(text)}: expected a time and a box with X1 < X2 and Y1 < Y2 in px of the video."
                )
            place = ",".join(parts)
            before = known.get(
                place, KnownMetres(text=place, time_s=time_s, xyxy_px=(x1, y1, x2, y2), class_name=class_name)
            )
            if not math.isnan(getattr(before, key)):
                raise UsageError(f"{flag} {quoted(text)}: expected one value for this box, found two; omit one.")
            added: dict[str, Any] = {key: metres}
            known[place] = replace(before, **added)
    return tuple(known.values())


def known_lanes(texts: Sequence[str]) -> tuple[KnownLane, ...]:
    """Lane widths from the texts 'T_S,X1,X2,Y=METRES' of the option.

    Raises UsageError if a text is not a measurement, or a value is not plausible.
    """
    lanes, flag = [], "--known-lane-width"
    for text in texts:
        parts, (time_s, x1, x2, y), _, width_m = _parsed(text, flag, "T_S,X1,X2,Y", LANE_M)
        if x1 == x2:
            raise UsageError(f"{flag} {quoted(text)}: expected two different columns X1 and X2.")
        lanes.append(KnownLane(name=",".join(parts), time_s=time_s, x1_px=x1, x2_px=x2, y_px=y, width_m=width_m))
    return tuple(lanes)


def _parsed(text: str, flag: str, form: str, limits: tuple[float, float]) -> tuple[list[str], list[float], str, float]:
    """Parts before the equals sign, their numbers and the class behind them, and the metres."""
    place, equals, value = text.partition("=")
    parts = [part.strip() for part in place.split(",")]
    n_numbers = form.count(",") + 1
    class_name = parts[-1] if n_numbers == 5 and parts[-1] in SIZE_CLASSES else ""
    texts = parts[:-1] if class_name else parts
    metres = _number(value)
    if not equals or not limits[0] <= metres <= limits[1]:
        raise UsageError(
            f"{flag} {quoted(text)}: expected '{form}=METRES' with {limits[0]:g} to {limits[1]:g} m behind the equals "
            "sign."
        )
    numbers = [_number(part) for part in texts]
    if len(numbers) != n_numbers or not all(map(math.isfinite, numbers)):
        raise UsageError(
            f"{flag} {quoted(text)}: expected '{form}=METRES', found {len(texts)} values before the equals sign."
        )
    return parts, numbers, class_name, metres


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
