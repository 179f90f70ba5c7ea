"""The commands about distances from boxes, `fit` and `evaluate ranges`, as the command line shows them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from track_range.commands.evaluate_ranges import RangesTest, evaluate_ranges, keep_ranges_figures
from track_range.commands.fit import FitJob, fit_size_curves
from track_range.ranging.fitting.model_fit import MODEL_NAMES

_console = Console()


def ranges(
    labels: Annotated[Path, typer.Option(metavar="DIR", help="KITTI labels, NAME.txt per sequence.")],
    calib: Annotated[Path, typer.Option(metavar="DIR", help="Calib files of the same names.")],
    boxes: Annotated[
        str,
        typer.Option(metavar="labels|rrc:DIR", help="The labels' own, or detections DIR/{Car,Pedestrian}/NAME.txt."),
    ] = "labels",
    noise_px: Annotated[
        float, typer.Option(metavar="PX", min=0.0, max=50.0, help="Noise put on every edge of the boxes.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise.")] = 0,
    filter_name: Annotated[
        Literal["none", "paper", "default"], typer.Option("--filter", help="Over time, track by track.")
    ] = "none",
    is_cross_validated: Annotated[
        bool, typer.Option("--cross-validate", help="Refit the size curves, leaving sequences out.")
    ] = False,
    is_same_drive: Annotated[
        bool, typer.Option("--same-drive", help="Fit on the very drive that is tested, as the paper did: flattering.")
    ] = False,
    fit_on: Annotated[
        Literal["labels", "boxes"],
        typer.Option(help="What curves are fitted on: the labels' exact boxes, or such boxes as are measured."),
    ] = "labels",
    method: Annotated[str, typer.Option(metavar="A,B,...", help="Which methods (default: all).")] = "",
    curves: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Size curves of mono (default: the packaged ones).")
    ] = None,
    camera_height: Annotated[
        float | None,
        typer.Option(metavar="M", min=0.3, max=5.0, help="Of the camera above the road (default: told by the boxes)."),
    ] = None,
    table: Annotated[Path | None, typer.Option(metavar="FILE.md", help="Write the tables as Markdown.")] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures here too.")
    ] = None,
) -> None:
    """Error of distances from boxes against labels with 3-D boxes, all methods side by side; no video needed."""
    test = RangesTest(
        labels=labels,
        calib=calib,
        boxes=boxes,
        noise_px=noise_px,
        seed=seed,
        filter_name=filter_name,
        is_cross_validated=is_cross_validated,
        is_same_drive=is_same_drive,
        fit_on=fit_on,
        methods=tuple(name.strip() for name in method.split(",") if name.strip()),
        curves=curves,
        camera_height_m=camera_height,
    )
    keep_ranges_figures(evaluate_ranges(test, console=_console), json_file=json_file, table=table)


def fit(
    labels: Annotated[
        Path | None, typer.Option(metavar="DIR", help="KITTI tracking labels, NAME.txt per sequence, or object labels.")
    ] = None,
    calib: Annotated[Path | None, typer.Option(metavar="DIR", help="Calib files of the same names.")] = None,
    csv: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Or boxes as class,x1,y1,x2,y2,distance_m,fx[,fy,cx,cy,track,sequence]."),
    ] = None,
    focal_px: Annotated[
        float | None, typer.Option(min=1.0, help="Focal length in pixels, for a CSV without a column fx.")
    ] = None,
    curve: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help=f"Of: {', '.join(MODEL_NAMES)} (default: cuboids; for a CSV file log-linear)."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="The curve file to write, for --curves.")] = None,
    is_compared: Annotated[
        bool, typer.Option("--compare", help="All plain curves side by side: fitted, and on other drives.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw all plain curves over the boxes.")
    ] = None,
    leave_out: Annotated[str, typer.Option(metavar="A,B,...", help="Sequences kept for testing, such as 0005.")] = "",
    source: Annotated[str, typer.Option(help="What the labels are; kept in the file.")] = "",
) -> None:
    """Fit the monocular size curves on labels of your own camera."""
    job = FitJob(
        labels=labels,
        calib=calib,
        csv=csv,
        focal_px=focal_px,
        curve=curve,
        out=out,
        is_compared=is_compared,
        picture=picture,
        leave_out=leave_out,
        source=source,
    )
    fit_size_curves(job, _console)
