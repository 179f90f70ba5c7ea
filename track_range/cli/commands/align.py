"""`track-range align` and `track-range rig check`: measure the disparity error of a calibrated
stereo pair.
"""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from track_range.calibration.align import (
    BaselineCheck,
    CheckedValue,
    RigAlignment,
    align,
    check_rig_health,
)
from track_range.calibration.settings import AlignmentSettings, RigCheckSettings
from track_range.cli.shared.console import console, print_grid, print_line
from track_range.cli.shared.parameters import command
from track_range.ranging.cameras.causes import SHOWN_SIGMA
from track_range.ranging.cameras.scale_check import ScaleCheck
from track_range.ranging.cameras.unknowns import Unknown
from track_range.run.options.precedence import settings_from
from track_range.run.progress import step_progress
from track_range.run.run import Run
from track_range.views.tables import SIGMA, Column, Grid, grid_of, rig_grid

_BASELINE_S = 30.0  # longest part of the drive from which the baseline is checked


def _align(settings: AlignmentSettings) -> None:
    alignment = align(
        settings, partial(step_progress, console), partial(_check_baseline, console=console)
    )
    _print(alignment)
    alignment.save(settings)
    print_line(console, f"Written: {settings.out}")


def _check(settings: RigCheckSettings) -> None:
    _print(
        check_rig_health(
            settings, partial(step_progress, console), partial(_check_baseline, console=console)
        )
    )


def _print(alignment: RigAlignment) -> None:
    print_grid(console, _cameras_grid(alignment.values))
    print_grid(console, rig_grid(alignment.health.to_dict()))
    print_line(console, *alignment.sentences)


def _cameras_grid(values: Sequence[CheckedValue]) -> Grid:
    columns = [
        Column("given", [value.given for value in values], "{:.3f}"),
        Column("by the drive", [value.shown for value in values], "{:.3f}"),
        Column(SIGMA, [value.sigma for value in values], "{:.3f}"),
        # the same word for all that are
        Column("in doubt", [1.0 if value.is_doubted else None for value in values], "yes"),
    ]
    return grid_of("The cameras", "value", [value.name for value in values], columns)


def _check_baseline(
    videos: tuple[Path, Path], settings: AlignmentSettings | RigCheckSettings, console: Console
) -> BaselineCheck:
    """Check the baseline in the first part of a drive; raises the errors of a run."""
    given = {
        name: getattr(settings, name) for name in ("rig", "detector", "detections", "ego_speed")
    }
    given = {name: str(value) for name, value in given.items() if value is not None}
    if videos[0] == videos[1]:
        given["stereo_layout"] = settings.stereo_layout
    run = Run(
        settings_from(
            {"stereo": tuple(map(str, videos)), "sgbm": False, "duration_s": _BASELINE_S, **given}
        ),
        progress=console,
    )
    for _ in run:
        pass
    check = run.session.opened.pipeline.doubting.check
    if check is None:
        return BaselineCheck("", {})
    return BaselineCheck(check.sentence, check.summary(), _shown_lengths(check))


def _shown_lengths(check: ScaleCheck) -> tuple[CheckedValue, ...]:
    """Baseline and focal length, if the drive shows them without what was given."""
    doubted = () if check.doubt is None else check.doubt.cause_names
    values = []
    for unknown, unit in ((Unknown.BASELINE, "m"), (Unknown.FOCAL, "px")):
        given = check.priors[unknown].value
        shown = check.cameras.estimate({unknown: 1.0}, unknown)
        if shown.sigma < SHOWN_SIGMA:
            value = given * math.exp(-shown.mean)
            sigma = value * shown.sigma
            values.append(
                CheckedValue(f"{unknown} {unit}", given, value, sigma, unknown in doubted)
            )
    return tuple(values)


app = command(AlignmentSettings, _align)
check_app = command(RigCheckSettings, _check)
