"""The lens models that files state, by every name that programs and people give them.

A name is translated to Kalibr's names of a projection and of a distortion, by which `LENSES` have
their lenses; a model that is no lens here is refused by its name.
"""

import re
from collections.abc import Mapping, Sequence

from track_range.foundation.files.input_files import alternatives, quoted
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.lenses.lens import KalibrModel
from track_range.stereo.lenses.registry import LENSES

# Kalibr's projection and distortion ("" = not stated), and their names in lower case without
# punctuation
_SPELLINGS = {
    ("pinhole", ""): "pinhole perspective simplepinhole pinholecamera rectilinear",
    ("", "none"): "none nodistortion undistorted",
    ("pinhole", "none"): "pinholenone",
    ("", "radtan"): "radtan radtan4 radtan5 radtan8 radialtangential radialtangential8 plumbbob plumbob"
    " rationalpolynomial rational brown brownconrady brownconradymodel opencv opencv4 opencv5 opencv8"
    " opencv12 fullopencv opencvstandard opencvpinhole radial simpleradial radial1 radial3 pinholeradtan"
    " pinholeradtan4 pinholeradtan5 pinholeradtan8 pinholeradialtangential pinholebrown pinholebrownconrady"
    " pinholeradial pinholeradialk1 pinholeradialk3 pinholebrownt2 pinholeopencv inversebrownconrady"
    " modifiedbrownconrady frame",
    ("", "equidistant"): "fisheye equidistant equi kb kb4 kb8 kannala kannalabrandt kannalabrandt4 kannalabrandt8"
    " opencvfisheye fisheyeopencv fisheyekb4 fisheyekannalabrandt cvfisheye fisheyecv pinholeequi"
    " pinholeequidistant pinholefisheye fisheye4 radialfisheye simplefisheye simpleradialfisheye equidistantfisheye",
    ("ds", "none"): "ds doublesphere dsnone",
    ("omni", ""): "omni mei omnidir unified omnidirectional omniradtan unifiedprojection catadioptric",
}  # fmt: skip
# models without a lens here, and their names
_OTHERS = {
    "the field-of-view model (FOV)": "fov atan arctan pinholefov fovnone",
    "the extended unified model": "eucm eucmnone extendedunified enhancedunified extendedunifiedcamera",
    "the unified model with alpha": "ucm ucmnone",
    "an f-theta model": "ftheta fthetapolynomial",
    "the polynomial of OCamCalib": "ocam ocamcalib scaramuzza taylor",
    "a thin prism fisheye": "thinprismfisheye fisheye624 fisheye62 radtanthinprismfisheye",
    "a panorama": "spherical equirectangular latlon lonlat cylindrical",
    "a stereographic lens": "stereographic",
    "the division model": "division radialdivision simpledivision",
}
_BY_NAME = {name: models for models, names in _SPELLINGS.items() for name in names.split()}
_OTHER_BY_NAME = {name: title for title, names in _OTHERS.items() for name in names.split()}
_SEPARATORS = re.compile(r"[^a-z0-9]")
_PREFIX = re.compile(r"^(?:lensmodel|distortion)(?=.)")  # of mrcal and of librealsense's Python
# what a text is about, by its key: these state nothing but a model, so that an unknown name is one
# that is missing
_OF_MODELS = re.compile(r"projection_?(?:type|model)|digital_?lens|\bprojection$")
# numbers with these keys are those of a program's models, such as librealsense's
_MODEL_KEYS = frozenset(
    "model distortionmodel distortiontype lensmodel lenstype cameramodel cameratype".split()
)
# these may state something else, such as the name of a camera
_PERHAPS_OF_MODELS = re.compile(r"model|type|projection|lens|distortion|polymorphic")


def _plain(text: str) -> str:
    return _PREFIX.sub("", _SEPARATORS.sub("", text.lower()))


