"""Options of the simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from track_range.foundation.options import Options, option
from track_range.simulation.world.scenario_names import SCENARIO_NAMES

_WHAT, _WRITTEN, _FAULTS = "What is driven", "What is written", "What is wrong with the cameras (default: nothing)"

FAULT_FIELDS = (
    "gain",
    "blur_px",
    "rain",
    "row_offset_px",
    "disparity_offset_px",
    "drop_share",
    "late_s",
    "wrong_rig",
)
"""Options that are fields of `track_range.simulation.camera.faults.Faults`."""


class SimulationSettings(Options):
    """What is simulated, and where it is written; None = not given."""

    out: Annotated[Path, option("Folder of the files.", metavar="DIR")]
    scenario: Annotated[
        str | None, option(f"Scenario: {', '.join(SCENARIO_NAMES)} (default: city).", metavar="NAME", panel=_WHAT)
    ] = None
    seconds: Annotated[
        float | None, option("Length of the drive in seconds (default: 10).", metavar="S", panel=_WHAT)
    ] = None
    fps: Annotated[float | None, option("Frame rate (default: 10).", panel=_WHAT, ge=1, le=120)] = None
    seed: Annotated[
        int | None,
        option(
            "Random seed of the drive (default: 0), or number of the first scene of images (default: 1000).",
            panel=_WHAT,
            ge=0,
            le=2**31,
        ),
    ] = None
    rig: Annotated[
        Path | None,
        option(
            "Rectified pair to render for: rig.yaml or calib.txt (default: KITTI's angle of view, 1240 x 376).",
            panel=_WHAT,
        ),
    ] = None
    lossless: Annotated[
        bool, option("Folders of PNGs, left/ and right/, in place of H.264 videos.", panel=_WRITTEN)
    ] = False
    disparity: Annotated[
        bool,
        option(
            "True disparities in KITTI 2015's layout in addition: image_2/, image_3/, disp_occ_0/ and obj_map/.",
            panel=_WRITTEN,
        ),
    ] = False
    images: Annotated[
        int | None,
        option(
            "Number of labelled training images, in place of a drive: images/, labels/, data.yaml.",
            metavar="N",
            panel=_WRITTEN,
            ge=1,
            le=1_000_000,
        ),
    ] = None
    frames: Annotated[int, option("Number of images per scene, for --images.", panel=_WRITTEN, ge=1, le=1000)] = 6
    noise_grey: Annotated[
        float | None,
        option(
            "Sensor noise in grey levels (default: 2).",
            flag="--noise",
            metavar="GREY",
            panel=_FAULTS,
            ge=0,
            le=40,
        ),
    ] = None
    gain: Annotated[
        float | None,
        option("Brightness of the right camera relative to the left one.", panel=_FAULTS, ge=0.1, le=4),
    ] = None
    blur_px: Annotated[
        float | None,
        option("Blur of both cameras in pixels.", flag="--blur", metavar="PX", panel=_FAULTS, ge=0, le=20),
    ] = None
    rain: Annotated[float | None, option("Density of rain.", metavar="0..1", panel=_FAULTS, ge=0, le=1)] = None
    row_offset_px: Annotated[
        float | None,
        option(
            "Vertical offset of the right image in pixels, downwards.",
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
            "Error of all disparities in pixels.",
            flag="--disparity-offset",
            metavar="PX",
            panel=_FAULTS,
            ge=-20,
            le=20,
        ),
    ] = None
    drop_share: Annotated[
        float | None,
        option(
            "Share of frames that each camera loses.",
            flag="--drop-frames",
            metavar="SHARE",
            panel=_FAULTS,
            ge=0,
            le=0.9,
        ),
    ] = None
    late_s: Annotated[
        float | None,
        option(
            "Delay of the right camera in seconds, which its timestamps do not show.",
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
            "Error in rig.yaml: baseline (5 % too long), focal (4 % too long), principal (15 px off).",
            metavar="NAME",
            panel=_FAULTS,
        ),
    ] = None

    @property
    def has_drive_options(self) -> bool:
        """Whether an option is given that only a drive has."""
        given = (self.scenario, self.seconds, self.fps, self.rig, self.noise_grey)
        return any(value is not None for value in given) or self.lossless or self.disparity or bool(self.faults)

    @property
    def faults(self) -> dict[str, float | str]:
        """The faults that are given, by field of `Faults`."""
        return {name: value for name in FAULT_FIELDS if (value := getattr(self, name)) is not None}
