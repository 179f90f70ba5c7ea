"""Options of a run for its distances, warnings and events."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import (
    Field,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
    model_validator,
)

from track_range.foundation.schemas.options import Options, contradiction, option
from track_range.foundation.schemas.validation import chosen_numbers
from track_range.ranging.size_models.region import Region
from track_range.ranging.warning.settings import WarningSettings
from track_range.results.events.event import EventSettings

if TYPE_CHECKING:
    from track_range.stereo.geometry.mounting import Mounting

_clip_option = partial(option, is_per_clip=True)


class RangingOptions(Options):
    """Options of the measurement of distances, and of warnings and events."""

    panel: ClassVar = "Ranging"
    stage: ClassVar = "tracks"

    curves: Annotated[
        Path | None,
        _clip_option(
            "Size curves of the mono method, written by `track-range fit` (default: the "
            "packaged curves)."
        ),
    ] = None
    region: Annotated[
        Region | None,
        _clip_option(
            "Region of the recording, since sizes of vehicles, people and lanes differ between "
            "regions (default: from GPS positions, which --ego-speed auto reads; else unknown, "
            "with larger sigmas for one camera). Size curves in a file override the region."
        ),
    ] = None
    sgbm: Annotated[
        bool,
        option(
            "Dense stereo matching (sgbm, slow) in addition to the patch matcher (stereo).",
            flag="--sgbm/--no-sgbm",
            is_shared=True,
        ),
    ] = True
    sgbm_options: Annotated[
        dict[str, Any],
        option(
            "Parameters of dense stereo that override the rig's parameters: fields of "
            "SgbmSettings.",
            is_file_only=True,
        ),
    ] = Field(default_factory=dict)
    warning_options: Annotated[
        dict[str, Any],
        option(
            "Thresholds of the collision warning that override the defaults: fields of "
            "WarningSettings.",
            is_file_only=True,
        ),
    ] = Field(default_factory=dict)
    event_options: Annotated[
        dict[str, Any],
        option(
            "Thresholds of the events that override the defaults: fields of EventSettings.",
            is_file_only=True,
            stage="events",
        ),
    ] = Field(default_factory=dict)
    align: Annotated[
        str,
        _clip_option(
            "Disparity correction: estimated from the drive (auto), none (off), or read from a "
            "file written by `track-range align`.",
            words=("auto", "off"),
            metavar="FILE",
            is_file=True,
        ),
    ] = "auto"
    lanes: Annotated[
        str,
        option(
            "Detector of the lines of the ego lane, for distances by lane width: edge-based "
            "(classical), none (off), or a lane network (ONNX).",
            words=("classical", "off"),
            metavar="FILE",
            is_file=True,
        ),
    ] = "classical"
    lane_width_m: Annotated[
        float | None,
        _clip_option(
            "Width of the ego lane in metres (default: estimated from the drive, region and "
            "speed).",
            metavar="M",
            ge=1.5,
            le=6.0,
        ),
    ] = None
    camera_height_m: Annotated[
        float | None,
        _clip_option(
            "Height of the camera above the road in metres (default: estimated from the drive).",
            metavar="M",
            ge=0.2,
            le=5.0,
        ),
    ] = None
    lens_fov_deg: Annotated[
        str | None,
        _clip_option(
            "Field of view of the lens of a camera without a calibration, as on its box, in degrees "
            "with the side of the image that it is across: 140d diagonal (as on most boxes of "
            "dashcams), 120h horizontal, 70v vertical. The drive corrects it (--fov-deg is the view "
            "to which the images of a wide lens are undistorted).",
            metavar="DEG",
        ),
    ] = None
    camera_model: Annotated[
        str | None,
        _clip_option(
            "Model of a camera without a calibration, with a published focal length, such as "
            "'GoPro HERO10 Black wide' (another name prints the list).",
            metavar="NAME",
        ),
    ] = None
    mount: Annotated[
        tuple[str, ...],
        _clip_option(
            "Where the (left) camera looks from its vehicle, and where it is, such as "
            "yaw=-58,pitch=2: yaw (positive = to the left; 180 = to the rear), pitch (down) and roll "
            "(right side lower) in degrees and their standard deviation sigma (2); x (forward) and "
            "y (to the left) in metres from the point of the vehicle whose speed is given, and the "
            "height z above the road; front of the vehicle, forward of the same point, from which "
            "gaps count. The given speed is then that of the vehicle. A view of a wide lens is turned "
            "further, by --yaw-deg to the right (default: as in --rig, else unknown).",
            metavar="NAME=NUMBER",
            is_repeated=True,
        ),
    ] = ()

    @field_validator("lens_fov_deg", "camera_model", mode="wrap")
    @classmethod
    def _checked_lens(
        cls, value: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo
    ) -> Any:
        """A field of view with its side, also of a number, or a known camera model."""
        from track_range.recording.cameras.known_lenses import GivenLens  # imports NumPy

        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        text = handler(str(value) if is_number else value)
        keyword = "fov_deg" if info.field_name == "lens_fov_deg" else "camera_model"
        GivenLens(**{keyword: text})
        return text

    @field_validator("mount", mode="wrap")
    @classmethod
    def _checked_mounting(cls, value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        """Texts that are a mounting, also of a `Mounting`."""
        from track_range.stereo.geometry.mounting import Mounting  # imports NumPy

        if not isinstance(value, str | list | tuple | Mounting):
            raise ValueError(f"expected a tr.Mounting or texts such as 'yaw=-58', found {value!r}")
        texts = handler(value.parts if isinstance(value, Mounting) else value)
        if texts:
            Mounting.of(texts)
        return texts

    @model_validator(mode="after")
    def _with_one_height(self) -> Self:
        mounting_m = None if self.mounting is None else self.mounting.z_m
        if len({mounting_m, self.camera_height_m} - {None}) > 1:
            raise contradiction(
                f"expected one height of the camera, found z={mounting_m} in --mount and "
                f"{self.camera_height_m} in --camera-height-m",
                ("mount", "camera_height_m"),
            )
        return self

    @field_validator("sgbm_options", "warning_options", "event_options")
    @classmethod
    def _known_parameters(cls, values: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        if values and info.field_name == "sgbm_options":
            from track_range.stereo.matching.sgbm import SgbmSettings  # imports OpenCV

            SgbmSettings.of(values)
        elif values:
            chosen_numbers(
                WarningSettings if info.field_name == "warning_options" else EventSettings, values
            )
        return values

    @property
    def mounting(self) -> Mounting | None:
        """Where the camera is in its vehicle, and where it looks, as given; None = not given."""
        from track_range.stereo.geometry.mounting import Mounting  # imports NumPy

        return Mounting.of(self.mount) if self.mount else None

    @property
    def warning_settings(self) -> WarningSettings:
        """Thresholds of the collision warning."""
        return chosen_numbers(WarningSettings, self.warning_options)

    @property
    def event_settings(self) -> EventSettings:
        """Thresholds of the events."""
        return chosen_numbers(EventSettings, self.event_options)
