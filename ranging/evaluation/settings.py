"""Options of the evaluation of distances from labelled boxes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from track_range.foundation.options import Options, option


class RangeEvaluationSettings(Options):
    """Which methods are measured on which boxes; no video is needed."""

    labels: Annotated[Path, option("Folder of KITTI labels, NAME.txt per sequence.", metavar="DIR")]
    calib: Annotated[Path, option("Folder of calib files with the same names.", metavar="DIR")]
    boxes: Annotated[
        str,
        option(
            "Boxes to measure: the labels' own, or detections DIR/{Car,Pedestrian}/NAME.txt.",
            metavar="labels|rrc:DIR",
        ),
    ] = "labels"
    noise_px: Annotated[
        float, option("Standard deviation in pixels of noise added to box edges.", metavar="PX", ge=0.0, le=50.0)
    ] = 0.0
    seed: Annotated[int, option("Random seed for the noise.", ge=0)] = 0
    filter: Annotated[Literal["none", "paper", "default"], option("Filter over time, per track.")] = "none"
    cross_validate: Annotated[
        bool, option("Cross-validation: size curves refitted without the sequences that they are tested on.")
    ] = False
    same_drive: Annotated[
        bool, option("Size curves fitted to the tested drive itself, as in the paper (optimistic).")
    ] = False
    fit_on: Annotated[
        Literal["labels", "boxes"],
        option("Boxes that curves are fitted to: the labels' exact boxes, or the measured boxes."),
    ] = "labels"
    methods: Annotated[
        tuple[str, ...], option("Methods to measure (default: all).", flag="--method", metavar="A,B,...")
    ] = ()
    curves: Annotated[Path | None, option("Size curves of mono (default: the packaged ones).", metavar="FILE")] = None
    camera_height_m: Annotated[
        float | None,
        option(
            "Height of the camera above the road in metres (default: estimated from the boxes).",
            flag="--camera-height",
            metavar="M",
            ge=0.3,
            le=5.0,
        ),
    ] = None
