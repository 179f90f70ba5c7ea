"""FitSettings: options of the fit of size models."""

from pathlib import Path
from typing import Annotated

from track_range.foundation.schemas.options import Options, option


class FitSettings(Options):
    """Labels, size model and output files of `track-range fit`."""

    labels: Annotated[
        Path | None,
        option(
            "Folder of KITTI tracking labels (NAME.txt for each sequence) or object labels; or a "
            "file of COCO or CVAT labels whose boxes have the attribute distance_m, with "
            "--focal-px.",
            metavar="DIR|FILE",
        ),
    ] = None
    calib: Annotated[
        Path | None,
        option("Folder of KITTI calibration files, named like the labels.", metavar="DIR"),
    ] = None
    csv: Annotated[
        Path | None,
        option(
            "CSV file of boxes instead of labels, with the columns class, x1, y1, x2, y2, "
            "distance_m, fx and optionally fy, cx, cy, track, sequence.",
            metavar="FILE",
        ),
    ] = None
    focal_px: Annotated[
        float | None,
        option(
            "Focal length in pixels, for a CSV without the column fx, or for a file of labels.",
            metavar="PX",
            ge=1.0,
        ),
    ] = None
    curve: Annotated[
        str | None,
        option(
            "Size model: cuboids, log-linear, or a curve of one measure of the box (default: "
            "cuboids for KITTI labels, log-linear for other files).",
            metavar="NAME",
        ),
    ] = None
    out: Annotated[
        Path | None,
        option(
            "File of the fitted curves, for --curves of `track-range run`, or of a detector's "
            "values.",
            metavar="FILE",
        ),
    ] = None
    compare: Annotated[
        bool,
        option(
            "Comparison of all curves of one measure: errors on the fitted sequences and "
            "on other sequences."
        ),
    ] = False
    picture: Annotated[
        Path | None,
        option("Picture of the labelled boxes with all curves of one measure.", metavar="FILE.png"),
    ] = None
    leave_out: Annotated[
        tuple[str, ...],
        option("Sequences to leave out for testing, such as 0005.", metavar="A,B,..."),
    ] = ()
    source: Annotated[str, option("Description of the labels, stored in the curve file.")] = ""
