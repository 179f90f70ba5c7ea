"""The commands `calibrate` and `rig` as the command line shows them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from track_range.commands.calibrate import CalibrateOptions
from track_range.commands.calibrate import calibrate as run_calibrate
from track_range.commands.rig import convert_rig, show_rig
from track_range.foundation.errors import UsageError

_console = Console()

_LENS_TERMS = (0, 4, 5, 8)

rig = typer.Typer(no_args_is_help=True, help="Calibration files: ours, KITTI's, OpenCV's, Kalibr's.")

SizeOption = Annotated[
    str | None, typer.Option(metavar="WIDTHxHEIGHT", help="Of the images, where the file does not say it.")
]


def calibrate(
    board: Annotated[
        str,
        typer.Option(
            metavar="COLUMNSxROWS",
            help="Inner corners of the chessboard, such as 9x6; or charuco:COLUMNSxROWS:SQUARE_MM:MARKER_MM[:DICT], in "
            "squares.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The rig file to write.")],
    mono: Annotated[
        str | None,
        typer.Option(metavar="IMAGES", help="Images of one camera: 'boards/*.jpg' in quotes, a folder, or a video."),
    ] = None,
    stereo: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="LEFT RIGHT", help="Images of both eyes: 'left*.jpg' 'right*.jpg', folders, or videos."),
    ] = None,
    square_mm: Annotated[float | None, typer.Option(metavar="MM", help="Side of the chessboard's squares.")] = None,
    lens_terms: Annotated[
        int, typer.Option(metavar="0|4|5|8", help="How many terms describe the lens: k1 k2 p1 p2, k3, k4 k5 k6.")
    ] = 5,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="Residuals and coverage (default: beside --out)."),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures here too.")
    ] = None,
) -> None:
    """Find out what a camera, or a pair of them, measures, from images of a chessboard or ChArUco board."""
    if lens_terms not in _LENS_TERMS:
        raise UsageError(f"--lens-terms {lens_terms}: one of {', '.join(str(n) for n in _LENS_TERMS)} is wanted.")
    options = CalibrateOptions(
        mono=mono,
        stereo=stereo,
        board=board,
        square_mm=square_mm,
        out=out,
        picture=picture,
        json_file=json_file,
        n_lens_terms=lens_terms,
    )
    run_calibrate(options, _console)


@rig.command("convert", help="Write a calibration of any format in ours, or as OpenCV's stereo_calib does.")
def _convert(
    source: Annotated[Path, typer.Argument(metavar="IN")],
    out: Annotated[Path, typer.Argument(metavar="OUT")],
    to: Annotated[str, typer.Option(metavar="ours|opencv", help="Format of OUT.")] = "ours",
    size: SizeOption = None,
) -> None:
    convert_rig(source, out, to=to, size=size, console=_console)


@rig.command("show", help="Say what a calibration means: angles of view, baseline, metres per pixel of disparity.")
def _show(source: Annotated[Path, typer.Argument(metavar="FILE")], size: SizeOption = None) -> None:
    show_rig(source, size=size, console=_console)
