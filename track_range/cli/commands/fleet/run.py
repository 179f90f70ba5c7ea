"""`track-range fleet run`: many recordings on the workers of a Ray cluster."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from inspect import Parameter
from typing import TYPE_CHECKING, Any

from track_range.cli.shared.parameters import command_of, given_values, parameters
from track_range.fleet.settings import FleetSettings
from track_range.foundation.schemas.options import option_of
from track_range.recording.cameras.calibration import names_of
from track_range.run.options.settings import RunSettings

if TYPE_CHECKING:
    from track_range.fleet.inputs.clip import Clip
    from track_range.fleet.inputs.dry_run import CheckedClip

# words of the help texts of a run, and what they are in a fleet, which has no --mono and --stereo
_IN_HELP = {
    "With --mono": "For a clip of one camera",
    "With one recording": "For a clip that is one recording",
    "one for --mono, two for --stereo BAG": "one topic for one camera, two topics for a pair",
}
# characters of the name of a failed clip, and number of such clips that are named
_MAX_NAME, _MAX_NAMED = 20, 10


def _fleet_run(**values: Any) -> None:
    from track_range.cli.shared.console import console, print_line, print_notes
    from track_range.fleet.engine.fleet_run import run_fleet
    from track_range.fleet.engine.plan import common_options
    from track_range.fleet.errors import ClipsFailedError
    from track_range.fleet.inputs.listing import clips_of, label_note
    from track_range.foundation.files.input_files import counted, printable, shortened

    settings = FleetSettings.of(given_values(FleetSettings, values))
    options = {
        name: value
        for name, value in given_values(RunSettings, values).items()
        if name not in FleetSettings.model_fields
    }
    if settings.settings is not None:
        options = {**common_options(settings.settings), **options}
    if settings.rig_camera is not None:
        options["camera"] = settings.rig_camera
    clips = clips_of(settings.recordings, settings.pattern, settings.rig)
    print_notes(console, filter(None, [label_note(clips)]))
    if settings.dry_run:
        _print_plan(settings, options, clips)
        return
    result = run_fleet(settings, options, clips, console=console)
    counts = result.counts
    print_line(console, counts.sentence(), f"Results in {settings.out}")
    if result.kept:
        named = shortened(", ".join(result.kept), 200)
        kept = f"{counted(len(result.kept), 'clip')} with changed files: {named}"
        print_notes(console, [f"Earlier results remain of {kept}; --overwrite replaces them."])
    if result.failed:
        print_line(
            console,
            *(printable(f"failed: {name}: {error}") for name, error in result.failed[:_MAX_NAMED]),
        )
        named = ", ".join(shortened(name, _MAX_NAME) for name, _ in result.failed[:_MAX_NAMED])
        n_failed = len(result.failed)
        more = (
            f" and {n_failed - _MAX_NAMED} more, see clips.parquet" if n_failed > _MAX_NAMED else ""
        )
        raise ClipsFailedError(
            f"{n_failed} of {counts.total} clips failed: {named}{more}; repeat failed clips with "
            "--retry-failed."
        )


def _print_plan(settings: FleetSettings, options: dict[str, Any], clips: Sequence[Clip]) -> None:
    """Print what would be processed, with the problems in the headers; ClipsFailedError if there
    are some.
    """
    from track_range.cli.shared.console import console, print_line, print_notes
    from track_range.fleet.engine.cameras import with_cameras
    from track_range.fleet.engine.plan import fleet_plan
    from track_range.fleet.engine.remaining import check_replaced, remaining, work_text
    from track_range.fleet.errors import ClipsFailedError
    from track_range.fleet.inputs.dry_run import check_clips
    from track_range.fleet.output.data_set import ClipTable
    from track_range.fleet.output.state import duration_text
    from track_range.fleet.storage.location import Location
    from track_range.foundation.files.input_files import counted, printable

    plan = fleet_plan(settings, options)
    clips = with_cameras(clips, plan, console)
    table = ClipTable(Location.of(settings.out))
    todo, n_complete, n_failed = remaining(
        clips, table, plan.keys, is_failed_repeated=settings.retry_failed
    )
    problems: list[tuple[str, str]] = []
    notes: Counter[str] = Counter()  # each is printed once
    seconds = 0.0
    checked_settings = {
        key: options[key] for key in ("focal_px", "fps", "stereo_layout") if key in options
    }
    cameras = names_of(settings.rig_camera or ())
    has_camera = settings.camera is not None
    for checked in check_clips(
        [task.clip for task in todo], has_camera=has_camera, cameras=cameras, **checked_settings
    ):
        seconds += checked.duration_s or 0.0
        texts = (f"  - {printable(text)}" for text in checked.problems)
        print_line(console, printable(_clip_line(checked)), *texts)
        notes.update(checked.notes)
        problems += [(checked.clip.name, problem) for problem in checked.problems[:1]]
    print_notes(console, (f"{note} ({counted(n, 'clip')})" for note, n in notes.items()))
    print_line(
        console,
        f"{work_text(todo, n_complete)}, {n_failed} failed before; {duration_text(seconds)} of "
        "video to process",
    )
    if not settings.overwrite:
        check_replaced(clips, table, plan)
    if problems:
        raise ClipsFailedError(
            f"{len(problems)} of {len(clips)} clips cannot be processed; see the list above."
        )


def _clip_line(checked: CheckedClip) -> str:
    from track_range.fleet.output.state import duration_text
    from track_range.fleet.storage.location import Location

    line = f"{checked.clip.name}: {Location.of(checked.clip.left)}"
    line += "" if checked.size_px is None else f", {checked.size_px[0]}x{checked.size_px[1]}"
    line += "" if checked.fps is None else f" at {checked.fps:.3g} Hz"
    line += "" if checked.duration_s is None else f", {duration_text(checked.duration_s)}"
    return line + (f", calibration: {checked.calibration}" if checked.calibration else "")


def _parameters() -> list[Parameter]:
    """Options of the fleet and of its runs; refused options are hidden."""
    own = parameters(FleetSettings)
    names = {parameter.name for parameter in own}
    shared = [
        parameter
        for parameter in parameters(RunSettings, is_only_given=True)
        if parameter.name not in names
    ]
    for parameter in shared:
        declared = parameter.annotation.__metadata__[0]
        field = RunSettings.model_fields.get(parameter.name)
        if field is not None and option_of(field).instead:
            declared.hidden = True
        for words, own_words in _IN_HELP.items():
            declared.help = (declared.help or "").replace(words, own_words)
    return [*own, *shared]


app = command_of(_fleet_run, _parameters())
