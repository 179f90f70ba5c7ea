"""`track-range demo`: the main command on a simulated stereo drive, offline, with exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from track_range.cli.console import console, print_line
from track_range.cli.lazy import single_app
from track_range.cli.parameters import command
from track_range.cli.run import run_and_print
from track_range.foundation.options import Options, option
from track_range.results.output_files import make_folder
from track_range.run.progress import step_progress
from track_range.run.settings import RunSettings
from track_range.simulation.drive import DriveOptions, write_drive

SCENARIO = "crossing"
"""The camera's car stops for people and a cyclist, who stay in plain sight for seconds."""


class DemoOptions(Options):
    """Options of `track-range demo`."""

    out: Annotated[Path, option("Folder of the drive and the results.", metavar="DIR")] = Path("track-range-demo")
    seed: Annotated[int, option("Random seed for the drive.", ge=0)] = 0
    seconds: Annotated[float, option("Length of the drive in seconds.", metavar="S", ge=0.5, le=60)] = 6.0
    playback: Annotated[
        bool,
        option(
            "Simulated detections (true boxes with noise, misses and false alarms) instead of the packaged detector."
        ),
    ] = False


def _demo(options: DemoOptions) -> None:
    make_folder(options.out / "drive")
    boxes = (
        "Detections come from the simulation's playback detector (true boxes with jitter, misses and false alarms): "
        "only tracking and ranging are at work."
        if options.playback
        else "Detections come from the packaged detector."
    )
    print_line(console, f"A simulated stereo drive, with exact truth. {boxes}")
    with step_progress(console, "rendering") as progress:
        drive = write_drive(
            options.out / "drive",
            seed=options.seed,
            seconds=options.seconds,
            options=DriveOptions(scenario=SCENARIO),
            progress=progress,
        )
    settings = RunSettings(
        stereo=(drive.left, drive.right),
        rig=drive.rig,
        detections=drive.detections if options.playback else None,
        truth=drive.table,
        out=options.out,
    )
    run_and_print(settings, console)
    print_line(console, f"Open {options.out / 'report.html'} in a browser; {options.out / 'overlay.mp4'} is the video.")


app = single_app(command(DemoOptions, _demo))
