"""Options of the cameras' faults; without numpy, which the help of the command line does not need."""

from typing import Annotated, Any, Literal

from track_range.foundation.schemas.options import Options, option


def fault_option(description: str, flag: str, metavar: str, low: float, high: float) -> Any:
    """An option of the panel of faults, from `low` to `high`."""
    return option(description, flag=flag, metavar=metavar, panel="Camera faults", ge=low, le=high)


class Faults(Options):
    """Faults of a drive's cameras; no faults by default."""

    gain: Annotated[
        float,
        fault_option(
            "Brightness of the right camera relative to the left one, as a factor.",
            "--gain",
            "FACTOR",
            0.1,
            4,
        ),
    ] = 1.0
    blur_px: Annotated[
        float,
        fault_option(
            "Standard deviation in pixels of the blur of both cameras.", "--blur", "PX", 0, 20
        ),
    ] = 0.0
    rain: Annotated[
        float, fault_option("Density of rain, from 0 to 1.", "--rain", "0..1", 0, 1)
    ] = 0.0
    row_offset_px: Annotated[
        float,
        fault_option(
            "Vertical offset of the right image in pixels, positive downwards.",
            "--row-offset",
            "PX",
            -20,
            20,
        ),
    ] = 0.0
    disparity_offset_px: Annotated[
        float,
        fault_option(
            "Constant error of all disparities in pixels.", "--disparity-offset", "PX", -20, 20
        ),
    ] = 0.0
    drop_fraction: Annotated[
        float,
        fault_option(
            "Fraction of frames dropped by each camera, from 0 to 0.9.",
            "--drop-frames",
            "FRACTION",
            0,
            0.9,
        ),
    ] = 0.0
    late_s: Annotated[
        float,
        fault_option(
            "Delay of the right camera in seconds, which its timestamps do not show.",
            "--late",
            "S",
            -1,
            1,
        ),
    ] = 0.0
    wrong_rig: Annotated[
        Literal["baseline", "focal", "principal"] | None,
        option(
            "Error in rig.yaml: baseline (5 % too long), focal (focal length 4 % too long) or "
            "principal (principal point 15 px off).",
            metavar="NAME",
            panel="Camera faults",
        ),
    ] = None


NO_FAULTS = Faults()
