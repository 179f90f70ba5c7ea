"""Options of `track-range evaluate motion` and `evaluate cuboids`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from track_range.foundation.schemas.options import Options, option
from track_range.ranging.evaluation.settings import (
    BoxesField,
    FrameRateField,
    NoiseField,
    NoiseSeedField,
    RegionField,
    TimesField,
)


class LabelledDriveSettings(Options):
    """Labels with 3-D boxes and poses, and the boxes and methods that measure them."""

    labels: Annotated[
        Path,
        option(
            "Folder of KITTI tracking labels, NAME.txt for each sequence, or one such file, or the "
            "labels of --data.",
            metavar="DIR|FILE",
        ),
    ]
    calib: Annotated[
        Path | None,
        option(
            "Folder of calibration files (KITTI, rig.yaml and others), named like the labels, or the "
            "file of all sequences.",
            metavar="DIR|FILE",
        ),
    ] = None
    poses: Annotated[
        Path | None,
        option(
            "Folder of poses, named like the labels, or one such file: a row of 12 numbers per "
            "frame, the 3 x 4 matrix from the camera to the first camera in metres.",
            metavar="DIR|FILE",
        ),
    ] = None
    boxes: BoxesField = "labels"
    noise_px: NoiseField = 0.0
    seed: NoiseSeedField = 0
    methods: Annotated[
        str,
        option(
            "Ranging method that needs only boxes: a name, or MODULE:OBJECT of a RangingMethod; "
            "several joined by + are fused.",
            metavar="NAME[+NAME]",
            old_names=("method",),
        ),
    ] = "mono"
    region: RegionField = "unknown"
    times: TimesField = None
    frame_rate_hz: FrameRateField = None
    ego: Annotated[
        Literal["poses", "none"],
        option(
            "Known velocity and yaw rate of the camera: from the poses, as precise as a wheel sensor, "
            "or unknown."
        ),
    ] = "poses"
    cross_validate: Annotated[
        bool,
        option(
            "Cross-validation: sizes refitted for each sequence on the boxes of the other "
            "sequences."
        ),
    ] = False


class CuboidEvaluationSettings(LabelledDriveSettings):
    """Options of `track-range evaluate cuboids`."""

    data: Annotated[
        Literal["kitti", "nuscenes"],
        option("Data set of the labels: kitti, or nuscenes (a COCO file of mono3d labels)."),
    ] = "kitti"


class MotionEvaluationSettings(LabelledDriveSettings):
    """Options of `track-range evaluate motion`."""

    data: Annotated[
        Literal["kitti", "tusimple", "nuscenes"],
        option(
            "Data set of the labels: kitti; tusimple (a clip of the velocity challenge with "
            "images, or a folder of clips, which a run measures); or nuscenes (a COCO file of "
            "mono3d labels)."
        ),
    ] = "kitti"
    look_ahead: Annotated[
        bool,
        option(
            "Closing speeds and times to collision from all frames of a sequence, "
            "including later frames."
        ),
    ] = False
