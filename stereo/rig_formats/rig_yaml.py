"""rig.yaml, track-range's format for rigs and single cameras; numbers are written with full precision.

Keys contain their unit; a file for one camera has only `left`; distortion is OpenCV's k1, k2, p1, p2, k3, ..., or the
coefficients of the wide lens in `LENSES` that the key `lens` names:

    track_range_rig: 1
    left: {fx_px: 721.5, fy_px: 721.5, cx_px: 609.6, cy_px: 172.9, width_px: 1242, height_px: 375, distortion: []}
    right: {...}
    right_from_left: {rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], translation_m: [-0.54, 0, 0]}

A camera that was calibrated from drives has the uncertainty of its focal length (and of k1, as k1_sigma, if it was
estimated), and its height and pitch:

    mounting: {focal_sigma: 0.04, camera_height_m: 1.42, camera_height_sigma_m: 0.05, pitch_deg: 1.1, ...}

The place and the direction of the (left) camera in its vehicle are in the same block; all keys are optional, and beside
them, the calibration from drives is in a block `road`:

    mounting: {yaw_deg: -58, pitch_deg: 2, roll_deg: 0, x_m: 1.5, y_m: -0.8, z_m: 2.03, sigma_deg: 2}

A calibration with a board has the relative standard deviations of focal length and scale (focal length times baseline):

    accuracy: {focal_sigma: 0.0008, scale_sigma: 0.0011}
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from track_range.foundation.files.input_files import alternatives
from track_range.foundation.files.structured_text import parse_yaml, yaml_text
from track_range.foundation.schemas.validation import Number, PositiveNumber, Version1, validated
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.geometry.rig import (
    RigAccuracy,
    RigError,
    RoadCalibration,
    StereoRig,
    rigid_motion,
)
from track_range.stereo.geometry.rig_checks import (
    ImageSide,
    RigCalibration,
    check_camera,
    check_rig,
)
from track_range.stereo.lenses.lens import PINHOLE
from track_range.stereo.lenses.registry import LENSES
from track_range.stereo.rig_formats.rig_format import RigFormat, write_rig_text

VERSION = 1  # version of the format, the value of its key `track_range_rig`

_Row = Annotated[list[Number], Field(min_length=3, max_length=3)]
_Strict = ConfigDict(extra="forbid", frozen=True)


class _CameraFile(BaseModel):
    model_config = _Strict
    fx_px: PositiveNumber
    fy_px: PositiveNumber
    cx_px: Number
    cy_px: Number
    width_px: ImageSide
    height_px: ImageSide
    distortion: list[Number] = []
    lens: str = PINHOLE

    @field_validator("lens")
    @classmethod
    def _known_lens(cls, lens: str) -> str:
        known = LENSES.usable
        if lens not in known:
            expected = alternatives(map(repr, known))
            raise PydanticCustomError("lens", "Input should be {names}", {"names": expected})
        return lens

    def camera(self) -> PinholeCamera:
        size = (self.width_px, self.height_px)
        return PinholeCamera(
            self.fx_px, self.fy_px, self.cx_px, self.cy_px, *size, tuple(self.distortion), self.lens
        )


class _MotionFile(BaseModel):
    model_config = _Strict
    rotation: Annotated[list[_Row], Field(min_length=3, max_length=3)]
    translation_m: _Row


class _RoadFile(BaseModel):
    model_config = _Strict
    focal_sigma: Annotated[Number, Field(ge=0, le=1)]
    camera_height_m: Annotated[Number, Field(gt=0, le=10)]
    camera_height_sigma_m: Annotated[Number, Field(ge=0, le=10)]
    pitch_deg: Annotated[Number, Field(ge=-90, le=90)]
    pitch_sigma_deg: Annotated[Number, Field(ge=0, le=90)]
    k1_sigma: Annotated[Number, Field(ge=0, le=10)] | None = None


class _AccuracyFile(BaseModel):
    model_config = _Strict
    focal_sigma: Annotated[Number, Field(ge=0, le=1)]
    scale_sigma: Annotated[Number, Field(ge=0, le=1)]


class _RigFile(BaseModel):
    model_config = _Strict
    track_range_rig: Version1
    left: _CameraFile
    right: _CameraFile | None = None
    right_from_left: _MotionFile | None = None
    road: _RoadFile | None = None
    mounting: Mounting | None = None
    accuracy: _AccuracyFile | None = None

    @model_validator(mode="before")
    @classmethod
    def _road_of_mounting(cls, content: Any) -> Any:
        """The content with a calibration from the road that is in the place of the mounting, as in
        files without one, in a place of its own.
        """
        block = content.get("mounting") if isinstance(content, dict) else None
        if not isinstance(block, dict) or "focal_sigma" not in block:
            return content
        places = {field.name for field in fields(Mounting)} - _RoadFile.model_fields.keys()
        if "road" in content or places & block.keys():
            raise ValueError(
                "'mounting': expected where the camera looks, and the results of a calibration from "
                "drives only in the block 'road', found focal_sigma, which belongs to 'road'"
            )
        return {**content, "road": block, "mounting": None}


def save_rig(
    rig: StereoRig,
    path: Path,
    *,
    comments: Sequence[str] = (),
    mounting: Mounting | None = None,
    accuracy: RigAccuracy | None = None,
) -> None:
    """Write rig.yaml, with `comments` as its first lines; RigError for an implausible rig, or an
    unwritable file.
    """
    check_rig(rig, path)
    accuracy = accuracy or rig.accuracy
    rotation = rig.right_from_left[:3, :3].tolist()
    translation_m = rig.right_from_left[:3, 3].tolist()
    content = {
        "left": _camera_content(rig.left),
        "right": _camera_content(rig.right),
        "right_from_left": {"rotation": rotation, "translation_m": translation_m},
        **_known_content(None, mounting, accuracy),
    }
    _save(content, path, comments)


def save_camera(
    camera: PinholeCamera,
    path: Path,
    *,
    comments: Sequence[str] = (),
    road: RoadCalibration | None = None,
    mounting: Mounting | None = None,
    accuracy: RigAccuracy | None = None,
) -> None:
    """Write the calibration of one camera, for --mono, as rig.yaml, with `comments` as its first
    lines.

    `road`, `mounting` and `accuracy` are stored too, if they are given. Raises RigError if the
    camera is implausible, or the file cannot be written.
    """
    check_camera(camera, path)
    known = _known_content(road, mounting, accuracy)
    _save({"left": _camera_content(camera), **known}, path, comments)


def _known_content(
    road: RoadCalibration | None, mounting: Mounting | None, accuracy: RigAccuracy | None
) -> dict[str, Any]:
    """The blocks of what is known; a calibration from the road is in that of an unknown mounting,
    where earlier versions read it.
    """
    of_road = "mounting" if mounting is None else "road"
    known = {of_road: road, "mounting": mounting or road, "accuracy": accuracy}
    return {
        name: {key: value for key, value in asdict(part).items() if value is not None}
        for name, part in known.items()
        if part is not None
    }


def _write(cameras: StereoRig | PinholeCamera, path: Path, comments: Sequence[str]) -> None:
    if isinstance(cameras, StereoRig):
        save_rig(cameras, path, comments=comments)
    else:
        save_camera(cameras, path, comments=comments)


def _camera_content(camera: PinholeCamera) -> dict[str, Any]:
    content = asdict(camera) | {"distortion": list(camera.distortion)}
    return (
        content
        if camera.is_wide
        else {key: value for key, value in content.items() if key != "lens"}
    )


def _save(content: Mapping[str, object], path: Path, comments: Sequence[str]) -> None:
    head = "".join(f"# {part}\n" for line in comments for part in line.splitlines())
    text = yaml_text({"track_range_rig": VERSION, **content}, default_flow_style=None, width=120)
    write_rig_text(path, head + text)


def _read(text: str, path: Path, _is_grey: bool) -> RigCalibration:
    rig = validated(_RigFile, parse_yaml(text, path, RigError, "a rig"), path, RigError)
    accuracy = None if rig.accuracy is None else RigAccuracy(**rig.accuracy.model_dump())
    notes = () if accuracy is None else (accuracy.sentence,)
    known = RigCalibration(
        rig.left.camera(), None, None, mounting=rig.mounting, accuracy=accuracy, notes=notes
    )
    if rig.right is None or rig.right_from_left is None:
        road = None if rig.road is None else RoadCalibration(**rig.road.model_dump())
        return replace(known, road=road, notes=notes if road is None else (road.sentence, *notes))
    motion = rigid_motion(rig.right_from_left.rotation, rig.right_from_left.translation_m)
    return replace(known, right=rig.right.camera(), right_from_left=motion)


RIG_YAML = RigFormat(
    name="ours",
    title="track-range's rig.yaml",
    recognises=lambda text: "track_range_rig" in text,
    read=_read,
    missing=lambda _text, _path, _is_grey: "'right' and 'right_from_left'",
    write=_write,
)
