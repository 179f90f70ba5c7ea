"""The unit of the lengths in a calibration: by the file, by the names of its keys, or by size."""

import numpy as np

from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.values.dialect import Unit
from track_range.stereo.rig_formats.values.draft import RigDraft
from track_range.stereo.rig_formats.values.stated import UNIT_NAMES, Stated, agree

_METRES = {  # by the text of a unit
    f"{word}{plural}": metres
    for metres, words in (
        (0.001, "mm millimeter millimetre"),
        (0.01, "cm centimeter centimetre"),
        (1.0, "m meter metre"),
        (0.0254, "in inch"),
    )
    for word in words.split()
    for plural in ("", "s", "es")
}
_WIDE_M = 1.0  # of usual baselines; scripts without a square size have 2 to 5 squares
_VEHICLE_M = 2.6  # width of the widest vehicles; no baseline is longer
# length from which it is read as millimetres, and as centimetres
_MILLIMETRES, _CENTIMETRES = 30.0, 5.0


def unit_of(draft: RigDraft, length: float, key: str = "T") -> Unit:
    """The unit of the lengths in a file; `length` is the baseline in that unit, the value of `key`.

    The unit in the name of a length is that of its value, whatever the file states. RigError if
    the length contradicts another one whose name states its unit.
    """
    stated = _stated_unit(draft)
    return (
        _by_name(draft, length, key, stated)
        or stated
        or draft.dialect.usual_unit
        or _by_size(draft, length, key)
    )


def _stated_unit(draft: RigDraft) -> Unit | None:
    """The unit of all files of the dialect, or that of a key for the file."""
    metres = draft.dialect.metres_per_unit
    if metres is not None:
        return Unit(metres, f"in {UNIT_NAMES[metres]} as in all such files")
    metres = _METRES.get(str(draft.of(None, "unit") or "").strip().lower())
    return None if metres is None else Unit(metres, f"in {UNIT_NAMES[metres]} as the file states")


def _by_name(draft: RigDraft, length: float, key: str, stated: Unit | None) -> Unit | None:
    """The unit in which `length` is as long as all lengths whose keys end in their units; None
    without such a key.
    """
    named = {place: value for place, value in draft.stated.items() if value.meaning.metres}
    lengths = [named[None, name] for name in ("T", "baseline") if (None, name) in named]
    own = [value for value in lengths if value.key == key]
    if key == "T" and not draft.pair_has("T", "transform"):  # the distance of both cameras' poses
        own = [value for (_, name), value in named.items() if name == "T"]
    first = next(iter((*own, *lengths)), None)
    if first is None:
        return None
    units = {_metres(value): None for value in own}
    if len(units) > 1:
        raise _contradiction(draft, key, length, own)
    reason = ""
    if not units and stated is not None:
        units, reason = {stated.metres: None}, stated.reason
    for metres in units or (_metres(first), *UNIT_NAMES):
        if all(
            agree(length * metres, float(np.linalg.norm(value.value)) * _metres(value))
            for value in lengths
        ):
            by_name = f"in {UNIT_NAMES[metres]} by the name of {first.meaning.quantity.name}"
            return Unit(metres, reason or by_name)
    raise _contradiction(draft, key, length, [value for value in lengths if value.key != key])


def _metres(value: Stated) -> float:
    return value.meaning.metres or 1.0


def _contradiction(draft: RigDraft, key: str, length: float, others: list[Stated]) -> RigError:
    names = " and ".join(value.key for value in others)
    lengths = " and ".join(f"{np.linalg.norm(value.value):.4g}" for value in others)
    return RigError(
        f"{draft.path}: expected the lengths {key} and {names} to agree in their units, found "
        f"{length:.4g} and {lengths}; remove the wrong one."
    )


def _by_size(draft: RigDraft, length: float, key: str) -> Unit:
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
    return Unit(metres, f"since the length of {key}, {length:.4g}, is taken to be in {unit}")
