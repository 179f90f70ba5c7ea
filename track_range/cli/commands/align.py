"""`track-range align`: estimates the disparity error of a calibrated stereo pair."""

from __future__ import annotations

from functools import partial

from track_range.calibration.align import align
from track_range.calibration.settings import AlignmentSettings
from track_range.cli.console import console, print_line
from track_range.cli.lazy import single_app
from track_range.cli.parameters import command
from track_range.run.progress import step_progress


def _align(settings: AlignmentSettings) -> None:
    alignment = align(settings, partial(step_progress, console))
    for line in (alignment.applied.sentence(), *alignment.notes):
        print_line(console, line)
    alignment.save(settings)
    print_line(console, f"Written: {settings.out}")


app = single_app(command(AlignmentSettings, _align))
