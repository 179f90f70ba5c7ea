"""The unit of the lengths in a calibration: by the file, by the names of its keys, or by size."""

from collections.abc import Iterable, Sequence

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
    lengths = _named(draft.get(None, name) for name in ("T", "baseline"))
    own = [value for value in lengths if value.key == key] or _poses(draft, key)
    if own:
        units = [_named_unit(value) for value in own]
    elif lengths:
        usual = [_named_unit(lengths[0], metres) for metres in UNIT_NAMES]
        units = usual if stated is None else [stated]
    else:
        return None
    fitting = [unit for unit in units if _fits(length * unit.metres, lengths)]
    if not fitting or (own and len(set(units)) > 1):
        others = [value for value in (*lengths, *own) if value.key != key]
        raise _contradiction(draft, key, length, others)
    return fitting[0]


def _named(values: Iterable[Stated | None]) -> list[Stated]:
    """The values whose keys end in their units."""
    return [value for value in values if value is not None and value.meaning.metres]


def _fits(length_m: float, lengths: Sequence[Stated]) -> bool:
    return all(agree(length_m, _length(value) * _named_unit(value).metres) for value in lengths)


def _contradiction(draft: RigDraft, key: str, length: float, others: Sequence[Stated]) -> RigError:
    keys = " and ".join((key, *(value.key for value in others)))
    lengths = " and ".join(f"{number:.4g}" for number in (length, *map(_length, others)))
    return RigError(
        f"{draft.path}: expected the lengths {keys} to agree in their units, found {lengths}; "
        "remove the wrong one."
    )


def _poses(draft: RigDraft, key: str) -> list[Stated]:
    """The positions of both cameras with their units, if the length is the distance of these."""
    if key != "T" or draft.pair_has("T", "transform"):
        return []
    return _named(value for (_, name), value in draft.stated.items() if name == "T")


def _named_unit(value: Stated, metres: float | None = None) -> Unit:
    """The unit in the name of a length, or one of `metres` by this name."""
    metres = metres or value.meaning.metres or 1.0
    return Unit(metres, f"in {UNIT_NAMES[metres]} by the name of {value.meaning.quantity.name}")


def _length(value: Stated) -> float:
    return float(np.linalg.norm(value.value))


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
