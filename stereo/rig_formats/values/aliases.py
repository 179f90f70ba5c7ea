"""The names of the quantities of a calibration in the files of programs and people, and their units.

    K  camera matrix, or fx fy cx cy     D  distortion coefficients, or k1 k2 p1 p2 k3 ...     size  of the images
    R, T  x2 = R x1 + T                  rect, P  rotation to the rectified frame, projection in it
    baseline, bf  their scalars          transform  from camera 1 to camera 2, 4 x 4 or 3 x 4

Names are compared without case and punctuation, with the side before or behind them (`K1`,
`left_camera_matrix`, `mtxR`) or around them (`cam1: {K: ...}`, `LEFT.K`). Sides are left and right,
or numbers in their order. The name of a length may end with its unit (`T_mm`, `baseline_cm`).
"""

import re
from typing import Literal, NamedTuple

Side = str | int | None  # "left", "right", a number, or None for both cameras


class Quantity(NamedTuple):
    """A quantity of a calibration: one row of `QUANTITIES`."""

    name: str
    aliases: str  # its names in files, in lower case without punctuation
    counts: tuple[int, ...] = (1,)  # possible numbers of values; () = a text
    is_length: bool = False  # whether the name may end with the unit of its values
    is_inverse: bool = False  # whether a transform is that from the second camera to the first
    order: tuple[int, ...] = ()  # places of the values in OpenCV's order; () = as they are
    # where the side of its camera stands: in the name, else in the block around it; only in the block
    side_in: Literal["name", "block", "nothing"] = "name"


class Meaning(NamedTuple):
    """What the keys of a value state about it."""

    side: Side
    quantity: Quantity
    metres: float | None = None  # per unit of its values; None = not stated
    is_inverse: bool = False  # as of the quantity, or of the block of R and T


