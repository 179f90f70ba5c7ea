"""RigDraft: what the files of a calibration state about its cameras, each value with its file and key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted, shortened
from track_range.foundation.schemas.validation import Integer, Number, validated
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.values.aliases import Quantity, Side, meaning
from track_range.stereo.rig_formats.values.containers import (
    MAX_NUMBERS,
    calibration_text,
    plain_values,
)
from track_range.stereo.rig_formats.values.dialect import PLAIN, Dialect
from track_range.stereo.rig_formats.values.stated import (
    Place,
    Stated,
    counting,
    is_compared,
    merged,
)

# keys with words of cameras of other images than the recorded ones
_OTHER_SET = ("rectified", "optimal", "new", "undistort")
# keys whose values are those of a quantity in any number, so that a wrong number is an error
_EXACT_KEYS = (
    *("M1", "D1", "M2", "D2", "K1", "K2", "R", "T"),
    *("camera_matrix", "distortion_coefficients"),
)

_MAX_SIDE = 14  # largest number of rows or columns; OpenCV has at most 14 distortion coefficients
_Value = Annotated[Number, Field(ge=-1e12, le=1e12)]  # products of larger ones would overflow
_Side = Annotated[Integer, Field(ge=1, le=_MAX_SIDE)]


class _Matrix(BaseModel):
    """A matrix in FileStorage, row by row; dt is the type of the numbers: d and f are float64 and
    float32.
    """

    rows: _Side
    cols: _Side
    dt: Literal["d", "f", "i", "u", "w", "s", "c"] = "d"
    data: Annotated[list[_Value], Field(max_length=MAX_NUMBERS)]


_NUMBERS: TypeAdapter[list[float]] = TypeAdapter(
    Annotated[list[_Value], Field(max_length=MAX_NUMBERS)]
)


@dataclass(frozen=True, slots=True)
class RigDraft:
    """The values of a calibration that its files state, by side and quantity."""

    path: Path  # the file that was given
    stated: Mapping[Place, Stated]
    keys: tuple[str, ...]  # names of all values of the files, in their order
    beside: tuple[Path, ...] = ()  # the files that complete it
    dialect: Dialect = PLAIN

    def get(self, side: Side, quantity: str, *, is_own: bool = False) -> Stated | None:
        """The value of a side, else that of both sides unless `is_own`; None if there is none."""
        stated = self.stated.get((side, quantity))
        return self.stated.get((None, quantity)) if stated is None and not is_own else stated

    def of(self, side: Side, quantity: str) -> Any:
        """The content of `get`."""
        stated = self.get(side, quantity)
        return None if stated is None else stated.value

    def own(self, side: Side, quantity: str) -> Any:
        """The content of `get` for this side alone."""
        stated = self.get(side, quantity, is_own=True)
        return None if stated is None else stated.value

    def has(self, *quantities: str) -> bool:
        """Whether one of these quantities is known for any side."""
        return any(quantity in quantities for _, quantity in self.stated)

    def pair_has(self, *quantities: str) -> bool:
        """Whether one of these quantities is known for the pair, not for one side."""
        return any(self.get(None, quantity) is not None for quantity in quantities)

    @property
    def sides(self) -> list[Side]:
        """The sides of the cameras, the first (left, or with the smaller number) first; [] = no
        named side.
        """
        named = {side for side, quantity in self.stated if quantity in ("K", "fx", "P")}
        words: list[Side] = [side for side in ("left", "right") if side in named]
        if len(words) == 2:
            return words
        return [*words, *sorted(side for side in named if isinstance(side, int))]

    @property
    def has_two_cameras(self) -> bool:
        """Whether two cameras are named."""
        return len(self.sides) >= 2

    @property
    def pair(self) -> tuple[Side, Side]:
        """The sides of both cameras; camera 2 follows a single one."""
        first, second = (*self.sides, None, None)[:2]
        return first, second if self.has_two_cameras else 2

    @property
    def has_extrinsics(self) -> bool:
        """Whether R or T, or a transform, is known."""
        return self.has("R", "T", "transform")

    @property
    def title(self) -> str:
        """The kind and the other files, for messages."""
        if not self.beside:
            return self.dialect.title
        return f"{self.dialect.title} with {' and '.join(file.name for file in self.beside)}"

    @property
    def listed_keys(self) -> str:
        """The first keys, for messages."""
        return shortened(", ".join(self.keys[:12]), 60)

    def __or__(self, other: RigDraft) -> RigDraft:
        """This draft, completed by the values of `other`; RigError if both contradict one another."""
        return replace(
            self,
            stated=merged(self.stated, other.stated),
            keys=tuple(dict.fromkeys((*self.keys, *other.keys))),
            beside=(*self.beside, other.path, *other.beside),
        )

    def of_one_side(self, side: str) -> RigDraft:
        """The draft of a file of one camera, assigned to a side."""
        return replace(
            self, stated={(side, quantity): value for (_, quantity), value in self.stated.items()}
        )


def read_draft(path: Path) -> RigDraft:
    """The values of a file of any kind; raises RigError if it cannot be read."""
    return draft_of(plain_values(calibration_text(path), path), path)


def draft_of(content: Mapping[str, Any], path: Path, dialect: Dialect = PLAIN) -> RigDraft:
    """The draft of the plain values of a file, and those that are assumed for its dialect; raises
    RigError for a matrix of OpenCV that is damaged, or for values that contradict one another.
    """
    assumed = _stated_values(dialect.assumed, path)
    stated = {place: value._replace(key="") for place, value in assumed.items()}
    stated |= _stated_values(content, path)
    q = stated.get((None, "Q"))
    if q is not None and not any(quantity in ("K", "fx", "P") for _, quantity in stated):
        rectified = _of_reprojection(q.value)
        stated = merged(
            stated, {(None, name): q._replace(value=value) for name, value in rectified.items()}
        )
    for side in dict.fromkeys(side for side, quantity in stated if quantity == "P"):
        is_rectified_alone = (side, "R") in stated and (side, "T") not in stated
        if side is not None and is_rectified_alone:  # as in camera_info
            stated.setdefault((side, "rect"), stated.pop((side, "R")))
    return RigDraft(path, stated, tuple(dict.fromkeys(_top_keys(content))), dialect=dialect)


def _stated_values(content: Mapping[str, Any], path: Path) -> dict[Place, Stated]:
    """The values whose keys name a quantity; of several, the `counting` one."""
    stated: dict[Place, list[Stated]] = {}
    for keys, value in _leaves(content, ()):
        key = ".".join(keys)
        understood = meaning(keys, sum(1 for _ in _flat(value)))
        if understood is None or any(word in key.lower() for word in _OTHER_SET):
            continue
        place = understood.side, understood.quantity.name
        if place in stated and not is_compared(understood.quantity.name):
            continue
        numbers = _value(value, understood.quantity, key, path)
        if numbers is not None:
            stated.setdefault(place, []).append(Stated(numbers, path, key, understood))
    return {place: counting(values) for place, values in stated.items()}


def _of_reprojection(q: FloatArray) -> dict[str, FloatArray]:
    """Camera matrix and baseline of rectified images by OpenCV's Q (16,), [[1, 0, 0, -cx],
    [0, 1, 0, -cy], [0, 0, 0, f], [0, 0, -1 / Tx, 0]]; none for another matrix.
    """
    focal_px, inverse_baseline = q[11], q[14]
    if not inverse_baseline or not focal_px > 0:
        return {}
    return {
        "K": np.array([focal_px, focal_px, -q[3], -q[7]]),
        "baseline": np.array([abs(1.0 / inverse_baseline)]),
    }


def _top_keys(content: Mapping[str, Any]) -> Iterator[str]:
    for key, value in content.items():
        if isinstance(value, dict) and not _is_matrix(value) and len(content) <= 3:
            yield from (f"{key}.{part}" for part in value)
        else:
            yield str(key)


def _is_matrix(value: object) -> bool:
    return isinstance(value, dict) and "data" in value


def _leaves(value: object, keys: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """(keys from the outside in, value) of all values that are not mappings, or are matrices."""
    if isinstance(value, dict) and value.keys() == {"x", "y", "z"}:
        yield keys, [value["x"], value["y"], value["z"]]
    elif isinstance(value, dict) and not _is_matrix(value):
        for key, part in value.items():
            yield from _leaves(part, (*keys, *str(key).split(".")))
    elif isinstance(value, list) and value and all(isinstance(part, dict) for part in value):
        for number, part in enumerate(value):
            yield from _leaves(part, (*keys, str(part.get("name", part.get("id", number)))))
    elif keys:
        yield keys, value


def _value(value: Any, quantity: Quantity, key: str, path: Path) -> Any:
    """(N,) numbers of a value, or the text of a unit or model; None for other values."""
    if not quantity.counts:
        return value if isinstance(value, str) else None
    # a large matrix
    if value is None or (isinstance(value, dict) and value.get("data") == [] and "rows" in value):
        return None
    is_exact = key in _EXACT_KEYS
    if _is_matrix(value) and {"rows", "cols"} <= value.keys():
        numbers: FloatArray | None = _stored(value, f"{path}: {key}")
    else:
        numbers = _numbers(value)
    if numbers is None:
        if is_exact or _is_matrix(value):
            raise RigError(
                f"{path}: {key}: expected numbers, found {quoted(value)}; calibrate again."
            )
        return None
    if quantity.is_transposed and numbers.size in quantity.counts:
        numbers = numbers.reshape(3, 3).T.ravel()
    return numbers if is_exact or numbers.size in quantity.counts else None


def _stored(value: dict[str, Any], name: str) -> FloatArray:
    """(N,) numbers of a matrix in FileStorage, rounded as OpenCV rounds them."""
    matrix = validated(_Matrix, value, name, RigError)
    if len(matrix.data) != matrix.rows * matrix.cols:
        raise RigError(
            f"{name}: expected {matrix.rows} x {matrix.cols} numbers, found {len(matrix.data)}; calibrate again."
        )
    return np.array(matrix.data, np.float32 if matrix.dt == "f" else np.float64).astype(np.float64)


def _numbers(value: Any) -> FloatArray | None:
    """(N,) numbers of nested lists, of {x, y, z}, of a text or of a number; None for other
    values.
    """
    try:
        return np.array(_NUMBERS.validate_python(list(_flat(value))), np.float64)
    except ValidationError:
        return None


def _flat(value: Any) -> Iterator[Any]:
    """The values of nested lists, of the data of a matrix, or the words of a text."""
    value = value.get("data") if isinstance(value, dict) else value
    if isinstance(value, list):
        for part in value[: MAX_NUMBERS + 1]:
            yield from _flat(part) if isinstance(part, list) else (part,)
    else:
        yield from value.split() if isinstance(value, str) else (value,)
