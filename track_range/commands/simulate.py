"""`track-range simulate`: simulated road images with exact labels, to train a detector with."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from track_range.commands.progress import say, step_progress
from track_range.simulation.images import write_image_set


def simulate(out: Path, console: Console, *, n_scenes: int, n_frames: int, seed: int) -> None:
    """Write `n_frames` labelled images of each of `n_scenes` scenes into `out`.

    Raises:
        OutputError: `out` cannot be written.
    """
    with step_progress(console, "rendering") as progress:
        path = write_image_set(out, range(seed, seed + n_scenes), n_frames=n_frames, progress=progress)
    say(console, f"Written: {n_scenes * n_frames} images, and {path}")
