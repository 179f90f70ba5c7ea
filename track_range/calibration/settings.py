"""Options of calibration, alignment and the evaluation of stereo matchers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from track_range.foundation.options import Options, option

OFF, LEAVE_TWO_OUT = "off", "leave-two-out"


class CalibrationSettings(Options):
    """Which images of which board are calibrated from, and where the results go."""

    mono: Annotated[
        str | None,
        option("Images of one camera: 'boards/*.jpg' in quotes, a folder, or a video.", metavar="IMAGES"),
    ] = None
    stereo: Annotated[
        tuple[str, str] | None,
        option("Images of both cameras: 'left*.jpg' 'right*.jpg', folders, or videos.", metavar="LEFT RIGHT"),
    ] = None
    board: Annotated[
        str,
        option(
            "Inner corners of the chessboard, such as 9x6; or charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM[:DICT], in "
            "squares.",
            metavar="COLUMNSxROWS",
        ),
    ]
    square_mm: Annotated[float | None, option("Side of the chessboard's squares in mm.", metavar="MM")] = None
    lens_terms: Annotated[
        int, option("Number of distortion coefficients: k1 k2 p1 p2, k3, k4 k5 k6.", metavar="0|4|5|8")
    ] = 5
    out: Annotated[Path, option("Rig file to write.", metavar="FILE")]
    picture: Annotated[
        Path | None, option("Image of residuals and coverage to write (default: beside --out).", metavar="FILE.png")
    ] = None
    json_file: Annotated[Path | None, option("JSON file to write the figures to.", flag="--json", metavar="FILE")] = (
        None
    )


class AlignmentSettings(Options):
    """What the disparity error of a rig is estimated from, and where the alignment goes."""

    stereo: Annotated[
        tuple[Path, Path] | None,
        option("Left and right video of a drive past static objects.", metavar="LEFT RIGHT"),
    ] = None
    drives: Annotated[
        tuple[Path, ...],
        option(
            "Folder with left.mp4 and right.mp4; repeat the option for more drives with the same rig.",
            flag="--drive",
            metavar="DIR",
            is_repeated=True,
        ),
    ] = ()
    reference: Annotated[
        Path | None,
        option(
            "Objects of known distance: KITTI 2015's layout or a labelled drive; with --stereo KITTI tracking labels, "
            "or a CSV of frame, x1, y1, x2, y2 and distance_m or disparity_px.",
            metavar="DIR|LABELS|CSV",
        ),
    ] = None
    rig: Annotated[Path | None, option("Rig file (default: the one beside the images).")] = None
    out: Annotated[Path, option("Alignment file to write, for `--align FILE`.", metavar="FILE")]
    seed: Annotated[int, option("Random seed of the resampling that gives the uncertainty.", ge=0)] = 0
    json_file: Annotated[Path | None, option("JSON file to write the figures to.", flag="--json", metavar="FILE")] = (
        None
    )


class StereoEvaluationSettings(Options):
    """Which matchers are measured on which pairs of known disparity."""

    pairs: Annotated[
        Path,
        option(
            "Folder with KITTI 2015's image_2, image_3, disp_occ_0, obj_map and calib.txt, or of a drive with "
            "left.mp4, right.mp4, rig.yaml and truth.csv or truth.txt.",
            metavar="DIR",
        ),
    ]
    rig: Annotated[Path | None, option("Rig file (default: the folder's own).")] = None
    matchers: Annotated[
        tuple[str, ...],
        option(
            "Matchers to measure, of: patch, sgbm, and sgbm in other modes as sgbm-3way, sgbm-5way, sgbm-hh, sgbm-hh4, "
            "each but patch also with -centre for the disparity at the box centre.",
            flag="--matcher",
            metavar="A,B,...",
            min_length=1,
        ),
    ] = ("patch", "sgbm", "sgbm-centre", "sgbm-hh")
    align: Annotated[
        str,
        option(
            "Disparity correction: an alignment file, none (off), or a fit to all pairs but two at a time.",
            metavar="FILE|off|leave-two-out",
        ),
    ] = OFF
    seed: Annotated[int, option("Random seed of the bootstrap intervals.", ge=0)] = 0
