"""Options of the simulation; without numpy, which the help of the command line does not need."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import field_validator

from track_range.foundation.schemas.options import Options, option
from track_range.recording.video.layouts import PackedLayout
from track_range.simulation.camera.fault_options import Faults, fault_option

if TYPE_CHECKING:
    from track_range.stereo.geometry.mounting import Mounting

SCENARIO_NAMES = (
    *("town", "highway", "city", "cut-in", "crossing", "queue", "empty", "night"),
    *("rear-stationary", "rear-slower", "rear-braking", "crossing-adult", "crossing-child"),
    *("crossing-car", "yielding"),
    *("curve-parked", "oncoming", "overhead-sign", "following", "occlusion", "winding"),
    "fixed",
)

_DRIVE, _OUTPUT = "Drive", "Output"


class _Recording(Options):
    car_size: Annotated[
        float,
        option(
            "Size of all cars relative to the usual size.",
            metavar="FACTOR",
            panel=_DRIVE,
            ge=0.5,
            le=2,
        ),
    ] = 1.0
    camera_pitch_deg: Annotated[
        float,
        option(
            "Pitch of the cameras relative to the ego car in degrees, positive = up.",
            flag="--camera-pitch",
            metavar="DEG",
            panel=_DRIVE,
            ge=-20,
            le=20,
        ),
    ] = 0.0
    mount: Annotated[
        tuple[str, ...],
        option(
            "Where the left camera looks from the ego car, and where it is, as in "
            "`track-range run --mount`; x and y count from the middle of the car, 1.5 m behind its "
            "front (default: ahead, 1.65 m above the road).",
            metavar="NAME=NUMBER",
            panel=_DRIVE,
            is_repeated=True,
        ),
    ] = ()
    lossless: Annotated[
        bool,
        option("Folders of PNG images, left/ and right/, instead of H.264 videos.", panel=_OUTPUT),
    ] = False
    stereo_layout: Annotated[
        PackedLayout | None,
        option(
            "Video both.mp4 of both cameras in this layout, instead of left.mp4 and right.mp4.",
            panel=_OUTPUT,
        ),
    ] = None
    disparity: Annotated[
        bool,
        option(
            "Additional output of true disparities in KITTI 2015's layout (image_2/, image_3/, "
            "disp_occ_0/, obj_map/).",
            panel=_OUTPUT,
        ),
    ] = False
    masks: Annotated[
        bool,
        option(
            "Additional output of the visible heads and number plates in the left images, as PNG "
            "images (masks/, mask_ids/).",
            panel=_OUTPUT,
        ),
    ] = False
    noise_grey: Annotated[
        float,
        fault_option(
            "Standard deviation of the sensor noise in grey levels of 255.",
            "--noise",
            "LEVELS",
            0,
            40,
        ),
    ] = 2.0


class DriveOptions(Faults, _Recording):
    """How a drive is recorded: size of its cars, files, and the faults and noise of its cameras."""

    @field_validator("mount")
    @classmethod
    def _checked_mounting(cls, texts: tuple[str, ...]) -> tuple[str, ...]:
        mounting_of(texts)
        return texts


def mounting_of(texts: tuple[str, ...]) -> Mounting | None:
    """The mounting of the left camera in the ego car; None = as usual."""
    from track_range.stereo.geometry.mounting import Mounting  # imports NumPy

    return Mounting.of(texts) if texts else None


class _Input(Options):
    out: Annotated[Path, option("Folder for the simulated files.", metavar="DIR", panel=_OUTPUT)]
    images: Annotated[
        int | None,
        option(
            "Number of labelled training images to render instead of a drive: images/, labels/, "
            "data.yaml.",
            metavar="N",
            panel=_OUTPUT,
            ge=1,
            le=1_000_000,
        ),
    ] = None
    frames: Annotated[
        int, option("Number of images of each scene, with --images.", panel=_OUTPUT, ge=1, le=1000)
    ] = 6
    scenario: Annotated[
        str | None,
        option(
            f"Scenario: {', '.join(SCENARIO_NAMES)} (default: city; with --images: roads with "
            "traffic and few people).",
            metavar="NAME",
            panel=_DRIVE,
            choices=lambda: SCENARIO_NAMES,
        ),
    ] = None
    seconds: Annotated[
        float | None,
        option("Length of the drive in seconds (default: 10).", metavar="S", panel=_DRIVE),
    ] = None
    fps: Annotated[
        float | None, option("Frame rate (default: 10).", metavar="FPS", panel=_DRIVE, ge=1, le=120)
    ] = None
    seed: Annotated[
        int | None,
        option(
            "Random seed for the drive (default: 0), or with --images the number of the first "
            "scene (default: 1000).",
            panel=_DRIVE,
            ge=0,
            le=2**31,
        ),
    ] = None
    rig: Annotated[
        Path | None,
        option(
            "Calibration file of the pair to simulate, rectified or with equal, parallel wide "
            "lenses (default: KITTI's angle of view, 1240 x 376 pixels).",
            panel=_DRIVE,
        ),
    ] = None


class SimulationSettings(DriveOptions, _Input):
    """Scenario, cameras and output folder of `track-range simulate`; None = not given."""

    @property
    def has_drive_options(self) -> bool:
        """Whether an option is given that applies only to drives, even if its value is the
        default.
        """
        return not self.model_fields_set.isdisjoint(
            (*DriveOptions.model_fields, "seconds", "fps", "rig")
        )
