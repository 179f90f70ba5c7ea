"""`track-range track`: tracks recorded detections, without distances."""

from collections.abc import Sequence
from functools import partial

from track_range.cli.shared.console import console, print_grid, print_line
from track_range.cli.shared.parameters import command
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.evaluation.sequences.find import MOT_FOLDER, listed
from track_range.evaluation.sequences.settings import TrackSettings
from track_range.evaluation.sequences.track import TrackedFile, track
from track_range.run.progress import frame_progress
from track_range.views.tables import Column, Grid, grid_of


def _track(settings: TrackSettings) -> None:
    tracked = track(
        settings, partial(frame_progress, console), lambda note: print_line(console, f"- {note}")
    )
    if tracked.done:
        print_grid(console, _grid(tracked.done))
        print_line(console, f"Written: {settings.out / MOT_FOLDER}")
    if tracked.failed:
        n_sequences = len(tracked.done) + len(tracked.failed)
        failed = (
            f"{len(tracked.failed)} of {n_sequences} sequences could not be tracked (reasons above)"
        )
        raise LabelFileError(f"{settings.detections}: {failed}: {listed(list(tracked.failed))}.")


def _grid(done: Sequence[TrackedFile]) -> Grid:
    columns = [
        Column("frames", [float(sequence.n_frames) for sequence in done], "{:.0f}"),
        Column("boxes", [float(sequence.n_boxes) for sequence in done], "{:.0f}"),
        Column("tracks", [float(sequence.n_tracks) for sequence in done], "{:.0f}"),
        Column("\N{MICRO SIGN}s per frame", [sequence.us_per_frame for sequence in done], "{:.0f}"),
    ]
    return grid_of("Tracks", "sequence", [sequence.name for sequence in done], columns)


app = command(TrackSettings, _track)
