"""Options of the simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from track_range.foundation.options import Options, option, option_of
from track_range.simulation.world.scenario_names import SCENARIO_NAMES

_DRIVE, _OUTPUT, _FAULTS = "Drive", "Output", "Camera faults (default: none)"

_OF_ALL = frozenset(("out", "scenario", "seed", "images", "frames"))
"""Options that are not only those of drives."""


class SimulationSettings(Options):
    """Scenario, cameras and output folder of `track-range simulate`; None = not given."""

    out: Annotated[Path, option("Folder for the simulated files.", metavar="DIR", panel=_OUTPUT)]
    scenario: Annotated[
        str | None,
        option(
            f"Scenario: {', '.join(SCENARIO_NAMES)} (default: city; with --images: roads with traffic and few people).",
            metavar="NAME",
            panel=_DRIVE,
        ),
    ] = None
    seconds: Annotated[
        float | None, option("Length of the drive in seconds (default: 10).", metavar="S", panel=_DRIVE)
    ] = None
    fps: Annotated[float | None, option("Frame rate (default: 10).", metavar="FPS", panel=_DRIVE, ge=1, le=120)] = None
    seed: Annotated[
        int | None,
        option(
            "Random seed for the drive (default: 0), or with --images the number of the first scene (default: 1000).",
            panel=_DRIVE,
            ge=0,
            le=2**31,
        ),
    ] = None
    rig: Annotated[
        Path | None,
        option(
            "Calibration file of the pair to simulate, rectified or with equal, parallel wide lenses (default: KITTI's "
            "angle of view, 1240 x 376 pixels).",
            panel=_DRIVE,
        ),
    ] = None
    car_size: Annotated[
        float | None,
        option(
            "Size of all cars relative to the scenario's (default: 1).", metavar="FACTOR", panel=_DRIVE, ge=0.5, le=2
        ),
    ] = None
    camera_pitch_deg: Annotated[
        float | None,
        option(
            "Pitch of the cameras relative to the ego car in degrees, positive = up (default: 0).",
            flag="--camera-pitch",
            metavar="DEG",
            panel=_DRIVE,
            ge=-20,
            le=20,
        ),
    ] = None
    lossless: Annotated[
        bool, option("Folders of PNG images, left/ and right/, instead of H.264 videos.", panel=_OUTPUT)
    ] = False
    disparity: Annotated[
        bool,
        option(
            "Additional output of true disparities in KITTI 2015's layout (image_2/, image_3/, disp_occ_0/, obj_map/).",
            panel=_OUTPUT,
        ),
    ] = False
    masks: Annotated[
        bool,
        option(
            "Additional output of the visible heads and number plates in the left images, as PNG images (masks/, "
            "mask_ids/).",
            panel=_OUTPUT,
        ),
    ] = False
    images: Annotated[
        int | None,
        option(
            "Number of labelled training images to render instead of a drive: images/, labels/, data.yaml.",
            metavar="N",
            panel=_OUTPUT,
            ge=1,
            le=1_000_000,
        ),
    ] = None
    frames: Annotated[int, option("Number of images of each scene, with --images.", panel=_OUTPUT, ge=1, le=1000)] = 6
    noise_grey: Annotated[
        float | None,
        option(
            "Standard deviation of the sensor noise in grey levels of 255 (default: 2).",
            flag="--noise",
            metavar="LEVELS",
            panel=_FAULTS,
            ge=0,
            le=40,
        ),
    ] = None
    gain: Annotated[
        float | None,
        option(
            "Brightness of the right camera relative to the left one, as a factor.",
            metavar="FACTOR",
            panel=_FAULTS,
            ge=0.1,
            le=4,
        ),
    ] = None
    blur_px: Annotated[
        float | None,
        option(
            "Standard deviation in pixels of the blur of both cameras.",
            flag="--blur",
            metavar="PX",
            panel=_FAULTS,
            ge=0,
            le=20,
        ),
    ] = None
    rain: Annotated[
        float | None, option("Density of rain, from 0 to 1.", metavar="0..1", panel=_FAULTS, ge=0, le=1)
    ] = None
    row_offset_px: Annotated[
        float | None,
        option(
            "Vertical offset of the right image in pixels, positive downwards.",
            flag="--row-offset",
            metavar="PX",
            panel=_FAULTS,
            ge=-20,
            le=20,
        ),
    ] = None
    disparity_offset_px: Annotated[
        float | None,
        option(
            "Constant error of all disparities in pixels.",
            flag="--disparity-offset",
            metavar="PX",
            panel=_FAULTS,
            ge=-20,
            le=20,
        ),
    ] = None
    drop_fraction: Annotated[
        float | None,
        option(
            "Fraction of frames dropped by each camera, from 0 to 0.9.",
            flag="--drop-frames",
            metavar="FRACTION",
            panel=_FAULTS,
            ge=0,
            le=0.9,
        ),
    ] = None
    late_s: Annotated[
        float | None,
        option(
            "Delay of the right camera in seconds that its timestamps do not show.",
            flag="--late",
            metavar="S",
            panel=_FAULTS,
            ge=-1,
            le=1,
        ),
    ] = None
    wrong_rig: Annotated[
        str | None,
        option(
            "Error in rig.yaml: baseline (5 % too long), focal (focal length 4 % too long) or principal (principal "
            "point 15 px off).",
            metavar="NAME",
            panel=_FAULTS,
        ),
    ] = None

    @property
    def has_drive_options(self) -> bool:
        """Whether an option is given that applies only to drives."""
        fields = type(self).model_fields.items()
        return any(getattr(self, name) != field.default for name, field in fields if name not in _OF_ALL)

    @property
    def faults(self) -> dict[str, float | str]:
        """The given faults, by field of `Faults`; noise is none, since all drives have it."""
        names = self.fields_where(lambda field: option_of(field).panel == _FAULTS) - {"noise_grey"}
        return {name: value for name in names if (value := getattr(self, name)) is not None}