def kalibr_names(text: str) -> tuple[str, str] | None:
    """Kalibr's projection and distortion of a model by its name; "" = not stated, None = unknown."""
    name = _plain(text)
    known = _BY_NAME.get(name)
    if known is not None:
        return known
    models = [model for lens in LENSES.usable.values() for model in lens.kalibr]
    for model in models:  # of other packages
        if name == _plain(model.camera):
            return model.camera, ""
        if name == _plain(model.distortion):
            return "", model.distortion
    return None


def is_fisheye(text: str) -> bool:
    """Whether a name is one of OpenCV's fisheye model, as of a block of values."""
    return kalibr_names(text) == ("", "equidistant")


def states_model(key: str, value: object) -> bool:
    """Whether a text or a number with this key states a lens model."""
    if type(value) is int:
        return _SEPARATORS.sub("", key.rpartition(".")[2].lower()) in _MODEL_KEYS
    if not isinstance(value, str) or not value:
        return False
    name, key = _plain(value), key.lower()
    is_known = (
        kalibr_names(value) is not None
        or name in _OTHER_BY_NAME
        or name.startswith(("splined", "cahvor"))
    )
    is_of_distortion = "distort" in key and key.endswith(("model", "type"))
    is_of_model = is_of_distortion or _OF_MODELS.search(key) is not None
    return bool(is_of_model or (is_known and _PERHAPS_OF_MODELS.search(key)))


def stated_lens(stated: Mapping[str, str], source: object) -> tuple[str, KalibrModel] | None:
    """The lens of a model that a file states under these keys, and its form in Kalibr's files; None
    = none is stated, or only that the projection is a pinhole's.

    Raises RigError for a model that is no lens here, and for two that contradict each other.
    """
    keys_by_part = _keys_by_part(stated, source)
    projection, distortion = (next(iter(keys), "") for keys in keys_by_part)
    if not distortion and projection in ("", "pinhole"):
        return None
    fitting = [
        (model.distortion == distortion, name, model)
        for name, lens in LENSES.usable.items()
        for model in lens.kalibr
        if model.camera == (projection or "pinhole")
    ]
    is_exact, name, model = max(fitting, key=lambda row: row[0])
    is_other = not is_exact and distortion not in ("", "none")
    if is_other or max(map(len, keys_by_part)) > 1:
        both = " and ".join(f"{quoted(text)} in {key}" for key, text in stated.items())
        raise RigError(
            f"{source}: expected one lens model of {alternatives(LENSES.usable)}, found {both}; "
            "correct the wrong one."
        )
    _check_alone(model, [other for _, other, form in fitting if form.names == model.names], source)
    return name, model


def _check_alone(model: KalibrModel, lenses: Sequence[str], source: object) -> None:
    """Raise RigError if several lenses have one name of Kalibr: those that are registered at run
    time, since those of packages are left out.
    """
    if len(lenses) > 1:
        raise RigError(
            f"{source}: expected one lens for Kalibr's {' with '.join(model.names)}, found "
            f"{' and '.join(lenses)}; omit one of them."
        )


def _unknown(key: str, text: str, source: object) -> RigError:
    title = _OTHER_BY_NAME.get(_plain(text), "a lens model")
    return RigError(
        f"{source}: expected a lens model of {alternatives(LENSES.usable)}, found {title}, "
        f"{quoted(text)} in {key}; write the name of one of these, calibrate with one, or "
        "undistort the video and give the pinhole of its images."
    )


def _keys_by_part(
    stated: Mapping[str, str], source: object
) -> tuple[dict[str, str], dict[str, str]]:
    """The keys of the file by Kalibr's name: of projections, and of distortions."""
    keys_by_part: tuple[dict[str, str], dict[str, str]] = ({}, {})
    for key, text in stated.items():
        names = kalibr_names(text)
        if names is None:
            raise _unknown(key, text, source)
        for keys, name in zip(keys_by_part, names, strict=True):
            if name:
                keys.setdefault(name, key)
    return keys_by_part
