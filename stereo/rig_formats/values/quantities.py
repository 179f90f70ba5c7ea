"""The quantities of a calibration by the names that programs and people give to them.

    K  camera matrix, or fx fy cx cy     D  distortion coefficients, or k1 k2 p1 p2 k3 ...     size  of the images
    R, T  x2 = R x1 + T                  rect, P  rotation to the rectified frame, projection in it
    baseline, bf  their scalars          second_from_first, first_from_second  4 x 4 transforms

Names are compared without case and punctuation, with the side before or behind them (`K1`,
`left_camera_matrix`, `mtxR`) or around them (`cam1: {K: ...}`, `LEFT.K`). Sides are left and right,
or numbers in their order.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.foundation.schemas.validation import Integer, Number, validated
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.values.containers import (
    MAX_NUMBERS,
    calibration_text,
    plain_values,
)

_SEPARATORS = re.compile(r"[^a-z0-9]")
_SIDES = r"left|right|l|r|\d{1,3}"
_AROUND = re.compile(  # a key whose values are of one camera
    rf"(?:cam|camera|camerainfo|sensor|view|infrared|infra|ir|mono|intrinsics?|params|calib)?({_SIDES})"
    r"(?:cam|camera|camerainfo|image|img|infrared|ir|intrinsics?|params|parameters|sensor|calib|calibration|lens)?"
    rf"|cameraparameters(\d)"
)
_SIDE_WORDS = ("left", "right", "l", "r", *map(str, range(10)))
_AFFIXES = {  # before or behind the name of a quantity -> the side
    form: word
    for word in _SIDE_WORDS
    for form in (
        word,
        f"cam{word}",
        f"camera{word}",
        f"{word}cam",
        f"{word}camera",
        f"of{word}",
        f"ofcamera{word}",
    )
}
_NAMES: dict[str, str] = {
    "K": "k m a camera cameramatrix cammatrix cameramat cammat cam cammats mtx matrix mat intrinsic intrinsics kmat kk"
    " cm intrinsicmatrix intrinsicsmatrix intrinsicmat intrinsicparameters cameraintrinsics cameraintrinsic kmatrix"
    " projectionparameters",
    "D": "d dist distcoeffs distcoeff distcoefs distcoef distortion distortioncoefficients distortioncoefficient kc"
    " coeffs distortioncoeffs distortioncoeff distortioncoefs distcoefficients cameradistcoeff cameradistcoeffs dcoeffs"
    " distortionvector distortionmatrix distmatrix distortionparameters distortionparams",
    "radial": "radialdistortion",
    "tangential": "tangentialdistortion",
    "R": "r rot rotation rotationmatrix rotmat rotmatrix rmat rmatrix rvec rotationvector om stereor stereorotation"
    " relativerotation rotationbetweencameras rlefttoright",
    "T": "t trans transl translation translationvector translationmatrix transvec tvec tvector tmat stereot trns"
    " stereotranslation relativetranslation tlefttoright translationofcamera2",
    "R_transposed": "rotationofcamera2",
    "rect": "rect rrect recttrans recttransform rectify rectification rectificationmatrix rectrotation"
    " rectifiedrotation",
    "P": "p proj projection projectionmatrix projmat projmats projmatrix prect",
    "Q": "q disparitytodepth disptodepth disptodepthmatrix disptodepthmat reprojection reprojectionmatrix",
    "second_from_first": "tc2c1 trl t21 trightleft rightfromleft tcncnm1 lefttoright extrinsic extrinsics",
    "first_from_second": "tc1c2 tlr t12 tleftright leftfromright righttoleft",
    "baseline": "baseline b stereob stereobaseline baselinem baselinemm baselinecm",
    "bf": "bf camerabf stereobf",
    "fx": "fx f focal focallength focallengthpx focallengthx focalx fxpx fu gamma1 fc",
    "fy": "fy focallengthy focaly fypx fv gamma2",
    "cx": "cx u0 ppx pu cu cxpx principalpointx centerx opticalcenterx",
    "cy": "cy v0 ppy pv cv cypx principalpointy centery opticalcentery",
    "centre": "cc principalpoint opticalcenter opticalcentre",
    "width": "width imagewidth imgwidth imagewidthpx widthpx cols w nx",
    "height": "height imageheight imgheight imageheightpx heightpx rows h ny",
    "size": "size imagesize imgsize imsize resolution imageshape imgshape shape imageresolution wh",
    "square": "squaresize squaresizemm squarelength squarewidth square chessboardsquaresize checkersize",
    "fisheye": "fisheyemodel isfisheye",
    "unit": "worldunits units unit lengthunit",
    "model": "cameratype distortionmodel modeltype model cameramodel type",
}
_QUANTITY = {name: quantity for quantity, names in _NAMES.items() for name in names.split()}
_SCALARS = "k1 k2 k3 k4 k5 k6 p1 p2".split()
_OF_PAIR = (
    "R_transposed second_from_first first_from_second baseline bf Q square unit fisheye".split()
)
_OF_SECOND_CAMERA = ("rotationofcamera2", "translationofcamera2")  # in words of MATLAB; of the pair
_UNIT_ENDING = re.compile(r"(?<=.{4})(?:mm|cm)$")
_COUNTS = {  # possible numbers of values
    "K": (9, 4), "D": (0, 1, 2, 4, 5, 8, 12, 14), "radial": (2, 3), "tangential": (2,), "R": (9, 3),
    "R_transposed": (9,), "T": (3,), "rect": (9,), "P": (12, 9), "Q": (16,), "second_from_first": (16, 12),
    "first_from_second": (16, 12), "fx": (1, 2), "centre": (2,), "size": (2, 3),
}  # fmt: skip
# a key whose values are between two cameras or streams
_BETWEEN = re.compile(r"(?:from)?(.+?)to(.+)")
# keys of cameras of other images than the recorded ones
_OTHER_SET = re.compile(r"rectified|optimal|new|undistort")
_KNOWN_MATRICES = (
    "M1",
    "D1",
    "M2",
    "D2",
    "K1",
    "K2",
    "R",
    "T",
    "camera_matrix",
    "distortion_coefficients",
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
Side = str | int | None  # "left", "right", a number, or None for both cameras


class Quantities(NamedTuple):
    """Values of a calibration by side and quantity, and the keys of the file."""

    values: dict[tuple[Side, str], Any]  # arrays (N,), texts of "unit" and "model"
    keys: tuple[str, ...]  # names of all values in the file, in its order
    names: dict[tuple[Side, str], str]  # key of each value

    def of(self, side: Side, quantity: str) -> Any:
        """The value of a side, else of both sides; None if there is none."""
        return self.values.get((side, quantity), self.values.get((None, quantity)))

    def has(self, *quantities: str) -> bool:
        """Whether one of these quantities is known for any side."""
        return any(quantity in quantities for _, quantity in self.values)

    def __or__(self, other: Quantities) -> Quantities:
        """These quantities, completed by `other`."""
        return Quantities(
            {**other.values, **self.values},
            tuple(dict.fromkeys((*self.keys, *other.keys))),
            {**other.names, **self.names},
        )

    def of_one_side(self, side: str) -> Quantities:
        """The quantities of a file of one camera, assigned to a side."""
        return self._replace(
            values={(side, quantity): value for (_, quantity), value in self.values.items()},
            names={(side, quantity): name for (_, quantity), name in self.names.items()},
        )

    def sides(self) -> list[Side]:
        """The sides of the file's cameras, the first (left, or with the smaller number) first; [] =
        no named side.
        """
        named = {side for side, quantity in self.values if quantity in ("K", "fx", "P")}
        words: list[Side] = [side for side in ("left", "right") if side in named]
        if len(words) == 2:
            return words
        return [*words, *sorted(side for side in named if isinstance(side, int))]


def quantities_of(content: Mapping[str, Any], source: object) -> Quantities:
    """The quantities in plain values; raises RigError for a matrix of OpenCV that is damaged."""
    named = _named_values(content, source)
    values = named.values
    transposed = values.get((None, "R_transposed"))
    if transposed is not None:  # MATLAB's
        values[None, "R"] = transposed.reshape(3, 3).T.ravel()
    q = values.get((None, "Q"))
    if q is not None and not named.has("K", "fx", "P"):
        values.update({**_of_reprojection(q), **values})
    for side in dict.fromkeys(side for side, quantity in values if quantity == "P"):
        is_rectified_alone = (side, "R") in values and (side, "T") not in values
        if side is not None and is_rectified_alone:  # as in camera_info
            values.setdefault((side, "rect"), values.pop((side, "R")))
    return named


def _named_values(content: Mapping[str, Any], source: object) -> Quantities:
    """The values whose keys name a quantity; of several, the first."""
    named = Quantities({}, tuple(dict.fromkeys(_top_keys(content))), {})
    for path, value in _leaves(content, ()):
        key = ".".join(path)
        if _OTHER_SET.search(key.lower()):
            continue
        side, quantity = _place(path, value)
        direction = _direction(path) if quantity in ("R", "T") else None
        if direction is not None:
            # of other streams, such as depth to colour
            if not direction or (None, quantity) in named.values:
                continue
            side = None
            named.values[None, "inverse"] = direction < 0
        if quantity is None or (side, quantity) in named.values:
            continue
        numbers = _value(value, quantity, key, source)
        if numbers is not None:
            named.values[side, quantity] = numbers
            named.names[side, quantity] = key
    return named


def _of_reprojection(q: FloatArray) -> dict[tuple[Side, str], FloatArray]:
    """Camera matrix and baseline of rectified images by OpenCV's Q (16,), [[1, 0, 0, -cx],
    [0, 1, 0, -cy], [0, 0, 0, f], [0, 0, -1 / Tx, 0]]; none for another matrix.
    """
    focal_px, inverse_baseline = q[11], q[14]
    if not inverse_baseline or not focal_px > 0:
        return {}
    return {
        (None, "K"): np.array([focal_px, focal_px, -q[3], -q[7]]),
        (None, "baseline"): np.array([abs(1.0 / inverse_baseline)]),
    }


def read_quantities(path: Path) -> Quantities:
    """The quantities of a file; raises RigError if it cannot be read."""
    return quantities_of(plain_values(calibration_text(path), path), path)


def _top_keys(content: Mapping[str, Any]) -> Iterator[str]:
    for key, value in content.items():
        if isinstance(value, dict) and not _is_matrix(value) and len(content) <= 3:
            yield from (f"{key}.{part}" for part in value)
        else:
            yield str(key)


def _is_matrix(value: object) -> bool:
    return isinstance(value, dict) and "data" in value


def _leaves(value: object, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """(keys from the outside in, value) of all values that are not mappings, or are matrices."""
    if isinstance(value, dict) and value.keys() == {"x", "y", "z"}:
        yield path, [value["x"], value["y"], value["z"]]
    elif isinstance(value, dict) and not _is_matrix(value):
        for key, part in value.items():
            yield from _leaves(part, (*path, *str(key).split(".")))
    elif isinstance(value, list) and value and all(isinstance(part, dict) for part in value):
        for number, part in enumerate(value):
            yield from _leaves(part, (*path, str(part.get("name", part.get("id", number)))))
    elif path:
        yield path, value


def _place(path: tuple[str, ...], value: Any) -> tuple[Side, str | None]:
    """The side and the quantity of a value by its keys; None if the keys name no quantity."""
    words = [_SEPARATORS.sub("", key.lower()) for key in path]
    name = words[-1]
    # camera_matrix: {left: ...}
    if len(words) > 1 and words[-2] in _QUANTITY and re.fullmatch(_SIDES, name):
        return _word_side(name), _QUANTITY[words[-2]]
    n_values = sum(1 for _ in _flat(value))
    around = [match for word in words[:-1] if (match := _AROUND.fullmatch(word))]
    side = _side_of(around[-1]) if around else None
    if name in _SCALARS and n_values == 1:
        return side, name
    if name not in _QUANTITY:
        name = _UNIT_ENDING.sub("", name)
    if name in _QUANTITY:
        return None if name in _OF_SECOND_CAMERA else side, _QUANTITY[name]
    return _place_by_affix(name, n_values)


def _place_by_affix(name: str, n_values: int) -> tuple[Side, str | None]:
    """The side and the quantity of a name that begins or ends with its side."""
    for affix, word in _AFFIXES.items():
        stems = (name.removeprefix(affix), name.removesuffix(affix))
        quantities = [_QUANTITY[stem] for stem in stems if stem != name and stem in _QUANTITY]
        if not quantities or quantities[0] in _OF_PAIR:
            continue
        is_rectification = quantities[0] == "R" and n_values == 9
        return _word_side(word), "rect" if is_rectification else quantities[0]
    return None, None


def _direction(path: tuple[str, ...]) -> int | None:
    """Direction in a key: 1 = from the first camera to the second, -1 = reverse, 0 = other cameras;
    None = no key.
    """
    for key in path[:-1]:
        if match := _BETWEEN.fullmatch(_SEPARATORS.sub("", key.lower())):
            sides = [_side_of(_AROUND.fullmatch(word)) for word in match.groups()]
            if None in sides or isinstance(sides[0], str) != isinstance(sides[1], str):
                return 0
            return 1 if str(sides[0]) < str(sides[1]) else -1
    return None


def _side_of(match: re.Match[str] | None) -> Side:
    return None if match is None else _word_side(next(filter(None, match.groups())))


def _word_side(word: str) -> Side:
    if word.isdecimal():
        return int(word)
    return {"l": "left", "r": "right"}.get(word, word)


def _value(value: Any, quantity: str, key: str, source: object) -> Any:
    """(N,) numbers of a value, or the text of a unit or model; None for other values."""
    if quantity in ("unit", "model"):
        return value if isinstance(value, str) else None
    # a large matrix
    if value is None or (isinstance(value, dict) and value.get("data") == [] and "rows" in value):
        return None
    is_strict = key in _KNOWN_MATRICES
    if _is_matrix(value) and {"rows", "cols"} <= value.keys():
        numbers: FloatArray | None = _stored(value, f"{source}: {key}")
    else:
        numbers = _numbers(value)
    if numbers is None:
        if is_strict or _is_matrix(value):
            raise RigError(
                f"{source}: {key}: expected numbers, found {quoted(value)}; calibrate again."
            )
        return None
    return numbers if is_strict or numbers.size in _COUNTS.get(quantity, (1,)) else None


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
