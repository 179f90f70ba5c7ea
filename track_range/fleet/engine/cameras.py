"""The cameras of a fleet: clips of one camera without a calibration get one estimate from many of them.

OUT/cameras/NAME.yaml    calibration of the camera
OUT/cameras/NAME.json    its evidence, and the state of the files and settings that it is from
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rich.console import Console

from track_range.calibration.drive.calibration import calibrate_from_drives
from track_range.calibration.settings import DriveSettings
from track_range.fleet.engine.plan import FleetPlan
from track_range.fleet.engine.remaining import present_fingerprint
from track_range.fleet.inputs.clip import Clip, FleetInputError
from track_range.fleet.inputs.dry_run import check_clips
from track_range.fleet.inputs.pattern import CLIP, Template
from track_range.fleet.storage.location import Location
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import counted, printable, quoted, shortened
from track_range.foundation.files.output_files import write_json
from track_range.foundation.files.structured_text import read_json
from track_range.run.box_source import network_source
from track_range.run.options.detection import DetectionOptions
from track_range.run.options.opened import open_detector
from track_range.run.progress import step_progress
from track_range.run.ready_model import ready_model

# clips of one camera that are read, evenly spread over them: the estimate of more is no better
MOST_CLIPS = 12
_LENS = ("camera_model", "lens_fov_deg")  # what is known of the lens, which the estimate contains


def clips_by_camera(clips: Sequence[Clip], plan: FleetPlan) -> dict[str, list[Clip]]:
    """The clips of one camera each that have no calibration, by the name of their camera, as the
    text of `--camera` with its placeholders gives it; none without this option.

    Raises FleetInputError: a placeholder is unknown, every clip has a calibration, or one is not on
    this machine.
    """
    camera = plan.settings.camera
    if camera is None:
        return {}
    template = Template.of(camera, "--camera")
    of_camera: dict[str, list[Clip]] = {}
    for clip in clips:
        if (
            clip.problem
            or clip.right is not None
            or {**plan.options, **clip.settings}.keys() & {"rig", "focal_px", "stereo_layout"}
        ):
            continue
        folder = Location.of(clip.left).parent
        values = {CLIP: clip.name, "folder": folder.name if folder else "", **clip.labels}
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


def readable(clips: Sequence[Clip]) -> list[Clip]:
    """The clips of a camera from which it is estimated: some of them, if they can be opened."""
    n = min(len(clips), MOST_CLIPS)
    chosen = [clips[k * len(clips) // n] for k in range(n)]
    return [checked.clip for checked in check_clips(chosen) if not checked.problems]


def with_cameras(clips: Sequence[Clip], plan: FleetPlan, console: Console) -> list[Clip]:
    """The clips with the calibrations of their cameras, estimated unless an earlier run has, without
    the clips that cannot be opened. A dry run estimates none.

    Raises FleetInputError: see `clips_by_camera`, the results are not on this machine, or the clips
    of a camera have images of different sizes; VideoError if a file changes meanwhile.
    """
    rigs: dict[str, str] = {}  # by name of the clip
    for name, of_camera in clips_by_camera(clips, plan).items():
        _check_local(plan.out)
        used = readable(of_camera)
        rig = plan.out.path / "cameras" / f"{quote(name, safe='')}.yaml"
        # as of the results of clips: without folders, which an anonymized fleet does not name
        of_clips = [[clip.name, present_fingerprint(clip)] for clip in used]
        inputs = [plan.keys.cameras, *of_clips]
        sentence = _known_sentence(rig, inputs, [plan.keys.former, *of_clips])
        if used and not sentence and not plan.settings.dry_run:
            sentence = _estimated(used, rig, inputs, plan, console)
        if sentence:
            rigs |= {clip.name: str(rig) for clip in of_camera}
        # folders of one name may be of different cameras
        n_folders = len({str(Location.of(clip.left).parent) for clip in of_camera})
        folders = f" in {n_folders} folders" if n_folders > 1 else ""
        console.print(
            f"Camera {printable(name)}: {sentence or 'Not estimated yet.'} By {len(used)} of "
            f"{counted(len(of_camera), 'clip')}{folders}.",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
    return [
        replace(clip, settings=_without_lens(clip.settings) | {"rig": rigs[clip.name]})
        if clip.name in rigs
        else clip
        for clip in clips
    ]


def _without_lens(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in settings.items() if name not in _LENS}


def _lens(clips: Sequence[Clip], plan: FleetPlan) -> dict[str, Any]:
    """What is known of the lens of a camera; FleetInputError: its clips state different lenses."""
    stated = [{**plan.options, **clip.settings} for clip in clips]
    lenses = [{name: values.get(name) for name in _LENS} for values in stated]
    if any(lens != lenses[0] for lens in lenses):
        raise FleetInputError(
            "--camera: expected one lens_fov_deg and camera_model of the clips of a camera, found "
            f"others of {quoted(clips[0].name)} than of another clip."
        )
    return lenses[0]


def _known_sentence(rig: Path, *inputs: Sequence[object]) -> str:
    """What an earlier calibration of a camera is from, in words; "" = none is of any of the
    inputs.
    """
    evidence = rig.with_suffix(".json")
    if not (rig.is_file() and evidence.is_file()):
        return ""
    known = read_json(evidence, FleetInputError, "the evidence of a camera")
    return str(known["sentence"]) if known.get("inputs") in inputs else ""


def _estimated(
    clips: Sequence[Clip], rig: Path, inputs: Sequence[object], plan: FleetPlan, console: Console
) -> str:
    """Write the calibration of a camera; what it is from, in words."""
    rig.parent.mkdir(parents=True, exist_ok=True)
    recordings = tuple(str(Location.of(clip.left).path) for clip in clips)
    settings = DriveSettings(
        recordings=recordings,
        out=rig,
        curves=plan.options.get("curves"),
        **_lens(clips, plan),
    )
    detection = DetectionOptions.of(
        {key: plan.options.get(key) for key in DetectionOptions.model_fields}
        | {"threads": 0}  # no worker runs yet
    )
    try:
        calibration = calibrate_from_drives(
            settings,
            lambda: (
                network_source(
                    detection, partial(ready_model, console=console), open_detector
                ).detect
            ),
            partial(step_progress, console),
        )
    except UsageError as error:
        raise FleetInputError(f"--camera: {error}") from error
    calibration.save(settings)
    sentence = calibration.mounted.estimate.sentence
    write_json(
        rig.with_suffix(".json"),
        {
            **calibration.figures,
            "source": " ".join(Path(name).name for name in recordings),
            "inputs": inputs,
            "sentence": sentence,
        },
    )
    return sentence