QUANTITIES = (
    Quantity("K", "k m a camera cameramatrix cammatrix cameramat cammat cam cammats mtx matrix mat intrinsic"
             " intrinsics kmat kk cm intrinsicmatrix intrinsicsmatrix intrinsicmat intrinsicparameters"
             " cameraintrinsics cameraintrinsic kmatrix projectionparameters camk cammatrixoriginal"
             " cameramatrixoriginal originalcameramatrix", (9, 4, 12)),
    Quantity("D", "d dist distcoeffs distcoeff distcoefs distcoef distortion distortioncoefficients"
             " distortioncoefficient kc coeffs distortioncoeffs distortioncoeff distortioncoefs distcoefficients"
             " cameradistcoeff cameradistcoeffs dcoeffs distortionvector distortionmatrix distmatrix"
             " distortionparameters distortionparams camd fisheyeparams distoparam", (0, 1, 2, 3, 4, 5, 8, 12, 14)),
    Quantity("D", "distot2", (5,), order=(0, 1, 3, 4, 2)),  # OpenMVG's k1 k2 k3 p1 p2
    Quantity("radial", "radialdistortion distok1 distok3", (1, 2, 3)),
    Quantity("tangential", "tangentialdistortion", (2,)),
    Quantity("R", "r rot rotation rotationmatrix rotmat rotmatrix rmat rmatrix rvec rotationvector om stereor"
             " stereorotation relativerotation rotationbetweencameras rlefttoright", (9, 3)),
    Quantity("T", "t trans transl translation translationvector translationmatrix transvec tvec tvector tmat stereot"
             " trns stereotranslation relativetranslation tlefttoright", (3,), is_length=True),
    Quantity("T", "translationofcamera2", (3,), is_length=True, side_in="nothing"),  # MATLAB's
    # MRPT's pose of the right camera, in the block LEFT2RIGHT_POSE
    Quantity("T", "translationonly", (3,), is_length=True, is_inverse=True, side_in="nothing"),
    Quantity("R", "rotationmatrixonly", (9,), is_inverse=True, side_in="nothing"),
    Quantity("R", "rotationofcamera2", (9,), order=(0, 3, 6, 1, 4, 7, 2, 5, 8), side_in="nothing"),
    Quantity("rect", "rect rrect recttrans recttransform rectify rectification rectificationmatrix rectrotation"
             " rectifiedrotation", (9,)),
    Quantity("P", "p proj projection projectionmatrix projmat projmats projmatrix prect", (12, 9)),
    Quantity("Q", "q disparitytodepth disptodepth disptodepthmatrix disptodepthmat reprojection reprojectionmatrix",
             (16,), side_in="block"),
    Quantity("transform", "tc2c1 trl t21 trightleft rightfromleft tcncnm1 lefttoright extrinsic extrinsics",
             (16, 12), side_in="block"),
    Quantity("transform", "tc1c2 tlr t12 tleftright leftfromright righttoleft", (16, 12), is_inverse=True,
             side_in="block"),
    # pose of a camera in the frame of a body, x_body = T x_camera, and its inverse
    Quantity("body", "tsc tbs tbc timucam bodytcam tbodycam", (16, 12), side_in="block"),
    Quantity("body", "tcamimu tcambody tcamref tcb", (16, 12), is_inverse=True, side_in="block"),
    Quantity("baseline", "baseline b stereob stereobaseline", is_length=True, side_in="block"),
    Quantity("bf", "bf camerabf stereobf focalxbaseline", side_in="block"),
    Quantity("fx", "fx f focal focallength focallengthpx focallengthx focallengthxpx focalx flx fxpx fu gamma1"
             " mu fc", (1, 2)),
    Quantity("fy", "fy focallengthy focallengthypx focaly fly fypx fv gamma2 mv"),
    Quantity("cx", "cx u0 ppx pu cu cxpx principalpointx centerx opticalcenterx focalcenterxpx"),
    Quantity("cy", "cy v0 ppy pv cv cypx principalpointy centery opticalcentery focalcenterypx"),
    Quantity("centre", "cc principalpoint opticalcenter opticalcentre", (2,)),
    Quantity("width", "width imagewidth imgwidth imagewidthpx widthpx cols w nx"),
    Quantity("height", "height imageheight imgheight imageheightpx heightpx rows h ny"),
    Quantity("size", "size imagesize imgsize imsize resolution imageshape imgshape shape imageresolution wh"
             " imagedimension imagedimensions imagersize", (2, 3)),
    Quantity("square", "squaresize squarelength squarewidth square chessboardsquaresize checkersize",
             is_length=True, side_in="block"),
    Quantity("fisheye", "fisheyemodel isfisheye fisheye bfisheye usefisheye", side_in="block"),
    Quantity("depth_scale", "depthmapfactor", side_in="block"),  # of a camera whose second image is depth
    Quantity("unit", "worldunits units unit lengthunit", (), side_in="block"),
    Quantity("skew", "skew b2", side_in="block"),
    Quantity("b1", "b1", side_in="block"),  # Agisoft's fx - fy
    *(
        Quantity(name, name, side_in="block")
        for name in ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "p3", "p4", "xi", "alpha")
    ),
)  # fmt: skip
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # in OpenCV's order
UNITS_M = {"mm": 0.001, "cm": 0.01, "m": 1.0}  # by the ending of a name

_BY_ALIAS = {alias: quantity for quantity in QUANTITIES for alias in quantity.aliases.split()}
_SEPARATORS = re.compile(r"[^a-z0-9]")
_UNIT_ENDING = re.compile(r"(?:_|(?<=.{4}))(mm|cm|m)$")
_SIDES = r"left|right|l|r|\d{1,3}"
_AROUND = re.compile(  # a key whose values are of one camera
    rf"(?:cam|camera|cameraparams|camerainfo|sensor|view|infrared|infra|ir|mono|intrinsics?|params|calib)?({_SIDES})"
    r"(?:cam|camera|camerainfo|image|img|infrared|ir|intrinsics?|params|parameters|sensor|calib|calibration|lens)?"
    rf"|cameraparameters(\d)"
)
# a key whose values are between two cameras or streams
_BETWEEN = re.compile(r"(?:from)?(.+?)to(.+)")
# a name with its side before or behind it
_NAME = "|".join(
    alias for row in QUANTITIES if row.side_in == "name" for alias in row.aliases.split()
)
_WORD_OF_SIDE = re.compile(r"(?<![a-z])(left|right)(?![a-z])")
_SIDE_IN_NAME = r"(?:of)?(?:cam|camera)?(?P<side>left|right|l|r|\d{1,2})(?:cam|camera)?"
_BEFORE = re.compile(rf"{_SIDE_IN_NAME}(?P<name>{_NAME})")
_BEHIND = re.compile(rf"(?P<name>{_NAME}){_SIDE_IN_NAME}")


