"""Options of fitting size models."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from track_range.foundation.options import Options, option


class FitSettings(Options):
    """Which model is fitted to which labels, and where it goes."""

    labels: Annotated[
        Path | None,
        option("Folder of KITTI tracking labels, NAME.txt per sequence, or object labels.", metavar="DIR"),
    ] = None
    calib: Annotated[Path | None, option("Folder of calib files with the same names.", metavar="DIR")] = None
    csv: Annotated[
        Path | None,
        option(
            "CSV file of boxes instead of labels: class,x1,y1,x2,y2,distance_m,fx[,fy,cx,cy,track,sequence].",
            metavar="FILE",
        ),
    ] = None
    focal_px: Annotated[float | None, option("Focal length in pixels, for a CSV without a column fx.", ge=1.0)] = None
    curve: Annotated[
        str | None,
        option(
            "Size model: cuboids, log-linear, or a curve of one box measure (default: cuboids; for a CSV file "
            "log-linear).",
            metavar="NAME",
        ),
    ] = None
    out: Annotated[Path | None, option("Curve file to write, for --curves.", metavar="FILE")] = None
    compare: Annotated[bool, option("Comparison of all plain curves: errors on the fitted and on other drives.")] = (
        False
    )
    picture: Annotated[Path | None, option("Image to write: all plain curves over the boxes.", metavar="FILE.png")] = (
        None
    )
    leave_out: Annotated[
        tuple[str, ...], option("Sequences to leave out for testing, such as 0005.", metavar="A,B,...")
    ] = ()
    source: Annotated[str, option("Description of the labels, stored in the curve file.")] = ""
