"""`track-range demo`: the main command on a simulated stereo drive, offline, with exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from track_range.cli.commands.run import print_outcome, run_and_print
from track_range.cli.shared.console import console, print_line
from track_range.cli.shared.parameters import command
from track_range.foundation.files.output_files import locked_output
from track_range.foundation.processes import one_opencv_thread
from track_range.foundation.schemas.options import Options, option
from track_range.run.options.settings import RunSettings
from track_range.run.progress import step_progress
from track_range.simulation.drive import write_drive

if TYPE_CHECKING:
    from rich.console import Console

    from track_range.run.run import Run

# the camera's car stops for people and a cyclist, who stay visible for several seconds
SCENARIO = "crossing"


class DemoOptions(Options):
    """Options of `demo`."""

    out: Annotated[Path, option("Folder of the drive and the results.", metavar="DIR")] = Path(
        "track-range-demo"
    )
    seed: Annotated[int, option("Random seed for the drive.", ge=0)] = 0
    seconds: Annotated[
        float, option("Length of the drive in seconds.", metavar="S", ge=0.5, le=60)
    ] = 6.0
    playback: Annotated[
        bool,
        option(
            "Simulated detections (true boxes with noise, misses and false alarms) instead of the "
            "packaged detector."
        ),
    ] = False


def _demo(options: DemoOptions) -> None:
    with locked_output(options.out / "drive"):
        boxes = (
            "the simulation: true boxes with noise" if options.playback else "the packaged detector"
        )
        print_line(
            console,
            f"The stereo drive of {options.seconds:g} s is simulated; boxes come from {boxes}.",
        )
        with step_progress(console, "rendering") as progress, one_opencv_thread():
            drive = write_drive(
                options.out / "drive",
                seed=options.seed,
                seconds=options.seconds,
                scenario=SCENARIO,
                progress=progress,
            )
        settings = RunSettings(
            stereo=(drive.left, drive.right),
            rig=drive.rig,
            detections=drive.detections if options.playback else None,
            truth=drive.table,
            out=options.out,
        )
        run_and_print(settings, console, print_results=_print_screen)


def _print_screen(run: Run, console: Console) -> None:
    """Print one screen: what happened, the accuracy, the files, and what to try next."""
    folder = run.settings.out
    print_outcome(run, console)
    print_line(
        console,
        f"Report  {folder}/report.html   all methods, errors by distance, every track",
        f"Video   {folder}/overlay.mp4   boxes, distances and closing speeds",
        f"Table   {folder}/tracks.csv    one row per track and frame",
        "",
        "Your own video (--help explains the options):",
        "  track-range --mono dashcam.mp4 --focal-px 1150",
        "  track-range --stereo left.mp4 right.mp4 --rig rig.yaml",
    )


app = command(DemoOptions, _demo)
