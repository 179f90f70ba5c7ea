"""progress.json: state of a run in progress; it remains in the folder only if the run is killed."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from track_range.foundation.errors import UserError
from track_range.foundation.files.atomic_files import writable, write_text
from track_range.foundation.files.folder_lock import is_locked
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.files.structured_text import read_json

PROGRESS_FILE = "progress.json"

OPENING, LOADING, PROCESSING = "opening the inputs", "loading the networks", "processing frames"
"""States of a run, besides "estimating the alignment"."""

_MAX_STATE_LENGTH = 60  # maximum number of characters of a state that is read from a file


@dataclass(frozen=True, slots=True)
class ProgressNote:
    """State of a run in progress."""

    state: str
    pid: int
    started: str  # local time, ISO 8601
    frames: int = 0  # in the files of the rows

    def write(self, folder: Path) -> None:
        """Write progress.json atomically; OutputError if it cannot be written."""
        path = folder / PROGRESS_FILE
        with writable(path, OutputError):
            # Not flushed to the disk: the note is of use after a kill, not after a power failure.
            write_text(path, json.dumps(asdict(self)) + "\n", is_flushed=False)


def read_progress(folder: Path) -> ProgressNote | None:
    """The note in the folder of a run; None without a readable note."""
    try:
        content: Any = read_json(folder / PROGRESS_FILE, UserError, "the progress note of a run")
        state, started = (str(content[key])[:_MAX_STATE_LENGTH] for key in ("state", "started"))
        return ProgressNote(state, int(content["pid"]), started, int(content["frames"]))
    except (UserError, KeyError, TypeError, ValueError, OverflowError):
        return None


def describe_progress(folder: Path) -> str | None:
    """Clause on an unfinished run, such as "the run ... was killed while processing frames"; None
    without a note.
    """
    note = read_progress(folder)
    if note is None:
        return None
    verb = "is" if is_locked(folder) else "was killed while"
    return f"the run (process {note.pid}, started {note.started}) {verb} {note.state}"
