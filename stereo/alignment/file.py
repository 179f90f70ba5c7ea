"""Alignment files: align.yaml, with units in the keys, as written by `track-range align`.

    track_range_align: 1
    offset_px: 0.45                 d_true = d_measured + offset_px + bow_px u^2 ..., see `stereo.geometry.alignment`
    offset_sigma_px: 0.05
    bow_px: 1.57
    bow_sigma_px: 0.12
    row_offset_px: 0.22
    residual_px: 0.21
    slope_px: 0.16                  + slope_px u
    slope_sigma_px: 0.05
    roll_deg: -0.02                 right camera relative to the rig: roll, focal length and a large yaw
    focal_ratio: 1.0004
    yaw_deg: 0
    source: this drive, 32 frames

Missing keys have the values of an alignment that was not measured.
"""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from track_range.foundation.files.structured_text import read_yaml, yaml_text
from track_range.foundation.schemas.validation import Number, Version1, validated
from track_range.stereo.geometry.alignment import UNCORRECTED_SIGMA_PX, Alignment
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.rig_format import write_rig_text

_VERSION = 1
_VERSION_KEY = "track_range_align"

_MAX_PX = 100.0  # largest plausible value of a calibrated pair; larger values are in other units
# largest plausible errors of the right camera's angles and focal length
_MAX_ROLL_DEG, _MAX_FOCAL_RATIO = 10.0, 1.2

_Offset = Annotated[Number, Field(ge=-_MAX_PX, le=_MAX_PX)]
_Sigma = Annotated[Number, Field(ge=0, le=_MAX_PX)]


class _AlignmentFile(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    track_range_align: Version1
    offset_px: _Offset
    curvature_px: Annotated[_Offset, Field(alias="bow_px")] = 0.0
    row_offset_px: _Offset = 0.0
    residual_px: _Sigma = UNCORRECTED_SIGMA_PX
    offset_sigma_px: _Sigma = UNCORRECTED_SIGMA_PX
    curvature_sigma_px: Annotated[_Sigma, Field(alias="bow_sigma_px")] = 0.0
    slope_px: _Offset = 0.0
    slope_sigma_px: _Sigma = 0.0
    roll_deg: Annotated[Number, Field(ge=-_MAX_ROLL_DEG, le=_MAX_ROLL_DEG)] = 0.0
    focal_ratio: Annotated[Number, Field(ge=1 / _MAX_FOCAL_RATIO, le=_MAX_FOCAL_RATIO)] = 1.0
    yaw_deg: Annotated[Number, Field(ge=-_MAX_ROLL_DEG, le=_MAX_ROLL_DEG)] = 0.0
    source: str | None = None


def save_alignment(alignment: Alignment, path: Path) -> None:
    """Write an alignment file atomically; RigError if it cannot be written."""
    content = {_VERSION_KEY: _VERSION, **alignment.to_dict()}
    write_rig_text(path, yaml_text(content, width=120, allow_unicode=True))


def load_alignment(path: str | Path) -> Alignment:
    """The alignment of a file written by `track-range align`.

    It corrects the disparities of images that are rectified with the rig alone.
    `open_recording(align=...)` takes it as well, and corrects rows and large offsets in its images.

    Example:
        >>> import track_range as tr
        >>> rig = tr.Rectifier(tr.load_rig("rig.yaml")).rig
        >>> ranger = tr.StereoRanger(rig, alignment=tr.load_alignment("align.yaml"))

    Raises:
        RigError: the file cannot be read, is not an alignment, or has a wrong value.
    """
    path = Path(path)
    expected = "an alignment file written by `track-range align`"
    content = validated(_AlignmentFile, read_yaml(path, RigError, expected), path, RigError)
    values = content.model_dump(exclude={_VERSION_KEY, "source"})
    return Alignment(**values, source=str(path) if content.source is None else content.source)
