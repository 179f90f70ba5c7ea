"""The baseline of a rig from the road users and the speed of the camera in a drive, for `align` and `rig check`."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from track_range.calibration.align import BaselineCheck
from track_range.calibration.settings import AlignmentSettings, RigCheckSettings
from track_range.run.run import Run
from track_range.run.settings_files import settings_from

_MAX_S = 30.0  # longest part of the drive that is read


def check_baseline(
    videos: tuple[Path, Path], settings: AlignmentSettings | RigCheckSettings, console: Console
) -> BaselineCheck:
    """Check the baseline in the first part of a drive; raises the errors of a run."""
    given = {name: getattr(settings, name) for name in ("rig", "detector", "detections", "ego_speed")}
    given = {name: str(value) for name, value in given.items() if value is not None}
    if videos[0] == videos[1]:
        given["stereo_layout"] = settings.stereo_layout
    run = Run(
        settings_from({"stereo": tuple(map(str, videos)), "sgbm": False, "duration_s": _MAX_S, **given}),
        progress=console,
    )
    for _ in run:
        pass
    check = run.session.pipeline.scale_check
    if check is None:
        return BaselineCheck("", {})
    sentence = check.agreement.sentence if check.doubt is None else check.doubt.sentence(check.baseline_m)
    return BaselineCheck(sentence, check.summary())
