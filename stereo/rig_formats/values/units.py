"""The unit of the lengths in a calibration: by the file, by the names of its keys, or by size."""

import numpy as np

from track_range.stereo.rig_formats.values.dialect import Unit
from track_range.stereo.rig_formats.values.draft import RigDraft

UNIT_NAMES = {0.001: "millimetres", 0.01: "centimetres", 1.0: "metres", 0.0254: "inches"}
TOLERANCE = 0.02  # largest relative difference of lengths, and difference of rotations, that agree

_METRES = {  # by the text of a unit, without an s at its end
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


def unit_of(draft: RigDraft, length: float) -> Unit:
    """The unit of the lengths in a file; `length` is the baseline in that unit."""
    dialect = draft.dialect
    if dialect.metres_per_unit is not None:
        reason = f"in {UNIT_NAMES[dialect.metres_per_unit]} as in all such files"
        return Unit(dialect.metres_per_unit, reason)
    stated = str(draft.of(None, "unit") or "").lower().rstrip("s").replace("metre", "meter")
    if stated in _METRES:
        metres = _METRES[stated]
        return Unit(metres, f"in {UNIT_NAMES[metres]} as the file states")
    return _by_name(draft, length) or dialect.usual_unit or _by_size(draft, length)


def _by_name(draft: RigDraft, length: float) -> Unit | None:
    """The unit in which `length` is as long as a length whose key ends in its unit."""
    for quantity in ("T", "baseline"):
        named = draft.named_length(quantity)
        named_metres = None if named is None else named.meaning.metres
        if named is None or named_metres is None:
            continue
        stated = length if quantity == "T" else float(np.abs(named.value[0]))
        for metres in (named_metres, 1.0, 0.01, 0.001):
            if abs(length * metres - stated * named_metres) < TOLERANCE * stated * named_metres:
                return Unit(metres, f"in {UNIT_NAMES[metres]} by the name of {quantity}")
    return None


def _by_size(draft: RigDraft, length: float) -> Unit:
    if length <= _VEHICLE_M:
        is_of_board = draft.pair_has("T")
        reason = "that the square size was given in metres" if is_of_board else "metres"
        if length > _WIDE_M:
            reason += "; a wide baseline: if T counts squares, multiply T by the side of a square"
        return Unit(1.0, f"assuming {reason}")
    if length <= _CENTIMETRES:
        return Unit(1.0, "in doubt", is_doubtful=True)
    square = draft.of(None, "square")
    is_square_in_mm = square is not None and float(square[0]) > _CENTIMETRES
    metres, also = 0.001, ""
    if not (length >= _MILLIMETRES or is_square_in_mm):
        metres = 0.01
        also = f" (in millimetres it would be {length * 0.001:.3g} m: rig convert --unit mm)"
    unit = f"{UNIT_NAMES[metres]}{also}"
    return Unit(metres, f"since the length of T, {length:.4g}, is taken to be in {unit}")
