"""The command `align` as the command line shows it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from track_range.commands.align import AlignOptions
from track_range.commands.align import align as run_align

_console = Console()


def align(
    out: Annotated[Path, typer.Option(metavar="FILE", help="The alignment file to write, for `--align FILE`.")],
    stereo: Annotated[
        tuple[Path, Path] | None,
        typer.Option(metavar="LEFT RIGHT", help="The two videos of a drive past things that stand still."),
    ] = None,
    drive: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="Folder with left.mp4 and right.mp4; give it again for more of the same rig."),
    ] = None,
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR|LABELS|CSV",
            help="Objects of known distance: KITTI 2015's layout or a labelled drive; with --stereo KITTI tracking "
            "labels, or a CSV of frame,x1,y1,x2,y2 and distance_m or disparity_px.",
        ),
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="Rig file (default: the one beside the images).")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the resampling that the uncertainty comes from.")] = 0,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the figures here too.")
    ] = None,
) -> None:
    """Measure what disparities of a calibrated pair are off by, from a drive or from known distances."""
    options = AlignOptions(
        out=out,
        stereo=stereo,
        drives=tuple(drive or ()),
        reference=reference,
        rig=rig,
        seed=seed,
        json_file=json_file,
    )
    run_align(options, _console)
