"""PreparedFolder: output folder of a run before its first frame, locked and with a note on the progress."""

from __future__ import annotations

import os
import time
import weakref
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from track_range.foundation.files.folder_lock import FolderLock
from track_range.foundation.files.output_files import OutputError, make_folder
from track_range.results.progress_note import OPENING, PROCESSING, PROGRESS_FILE, ProgressNote
from track_range.results.writers import result_names
from track_range.run.settings import RunSettings, save_settings

_NOTE_INTERVAL_S = 1.0
"""Minimum time between two notes on the number of frames."""


class PreparedFolder:
    """Output folder of a run, from the start of the run to its end.

    The folder is locked, and contains progress.json and, unless the folder has one of an earlier run, settings.yaml.
    Results of an earlier run remain until `confirm`, so that a run with unusable inputs does not remove them; such a
    run also removes what it created.

    Args:
        settings: settings of the run.
        folder: the output folder.

    Attributes:
        folder: the output folder.

    Raises:
        FolderLockError: another run is writing to the folder.
        OutputError: the folder cannot be written to.
    """

    def __init__(self, settings: RunSettings, folder: Path) -> None:
        self.folder = folder
        self._files: list[Path] = []
        self._folders = [path for path in (folder, *folder.parents) if not path.exists()]
        try:
            make_folder(folder)
            lock = FolderLock(folder)
        except BaseException:
            _remove([], self._folders)
            raise
        self._close = weakref.finalize(self, _close, self._files, self._folders, lock, os.getpid())
        self._note = ProgressNote(OPENING, os.getpid(), datetime.now().astimezone().isoformat(" ", "seconds"))
        self._last_note_s = time.monotonic()
        try:
            if not (folder / "settings.yaml").exists() or self._is_of_killed_run():
                self._files.append(folder / "settings.yaml")
                save_settings(settings, folder / "settings.yaml")
            self._files.append(folder / PROGRESS_FILE)
            self._note.write(folder)
        except BaseException:
            self.close()
            raise

    def report(self, state: str) -> None:
        """Change the state in progress.json.

        Raises:
            OutputError: the file cannot be written.
        """
        self._note = self._note.with_state(state)
        self._note.write(self.folder)

    def report_frames(self, n_frames: int) -> None:
        """Update the number of frames in progress.json, at most once per second."""
        now_s = time.monotonic()
        if now_s - self._last_note_s >= _NOTE_INTERVAL_S:
            self._last_note_s = now_s
            with suppress(OutputError):  # the note is not a result
                self._note.with_state(PROCESSING, frames=n_frames).write(self.folder)

    def confirm(self) -> None:
        """Keep the folder and its files, except progress.json, after `close`: the inputs proved usable.

        Temporary files `.PID.NAME` of runs that were killed are removed (see `atomic_files`).
        """
        names = result_names()
        for path in self.folder.glob(".[0-9]*.*"):
            if path.name.lstrip(".0123456789") in names:
                _remove([path], [])
        self._folders.clear()
        self._files[:] = [self.folder / PROGRESS_FILE]

    def close(self) -> None:
        """Remove the note and the lock and, without `confirm`, all that was created; a second call does nothing."""
        self._close()

    def _is_of_killed_run(self) -> bool:
        """Whether the folder is of a run that was killed before it created its results."""
        names = [name for name in result_names() if (self.folder / name).exists()]
        return sorted(names) == [PROGRESS_FILE, "settings.yaml"]


def _close(files: Sequence[Path], folders: Sequence[Path], lock: FolderLock, pid: int) -> None:
    if os.getpid() == pid:  # not in a forked process
        _remove(files, [])
        lock.release()
        _remove([], folders)


def _remove(files: Sequence[Path], folders: Sequence[Path]) -> None:
    """Remove files and empty folders, as far as possible."""
    for file in files:
        with suppress(OSError):
            file.unlink(missing_ok=True)
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
