"""The command line: commands, options, and errors as one sentence.

Exit status: 0 done, 1 an input or output that cannot be used (or the user stopped the run), 2 wrong usage.
"""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import cv2
import typer
from rich.console import Console

from track_range.cli_alignment import align
from track_range.cli_calibration import calibrate, rig
from track_range.cli_models import evaluation, models
from track_range.cli_ranging import fit, ranges
from track_range.cli_report import report
from track_range.cli_run import run
from track_range.cli_simulation import simulate
from track_range.cli_tracking import track
from track_range.cli_training import anchors, train
from track_range.commands.demo import demo as run_demo
from track_range.foundation.errors import UserError

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Track every road user in a video and say how far it is, how sure that is, and how fast it closes.",
    epilog="Examples: track-range --stereo left.mp4 right.mp4 --rig rig.yaml  |  "
    "track-range --mono dashcam.mp4 --focal-px 1150 --detector yolov5n.onnx  |  track-range demo",
)

app.add_typer(models, name="models")
app.add_typer(evaluation, name="evaluate")
app.add_typer(rig, name="rig")
app.command("calibrate")(calibrate)
app.command("fit")(fit)
evaluation.command("ranges")(ranges)
app.command("align")(align)
app.command("run")(run)
app.command("report")(report)
app.command("track")(track)
app.command("train")(train)
app.command("anchors")(anchors)
app.command("simulate")(simulate)

_console = Console()


@app.callback(invoke_without_command=True)
def _root(
    is_version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    if is_version:
        typer.echo(f"track-range {version('track-range')}")
        raise typer.Exit


@app.command("demo", help="Simulate a short stereo drive, run the main job on it, and print the tables.")
def _demo(
    out: Annotated[Path, typer.Option(help="Where the drive and the results go.")] = Path("track-range-demo"),
    seed: Annotated[int, typer.Option(min=0, help="Another seed is another drive.")] = 0,
    seconds: Annotated[float, typer.Option(min=0.5, max=60, help="Length of the drive.")] = 6.0,
    playback: Annotated[
        bool,
        typer.Option("--playback", help="Boxes from the truth, jittered, in place of the packaged detector's."),
    ] = False,
) -> None:
    run_demo(out, _console, seed=seed, seconds=seconds, is_played_back=playback)


def main() -> None:
    """Entry point of `track-range`."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # our own sentence says what is wrong
    arguments = sys.argv[1:]
    if arguments in ([], ["-h"], ["--help"]):  # the main job needs no command word
        app(["--help"], standalone_mode=False)
        arguments = ["run", "--help"]
    elif arguments and arguments[0].startswith("-") and arguments[0] != "--version":
        arguments = ["run", *arguments]
    try:
        app(arguments)
    except SystemExit as ended:
        if ended.code != 130:  # the shell's word for Ctrl-C
            raise
        Console(stderr=True).print("track-range: stopped by the user.", style="red")
        raise SystemExit(1) from None
    except UserError as error:
        told = Console(stderr=True)
        told.print(f"track-range: {error}", style="red", highlight=False, markup=False, emoji=False, soft_wrap=True)
        raise SystemExit(error.exit_status) from None
