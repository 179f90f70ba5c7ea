"""`track-range simulate`: simulated road images with exact labels, to train a detector with."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from track_range.simulation.images import write_image_set


def simulate(out: Path, console: Console, *, n_scenes: int, n_frames: int, seed: int) -> None:
    """Write `n_frames` labelled images of each of `n_scenes` scenes into `out`.

    Raises:
        OutputError: `out` cannot be written.
    """
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("rendering", total=None)
        path = write_image_set(
            out,
            range(seed, seed + n_scenes),
            n_frames=n_frames,
            progress=lambda done, total: progress.update(task, completed=done, total=total),
        )
    console.print(f"Written: {n_scenes * n_frames} images, and {path}", highlight=False, markup=False, soft_wrap=True)
