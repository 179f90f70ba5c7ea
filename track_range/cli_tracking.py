"""The command `track` as the command line shows it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from track_range.commands.track import TrackOptions
from track_range.commands.track import track as run_track

_console = Console()


def track(
    detections: Annotated[
        Path,
        typer.Argument(
            metavar="DETECTIONS",
            help="MOT det.txt, KITTI rows, or frame,x1,y1,x2,y2,score; a file, a folder of them (NAME.txt), or "
            "MOTChallenge's folders (NAME/det/det.txt).",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Gets mot/NAME.txt per sequence.")],
    images: Annotated[
        Path | None,
        typer.Option(
            metavar="VIDEO|DIR",
            help="The frames: a video, a folder of images, or a folder of either by sequence; looks and the camera's "
            "motion then help.",
        ),
    ] = None,
    form: Annotated[
        Literal["mot", "kitti", "rrc"] | None,
        typer.Option("--format", help="Of the boxes; rrc: frame,x1,y1,x2,y2,score (default: told from the file)."),
    ] = None,
    classes: Annotated[
        str | None,
        typer.Option(
            metavar="X", help="Class of rows that name none (default: car or person by the folder's name, else person)."
        ),
    ] = None,
    fps: Annotated[
        float | None, typer.Option(min=0.01, max=1000, help="Frames per second (default: seqinfo.ini's, else 10).")
    ] = None,
    tracker: Annotated[
        str,
        typer.Option(
            metavar="NAME|MODULE:CLASS",
            help="deepsort compares appearance too; sort does not; or a tracker of your own.",
        ),
    ] = "deepsort",
    reid: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A re-identification network (ONNX) for appearance; needs --images."),
    ] = None,
    online: Annotated[
        bool,
        typer.Option(
            "--online", help="Each frame as a live run would tell it, without what later frames add (gaps, starts)."
        ),
    ] = False,
    kitti: Annotated[bool, typer.Option("--kitti", help="Write KITTI rows too: kitti/NAME.txt.")] = False,
) -> None:
    """Give boxes of a detector identities: no distances, and no video needed."""
    options = TrackOptions(
        detections=detections,
        out=out,
        images=images,
        form=form,
        road_class=classes,
        fps=fps,
        tracker=tracker,
        reid=reid,
        is_online=online,
        is_kitti_written=kitti,
    )
    run_track(options, _console)
