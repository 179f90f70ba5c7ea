"""The unit of the lengths in a calibration: by the file, by the names of its keys, or by size."""

from typing import NamedTuple

from track_range.stereo.rig_formats.values.quantities import Quantities

UNIT_NAMES = {0.001: "millimetres", 0.01: "centimetres", 1.0: "metres", 0.0254: "inches"}
TOLERANCE = 0.02  # largest relative difference of lengths, and difference of rotations, that agree

_METRES = {
    "mm": 0.001,
    "millimeter": 0.001,
    "cm": 0.01,
    "centimeter": 0.01,
    "m": 1.0,
    "meter": 1.0,
    "in": 0.0254,
}
_WIDE_M = 1.0  # of usual baselines; scripts without a square size have 2 to 5 squares
_VEHICLE_M = 2.6  # width of the widest vehicles; no baseline is longer
# |T| from which it is read as millimetres, and as centimetres
_MILLIMETRES, _CENTIMETRES = 30.0, 5.0


class Unit(NamedTuple):
    """Metres per unit of the lengths in a file."""

    metres: float
    reason: str  # for messages
    is_doubtful: bool = False


def unit_of(given: Quantities, length: float, usual: Unit | None = None) -> Unit:
    """The unit of the lengths in a file; `length` is the baseline in that unit, `usual` the unit of
    a file that states none, None = by the size of `length`.
    """
    stated = str(given.of(None, "unit") or "").lower().rstrip("s").replace("metre", "meter")
    if stated in _METRES:
        metres = _METRES[stated]
        return Unit(metres, f"in {UNIT_NAMES[metres]} as the file states")
    return _by_name(given, length) or usual or _by_size(given, length)


def _by_name(given: Quantities, length: float) -> Unit | None:
    """The unit in which `length` is as long as a length whose key ends in its unit."""
    baseline = given.of(None, "baseline")
    lengths = {"T": length, "baseline": length if baseline is None else abs(float(baseline[0]))}
    for quantity, value in lengths.items():
        ending = given.names.get((None, quantity), "").lower().rpartition("_")[2]
        named = _METRES.get(ending, 0.0)
        length_m = named * value
        if not length_m:
            continue
        for metres in (named, 1.0, 0.01, 0.001):
            if abs(length * metres / length_m - 1) < TOLERANCE:
                return Unit(metres, f"in {UNIT_NAMES[metres]} by the name of {quantity}")
    return None


def _by_size(given: Quantities, length: float) -> Unit:
    if length <= _VEHICLE_M:
        is_of_board = (None, "T") in given.values
        reason = "that the square size was given in metres" if is_of_board else "metres"
        if length > _WIDE_M:
            reason += "; a wide baseline: if T counts squares, multiply T by the side of a square"
        return Unit(1.0, f"assuming {reason}")
    if length <= _CENTIMETRES:
        return Unit(1.0, "in doubt", is_doubtful=True)
    square = given.of(None, "square")
    is_square_in_mm = square is not None and float(square[0]) > _CENTIMETRES
    metres, also = 0.001, ""
    if not (length >= _MILLIMETRES or is_square_in_mm):
        metres = 0.01
        also = f" (in millimetres it would be {length * 0.001:.3g} m: rig convert --unit mm)"
    name = UNIT_NAMES[metres]
    return Unit(metres, f"since the length of T, {length:.4g}, is taken to be in {name}{also}")
