"""`track-range demo`: the main job on a simulated stereo drive, offline, with exact truth."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from track_range.commands.run import run
from track_range.results.output_files import make_folder
from track_range.run.progress import say, step_progress
from track_range.run.settings import RunSettings
from track_range.simulation.drive import write_drive


def demo(out: Path, console: Console, *, seed: int = 0, seconds: float = 6.0, is_played_back: bool = False) -> None:
    """Simulate a drive into `out/drive`, run the main job on it into `out`, and say where the report lies.

    Args:
        out: folder of the results.
        console: where to tell.
        seed: of the drive.
        seconds: its length.
        is_played_back: boxes come from the simulation's playback detector, not from the packaged one.

    Raises:
        OutputError: `out` cannot be written.
    """
    make_folder(out / "drive")
    boxes = (
        "Boxes come from the simulation's playback detector (true boxes with jitter, misses and false alarms): only "
        "tracking and ranging are at work."
        if is_played_back
        else "Boxes come from the packaged detector."
    )
    say(console, f"A simulated stereo drive, with exact truth. {boxes}")
    with step_progress(console, "rendering") as progress:
        drive = write_drive(out / "drive", seed=seed, seconds=seconds, progress=progress)
    settings = RunSettings(
        stereo=(drive.left, drive.right),
        rig=drive.rig,
        detections=drive.detections if is_played_back else None,
        truth=drive.table,
        out=out,
    )
    run(settings, console)
    say(console, f"Open {out / 'report.html'} in a browser; {out / 'overlay.mp4'} is the video.")