def meaning(keys: tuple[str, ...], n_values: int) -> Meaning | None:
    """What the keys of a value, from the outside in, state about it; None if they name no quantity,
    or one between other cameras, such as depth to colour.
    """
    words = [_plain(key) for key in keys]
    # camera_matrix: {left: ...}
    if len(words) > 1 and words[-2] in _BY_ALIAS and re.fullmatch(_SIDES, words[-1]):
        return Meaning(_side(words[-1]), _BY_ALIAS[words[-2]])
    around = side_around(keys)
    result = _by_name(words[-1], around, n_values) or _by_length(keys[-1], around, n_values)
    if result is None and len(words) > 1:  # distortion: {parameters: ...}
        result = _by_name(words[-2] + words[-1], around, n_values)
    if result is None or result.quantity.name not in ("R", "T"):
        return result
    direction = _direction(words[:-1])
    if direction is None:
        return result
    return result._replace(side=None, is_inverse=direction < 0) if direction else None


def side_around(keys: tuple[str, ...]) -> Side:
    """The side that the blocks around a value state, the innermost first; None = none."""
    sides = (_side_of_block(_plain(key)) for key in reversed(keys[:-1]))
    return next((side for side in sides if side is not None), None)


def side_of_name(name: str) -> Side:
    """The side that the name of a block states, or one word in it; None = none."""
    side, words = (
        _side_of_block(_plain(name)),
        _WORD_OF_SIDE.findall(name.lower().replace("_", " ")),
    )
    return words[0] if side is None and len(words) == 1 else side


def _plain(key: str) -> str:
    return _SEPARATORS.sub("", key.lower())


def _by_name(name: str, around: Side, n_values: int) -> Meaning | None:
    """The meaning of a name, which may begin or end with its side, in a block of the side `around`."""
    if name == "fisheye" and n_values > 1:  # OpenMVG's coefficients, no flag
        name = "distortion"
    quantity = _BY_ALIAS.get(name)
    if quantity is not None and (name not in COEFFICIENTS or n_values == 1):
        side = None if quantity.side_in == "nothing" else around
        return Meaning(side, quantity, is_inverse=quantity.is_inverse)
    match = _BEFORE.fullmatch(name) or _BEHIND.fullmatch(name)
    if match is None:
        return None
    quantity = _BY_ALIAS[match["name"]]
    # the name of one camera's rotation is that of the rectification
    is_rectification = quantity.name == "R" and n_values == 9
    return Meaning(_side(match["side"]), _BY_ALIAS["rect"] if is_rectification else quantity)


def _by_length(key: str, around: Side, n_values: int) -> Meaning | None:
    """The meaning of the name of a length with its unit; None for other names."""
    ending = _UNIT_ENDING.search(key.lower())
    if ending is None:
        return None
    result = _by_name(_plain(key[: ending.start()]), around, n_values)
    if result is None or not result.quantity.is_length:
        return None
    return result._replace(metres=UNITS_M[ending[1]])


def _direction(blocks: list[str]) -> int | None:
    """Direction of the transform in a block between two cameras: 1 = from the first to the second,
    -1 = reverse, 0 = between others; None = no such block.
    """
    for word in blocks:
        if match := _BETWEEN.fullmatch(word):
            first, second = map(_side_of_block, match.groups())
            if first is None or second is None or isinstance(first, str) != isinstance(second, str):
                return 0
            return 1 if str(first) < str(second) else -1
    return None


def _side_of_block(word: str) -> Side:
    match = _AROUND.fullmatch(word)
    return None if match is None else _side(next(filter(None, match.groups())))


def _side(word: str) -> Side:
    if word.isdecimal():
        return int(word)
    return {"l": "left", "r": "right"}.get(word, word)
