"""The cameras of a fleet: clips of one camera without a calibration get one estimate from many of them.

OUT/cameras/NAME.yaml    calibration of the camera
OUT/cameras/NAME.json    its evidence, and the recordings that it is from
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rich.console import Console

from track_range.calibration.drive.calibration import calibrate_from_drives
from track_range.calibration.drive.known_metres import Detect
from track_range.calibration.settings import DriveSettings
from track_range.detection.catalogue.lookup import DEFAULT_MODEL
from track_range.fleet.inputs.clip import Clip, FleetInputError
from track_range.fleet.inputs.dry_run import check_clips
from track_range.fleet.inputs.pattern import CLIP, Template
from track_range.fleet.storage.location import Location
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import counted, quoted, shortened
from track_range.foundation.files.output_files import write_json
from track_range.foundation.files.structured_text import read_json
from track_range.run.options.opened import DetectorOptions, open_detector
from track_range.run.progress import step_progress
from track_range.run.ready_model import ready_model

# clips of one camera that are read, evenly spread over them: the estimate of more is no better
MOST_CLIPS = 12


def clips_by_camera(clips: Sequence[Clip], camera: str) -> dict[str, list[Clip]]:
    """The clips of one camera each that have no calibration, by the name of their camera, as the
    text of `--camera` with its placeholders gives it.

    Raises FleetInputError: a placeholder is unknown, every clip has a calibration, or one is not on
    this machine.
    """
    template = Template.of(camera, "--camera")
    of_camera: dict[str, list[Clip]] = {}
    for clip in clips:
        if (
            clip.problem
            or clip.right is not None
            or clip.settings.keys() & {"rig", "focal_px", "stereo_layout"}
        ):
            continue
        values = {CLIP: clip.name, **clip.labels}
        try:
            name = template.filled(values)
        except KeyError as error:
            raise FleetInputError(
                f"--camera {quoted(camera)}: {{{error.args[0]}}} is unknown; expected one of "
                f"{shortened(', '.join(values), 100)}."
            ) from error
        _check_local(Location.of(clip.left))
        if "rig" not in clip.files():
            of_camera.setdefault(name, []).append(clip)
    if not of_camera:
        raise FleetInputError(
            f"--camera {quoted(camera)}: expected clips of one camera without a calibration, found "
            "none; omit it."
        )
    return of_camera


def _check_local(location: Location) -> None:
    if not location.is_local:
        raise FleetInputError(
            f"{location}: --camera expects recordings and --out on this machine; use track-range "
            "calibrate drive with some clips, and --rig with its file."
        )


def chosen(clips: Sequence[Clip]) -> list[Clip]:
    """The clips from which their camera is estimated."""
    n = min(len(clips), MOST_CLIPS)
    return [clips[k * len(clips) // n] for k in range(n)]


def camera_lines(clips: Sequence[Clip], camera: str) -> list[str]:
    """What is estimated before the run, a line for each camera."""
    return [
        f"Camera {name}: estimated once, from {len(chosen(of_camera))} of "
        f"{counted(len(of_camera), 'clip')}"
        for name, of_camera in clips_by_camera(clips, camera).items()
    ]


def with_cameras(
    clips: Sequence[Clip], camera: str, out: Location, options: Mapping[str, Any], console: Console
) -> list[Clip]:
    """The clips with the calibrations of their cameras, estimated unless an earlier run has, without
    the clips that cannot be opened.

    Raises FleetInputError: see `clips_by_camera`, the results are not on this machine, or the clips
    of a camera have images of different sizes; VideoError if a file changes meanwhile.
    """
    _check_local(out)
    rigs: dict[str, str] = {}  # by name of the clip
    for name, of_camera in clips_by_camera(clips, camera).items():
        paths = tuple(
            str(Location.of(checked.clip.left).path)
            for checked in check_clips(chosen(of_camera))
            if not checked.problems
        )
        if not paths:
            continue  # its clips fail with their own problems
        rig = out.path / "cameras" / f"{quote(name, safe='')}.yaml"
        sentence = _estimated(paths, rig, options, console)
        console.print(
            f"Camera {name}: {sentence} By {len(paths)} of {counted(len(of_camera), 'clip')}.",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
        rigs |= {clip.name: str(rig) for clip in of_camera}
    return [
        replace(clip, settings={**clip.settings, "rig": rigs[clip.name]})
        if clip.name in rigs
        else clip
        for clip in clips
    ]


def _estimated(
    recordings: tuple[str, ...], rig: Path, options: Mapping[str, Any], console: Console
) -> str:
    """Write the calibration of a camera, and what it is from in words; one that is from the same
    recordings stays.
    """
    evidence = rig.with_suffix(".json")
    # an anonymized fleet does not name folders
    recordings_hash = hashlib.sha256("\n".join(recordings).encode()).hexdigest()
    if rig.is_file() and evidence.is_file():
        known = read_json(evidence, FleetInputError, "the evidence of a camera")
        if known["recordings_hash"] == recordings_hash:
            return str(known["sentence"])
    rig.parent.mkdir(parents=True, exist_ok=True)
    settings = DriveSettings(recordings=recordings, out=rig, curves=options.get("curves"))

    def open_detect() -> Detect:
        model = ready_model(options.get("detector") or DEFAULT_MODEL, console)
        network = open_detector(model, DetectorOptions())
        return lambda frame: network.detect(frame.left)

    try:
        calibration = calibrate_from_drives(settings, open_detect, partial(step_progress, console))
    except UsageError as error:
        raise FleetInputError(f"--camera: {error}") from error
    calibration.save(settings)
    sentence = calibration.mounted.estimate.sentence
    write_json(
        evidence,
        {
            **calibration.figures,
            "source": " ".join(Path(name).name for name in recordings),
            "recordings_hash": recordings_hash,
            "sentence": sentence,
        },
    )
    return sentence
