"""RigDraft: what the files of a calibration state about its cameras, each value with its file and key."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted, shortened
from track_range.foundation.schemas.validation import Integer, Number, validated
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.values.aliases import (
    Meaning,
    Quantity,
    Side,
    meaning,
    side_around,
    side_of_name,
)
from track_range.stereo.rig_formats.values.containers import (
    MAX_NUMBERS,
    calibration_text,
    plain_values,
)
from track_range.stereo.rig_formats.values.dialect import PLAIN, Dialect
from track_range.stereo.rig_formats.values.lens_models import (
    is_fisheye,
    states_model,
)
from track_range.stereo.rig_formats.values.stated import (
    Place,
    Stated,
    counting,
    is_compared,
    merged,
)

# keys with words of cameras of other images than the recorded ones
_OTHER_SET = ("rectified", "optimal", "new", "undistort")
# of the blocks of several cameras, names that are none of a camera
_NO_CAMERA = re.compile(
    r"(?:cameras?|cams?|intrinsics?|extrinsics?|calib(?:ration)?|param(?:eter)?s|sensors?|data)"
)
_FLAGS = dict.fromkeys(("true", "yes", "on", "1", "1.0"), True) | dict.fromkeys(
    ("false", "no", "off", "0", "0.0"), False
)
_PATH = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+")  # Camera.fx
# blocks with the poses of images, which are none of cameras of a pair
_OF_IMAGES = {"shots", "views", "frames", "poses", "images", "structure"}
# Gyroflow's factors of the size of anamorphic images before the lens model
_STRETCHES = ("input_horizontal_stretch", "input_vertical_stretch")
# parts of the names of values of a distortion or lens
_OF_DISTORTION = re.compile(r"dist(?!ance|rib)|coef|radial|tangential|fisheye|\bk[1-6]\b|\bp[12]\b")
# keys whose values are those of a quantity in any number, so that a wrong number is an error
_EXACT_KEYS = (
    *("M1", "D1", "M2", "D2", "K1", "K2", "R", "T"),
    *("camera_matrix", "distortion_coefficients"),
)
_EXACT_PARTS = ("intrinsics", "resolution")  # the same, of cameras

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
    # texts that state the lens model of a side, by key
    models: Mapping[Side, Mapping[str, str]] = field(default_factory=dict)
    names: Mapping[Side, str] = field(default_factory=dict)  # of the cameras' blocks, by side
    unread: tuple[str, ...] = ()  # keys of a distortion whose values are none of `Quantity`
    is_undistorted: bool = False  # whether the file states that its cameras are of such images

    def get(self, side: Side, quantity: str, *, is_own: bool = False) -> Stated | None:
        """The value of a side, else that of both sides unless `is_own`; None if there is none."""
        stated = self.stated.get((side, quantity))
        is_of_another = (None, "K") in self.stated or (None, "fx") in self.stated
        if stated is not None or is_own or (side in self.names and is_of_another):
            return stated
        return self.stated.get((None, quantity))

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
        if len(words) == 2 and not self.names:
            return words
        numbers: list[Side] = [*sorted(side for side in named if isinstance(side, int))]
        unnumbered = named - {*words, *numbers}
        others = [side for side in self.names if side in unnumbered]
        return [*words, *numbers, *others]

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
            models={**other.models, **self.models},
            names={**other.names, **self.names},
            unread=(*self.unread, *other.unread),
        )

    def of_one_side(self, side: str) -> RigDraft:
        """The draft of a file of one camera, assigned to a side."""
        stated: dict[Place, Stated] = {
            (side, quantity): value for (_, quantity), value in self.stated.items()
        }
        models = {key: text for stated in self.models.values() for key, text in stated.items()}
        return replace(self, stated=stated, models={side: models}, names={})

    def name_of(self, side: Side) -> str:
        """The name of a camera, as for --camera."""
        return self.names.get(side) or (f"camera{side}" if isinstance(side, int) else str(side))

    def stated_models(self, side: Side) -> dict[str, str]:
        """The texts that state the lens model of a camera, by key."""
        return {**self.models.get(None, {}), **self.models.get(side, {})}


def read_draft(path: Path) -> RigDraft:
    """The values of a file of any kind; raises RigError if it cannot be read."""
    return draft_of(plain_values(calibration_text(path), path), path)


def draft_of(content: Mapping[str, Any], path: Path, dialect: Dialect = PLAIN) -> RigDraft:
    """The draft of the plain values of a file, and those that are assumed for its dialect; raises
    RigError for a matrix of OpenCV that is damaged, or for values that contradict one another.
    """
    of_dialect = _Leaves(dialect.assumed, path)
    stated = {place: value._replace(key="") for place, value in of_dialect.values().items()}
    leaves = _Leaves(content, path)
    stated |= leaves.values()
    q = stated.get((None, "Q"))
    if q is not None and not any(quantity in ("K", "fx", "P") for _, quantity in stated):
        rectified = _of_reprojection(q.value)
        stated = merged(
            stated, {(None, name): q._replace(value=value) for name, value in rectified.items()}
        )
    for side in dict.fromkeys(side for side, quantity in stated if quantity == "P"):
        is_rectified_alone = (side, "R") in stated and (side, "T") not in stated
        is_of_one_camera = side is not None or not any(place[0] for place in stated)
        if is_of_one_camera and is_rectified_alone:  # as in camera_info
            stated.setdefault((side, "rect"), stated.pop((side, "R")))
    # two sides in the block of one camera are called after both
    both = [side for side, _ in stated if isinstance(side, str) and side not in ("left", "right")]
    return RigDraft(
        path,
        stated,
        tuple(dict.fromkeys(_top_keys(content))),
        dialect=dialect,
        models=of_dialect.models() | leaves.models(),
        names={**{side: side for side in both}, **leaves.names},
        unread=leaves.unread(),
        is_undistorted=leaves.is_undistorted,
    )


class _Leaf(NamedTuple):
    """A value of a file that is no mapping."""

    keys: tuple[str, ...]  # from the outside in
    value: Any
    meaning: Meaning | None

    @property
    def key(self) -> str:
        """The keys with dots."""
        return ".".join(self.keys)

    @property
    def quantity(self) -> str:
        """The name of the quantity; "" = none."""
        return "" if self.meaning is None else self.meaning.quantity.name


class _Leaves:
    """The values of a file, each with the camera that it belongs to."""

    def __init__(self, content: Mapping[str, Any], path: Path) -> None:
        self._path = path
        everything = [
            _Leaf(keys, value, meaning(keys, sum(1 for _ in _flat(value))))
            for keys, value in _leaves(content, ())
        ]
        _check_images(everything, path)
        recorded, self.is_undistorted = _of_recorded_images(everything)
        self._leaves = [
            leaf
            for leaf in recorded
            if not any(word in leaf.key.lower() for word in _OTHER_SET)
            and not (_OF_IMAGES & {*leaf.keys} and leaf.quantity in ("R", "T", "transform"))
        ]
        self._depth, self._sides = _camera_blocks(self._leaves)
        self.names = {side: name for name, side in self._sides.items()}

    def _side(self, leaf: _Leaf, stated: Side) -> Side:
        """The camera of a value that states this side: that of its block, if several have cameras."""
        is_in_block = len(leaf.keys) > self._depth + 1
        if not is_in_block or leaf.keys[self._depth] not in self._sides:
            return stated
        of_block = self._sides[leaf.keys[self._depth]]
        is_of_block = stated in (None, side_around(leaf.keys), of_block)
        return of_block if is_of_block else f"{of_block} {stated}"

    def values(self) -> dict[Place, Stated]:
        """The values whose keys name a quantity; of several, the `counting` one."""
        stated: dict[Place, list[Stated]] = {}
        for leaf in self._leaves:
            if leaf.meaning is None:
                continue
            place = self._side(leaf, leaf.meaning.side), leaf.quantity
            if place in stated and not is_compared(leaf.quantity):
                continue
            numbers = _value(leaf.value, leaf.meaning.quantity, leaf.key, self._path)
            if numbers is not None:
                value = Stated(numbers, self._path, leaf.key, leaf.meaning)
                stated.setdefault(place, []).append(value)
        return {place: counting(values) for place, values in stated.items()}

    def models(self) -> dict[Side, dict[str, str]]:
        """The texts, flags and names of blocks that state a lens model, by side and key."""
        models: dict[Side, dict[str, str]] = {}
        for leaf in self._leaves:
            texts: dict[str, str] = {}
            if states_model(leaf.key, leaf.value):
                texts[leaf.key] = str(leaf.value)
            elif leaf.quantity == "fisheye" and str(leaf.value).lower() in _FLAGS:
                texts[leaf.key] = "fisheye" if _FLAGS[str(leaf.value).lower()] else "radtan"
            elif leaf.quantity in ("K", "D"):  # fisheye: {K: ..., D: ...}
                texts = {key: key for key in leaf.keys if is_fisheye(key)}
            models.setdefault(self._side(leaf, side_around(leaf.keys)), {}).update(texts)
        return {side: texts for side, texts in models.items() if texts}

    def unread(self) -> tuple[str, ...]:
        """The keys of a distortion."""
        return tuple(
            leaf.key
            for leaf in self._leaves
            if _OF_DISTORTION.search(leaf.key.lower())
            and not isinstance(leaf.value, str | bool)
            and leaf.value not in (None, [])
        )


def _check_images(leaves: Sequence[_Leaf], path: Path) -> None:
    """Raise RigError if the values are those of a region of interest, or of stretched images."""
    sizes = {
        leaf.keys[-1]: leaf.value
        for leaf in leaves
        if leaf.keys[-1] in ("width", "height") and "roi" not in leaf.keys
    }
    whole = {"x_offset": 0, "y_offset": 0} | sizes
    for leaf in leaves:
        name, is_of_region = leaf.keys[-1], "roi" in leaf.keys[:-1]
        if is_of_region and leaf.value not in (0, whole.get(name, leaf.value)):
            raise RigError(
                f"{path}: expected the calibration of whole images, found a region of interest "
                f"({leaf.key}: {quoted(leaf.value)}); give a rig.yaml of the cropped images."
            )
        if name in _STRETCHES and leaf.value not in (None, 0, 1):
            raise RigError(
                f"{path}: expected the calibration of recorded images, found that of stretched "
                f"ones ({leaf.key}: {quoted(leaf.value)}); stretch the video, or give a rig.yaml."
            )


def _of_recorded_images(leaves: list[_Leaf]) -> tuple[list[_Leaf], bool]:
    """The values without those of rectified or undistorted images beside those of recorded ones;
    and whether all are of undistorted images, as the file states.
    """
    others = {
        leaf.keys[:-1]
        for leaf in leaves
        if leaf.keys[-1] == "is_rectified" and _FLAGS.get(str(leaf.value).lower())
    }
    originals = {
        (leaf.keys[:-1], leaf.quantity) for leaf in leaves if "original" in leaf.keys[-1].lower()
    }
    recorded = [
        leaf
        for leaf in leaves
        if "roi" not in leaf.keys
        and leaf.keys[:-1] not in others
        and (
            "original" in leaf.keys[-1].lower() or (leaf.keys[:-1], leaf.quantity) not in originals
        )
    ]
    if others and not any(leaf.quantity in ("K", "fx") for leaf in recorded):
        return leaves, True
    return recorded, False


def _camera_blocks(leaves: Sequence[_Leaf]) -> tuple[int, dict[str, Side]]:
    """The place among the keys of the blocks of several cameras, and their sides by name; {} = the
    file has no blocks that are each of one camera.

    A block has a camera matrix, or a focal length with a principal point or the size of the images.
    """
    quantities: dict[tuple[str, ...], set[str]] = {}
    for leaf in leaves:
        quantities.setdefault(leaf.keys[:-1], set()).add(leaf.quantity)
    blocks = [
        keys
        for keys, inside in quantities.items()
        if "K" in inside or ("fx" in inside and inside & {"cx", "centre", "width"})
    ]
    depth = sum(1 for _ in takewhile(lambda keys: len({*keys}) == 1, zip(*blocks, strict=False)))
    names = dict.fromkeys(keys[depth] for keys in blocks if len(keys) > depth)
    names = {name: None for name in names if not _NO_CAMERA.fullmatch(name.lower())}
    if len(names) < 2:
        return 0, {}
    stated = {name: side_of_name(name) for name in names}
    counts = Counter(stated.values())
    # names that state no side, or that of another one, too, are the sides themselves
    sides: dict[str, Side] = {
        name: name if side is None or counts[side] > 1 else side for name, side in stated.items()
    }
    return depth, sides


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
    return isinstance(value, dict) and not isinstance(value.get("data", {}), dict)


def _leaves(value: object, keys: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """(keys from the outside in, value) of all values that are not mappings, or are matrices."""
    if isinstance(value, dict) and value.keys() == {"x", "y", "z"}:
        yield keys, [value["x"], value["y"], value["z"]]
    elif isinstance(value, dict) and not _is_matrix(value):
        for key, part in value.items():
            parts = str(key).split(".") if _PATH.fullmatch(str(key)) else [str(key)]
            yield from _leaves(part, (*keys, *parts))
    elif isinstance(value, list) and value and all(isinstance(part, dict) for part in value):
        for number, part in enumerate(value):
            named = (part[key] for key in ("name", "id", "key") if key in part)
            yield from _leaves(part, (*keys, str(next(named, number))))
    elif keys:
        yield keys, value


def _value(value: Any, quantity: Quantity, key: str, path: Path) -> Any:
    """(N,) numbers of a value, or the text of a unit or model; None for other values."""
    if not quantity.counts:
        return value if isinstance(value, str) else None
    # a large matrix
    if value is None or (isinstance(value, dict) and value.get("data") == [] and "rows" in value):
        return None
    is_of_camera = isinstance(value, list) and "." in key and key.endswith(_EXACT_PARTS)
    is_exact = key in _EXACT_KEYS or is_of_camera  # a wrong number of numbers is an error
    if _is_matrix(value) and {"rows", "cols"} <= value.keys():
        numbers: FloatArray | None = _stored(value, f"{path}: {key}")
    else:
        numbers = _numbers(value)
    if numbers is None:
        if is_exact or _is_matrix(value):
            raise RigError(
                f"{path}: {key}: expected finite numbers, found {quoted(value)}; calibrate again."
            )
        return None
    if quantity.order and numbers.size in quantity.counts:
        numbers = numbers[list(quantity.order)]
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
