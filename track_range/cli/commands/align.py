"""`track-range align` and `track-range rig check`: measure the disparity error of a calibrated stereo pair."""

from functools import partial

from track_range.calibration.align import RigAlignment, align, check_rig_health
from track_range.calibration.settings import AlignmentSettings, RigCheckSettings
from track_range.cli.console import console, print_grid, print_line
from track_range.cli.parameters import command
from track_range.run.baseline import check_baseline
from track_range.run.progress import step_progress
from track_range.views.report.tables import rig_grid


def _align(settings: AlignmentSettings) -> None:
    alignment = align(settings, partial(step_progress, console), partial(check_baseline, console=console))
    _print(alignment)
    alignment.save(settings)
    print_line(console, f"Written: {settings.out}")


def _check(settings: RigCheckSettings) -> None:
    _print(check_rig_health(settings, partial(step_progress, console), partial(check_baseline, console=console)))


def _print(alignment: RigAlignment) -> None:
    print_grid(console, rig_grid(alignment.health.to_dict()))
    print_line(console, *alignment.sentences)


app = command(AlignmentSettings, _align)
check_app = command(RigCheckSettings, _check)
