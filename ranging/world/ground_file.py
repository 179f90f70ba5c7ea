"""ground.yaml: the plane of the road before a camera that stands still, as `calibrate ground` writes it.

track_range_ground: 1
image_size_px: [1280, 720]      of the undistorted images
calibrated_focal_px: null       of the calibration that straightened the images; null = none
camera: {focal_px: 820.1, height_m: 6.03, pitch_deg: 12.4, ...}     for people; `theta` counts
theta: {log_focal: 6.7, cx_px: 639.5, ...}      `ranging.world.road_plane`
covariance: [[...], ...]
is_mirrored: false
source: 4 points and 2 lengths
residuals: [{name: "300,500=0,0", value: 0.4, sigma: 2.1, unit: px}]
"""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from track_range.foundation.files.output_files import write_text
from track_range.foundation.files.structured_text import read_yaml, yaml_text
from track_range.foundation.schemas.validation import Number, PositiveNumber, Version1, validated
from track_range.ranging.world.road_plane import THETA, PlaneResidual, RoadPlane
from track_range.ranging.world.road_plane_fit import GroundError
from track_range.stereo.geometry.camera import PinholeCamera

_SAME_FOCAL = 0.02  # largest relative difference of a calibration from that of the file
_AS_FITTED = "fit it again with this calibration, or omit the calibration"
_Row = Annotated[list[Number], Field(min_length=len(THETA), max_length=len(THETA))]
_Side = Annotated[int, Field(gt=0, lt=100_000)]


class _ResidualFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    value: Number
    sigma: PositiveNumber
    unit: Literal["m", "px", "deg"]


class _GroundFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    track_range_ground: Version1
    image_size_px: tuple[_Side, _Side]
    calibrated_focal_px: PositiveNumber | None = None
    camera: dict[str, Any] = {}
    theta: dict[Literal[THETA], Number]  # type: ignore[valid-type]
    covariance: Annotated[list[_Row], Field(min_length=len(THETA), max_length=len(THETA))]
    is_mirrored: bool = False
    source: str = ""
    residuals: list[_ResidualFile] = []


@dataclass(frozen=True, slots=True)
class GroundFile:
    """A plane of the road, and the focal length of the calibration that it belongs to."""

    plane: RoadPlane
    calibrated_focal_px: float | None = None  # None = the images had no calibration

    @property
    def plain_focal_px(self) -> float | None:
        """Focal length for a run without a calibration; None = it needs that of the file."""
        return None if self.calibrated_focal_px else self.plane.camera.fx_px


def read_ground(path: Path) -> GroundFile:
    """The plane in a ground.yaml; GroundError if the file cannot be used."""
    expected = "the plane of a road (ground.yaml, written by `track-range calibrate ground`)"
    file = validated(_GroundFile, read_yaml(path, GroundError, expected), path, GroundError)
    missing = [name for name in THETA if name not in file.theta]
    covariance = np.array(file.covariance)
    if missing or not np.allclose(covariance, covariance.T, atol=1e-9 + 1e-6 * np.abs(covariance)):
        what = f"theta without {missing[0]}" if missing else "a covariance that is not symmetric"
        raise GroundError(f"{path}: expected {expected}, found {what}; fit the plane again.")
    residuals = tuple(PlaneResidual(**dict(row)) for row in file.residuals)
    theta = np.array([file.theta[name] for name in THETA])
    plane = RoadPlane(
        theta, covariance, file.image_size_px, file.source, file.is_mirrored, residuals
    )
    return GroundFile(plane, file.calibrated_focal_px)


def load_ground(path: str | Path) -> RoadPlane:
    """The plane of the road in a ground.yaml, which `track-range calibrate ground` writes.

    Example:
        >>> import track_range as tr
        >>> plane = tr.load_ground("ground.yaml")
        >>> plane.summary()["height_m"] > 0
        True

    Raises:
        GroundError: the file cannot be read, or is no plane of a road.
    """
    return read_ground(Path(path)).plane


def checked_plane(path: Path, camera: PinholeCamera) -> RoadPlane:
    """The plane in a ground.yaml for the undistorted images of a camera; GroundError if they are
    others.
    """
    file = read_ground(path)
    if file.plane.size_px != camera.size_px:
        (width, height), (own_width, own_height) = file.plane.size_px, camera.size_px
        raise GroundError(
            f"{path}: expected the plane of images of {own_width}x{own_height} px, found "
            f"{width}x{height} px; fit it again with this video, or this --rig."
        )
    focal_px = file.calibrated_focal_px or file.plane.camera.fx_px
    if abs(focal_px / camera.fx_px - 1) > _SAME_FOCAL:
        how = (
            "give the --rig with which the plane was fitted"
            if file.calibrated_focal_px
            else _AS_FITTED
        )
        raise GroundError(
            f"{path}: expected the plane of images with a focal length of {camera.fx_px:.0f} px, "
            f"found {focal_px:.0f} px; {how}."
        )
    return file.plane


def save_ground(path: Path, file: GroundFile) -> None:
    """Write a ground.yaml; OutputError if it cannot be written."""
    plane = file.plane
    document = {
        "track_range_ground": 1,
        "image_size_px": list(plane.size_px),
        "calibrated_focal_px": file.calibrated_focal_px,
        "camera": plane.summary(),
        "theta": dict(zip(THETA, plane.theta.tolist(), strict=True)),
        "covariance": plane.covariance.tolist(),
        "is_mirrored": plane.is_mirrored,
        "source": plane.source,
        "residuals": [asdict(residual) for residual in plane.residuals],
    }
    write_text(path, yaml_text(document))
