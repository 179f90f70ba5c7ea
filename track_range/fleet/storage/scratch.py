"""scratch_folder: a temporary folder of a process; that of a killed process is removed by the next one.

Each folder has a lock of the operating system (`foundation.files.folder_lock`), which ends with its process. A folder
gets its final name after it has been locked, so that it cannot be removed between the two.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from track_range.fleet.storage.errors import storage_errors
from track_range.foundation.files.folder_lock import FolderLock, is_locked

_PREFIX, _NEW_PREFIX = "track-range-scratch-", "track-range-new-"

_NEW_S = 60.0
"""Age, s, from which a folder without lock that has no final name counts as left over."""


@contextmanager
def scratch_folder(parent: Path) -> Iterator[Path]:
    """A new, empty folder in `parent`, which is created; removed at the end. Those of ended processes are removed too.

    Raises:
        StorageError: it cannot be created.
        FolderLockError: it cannot be locked.
    """
    with storage_errors(parent, "written"):
        parent.mkdir(parents=True, exist_ok=True)
        new = Path(tempfile.mkdtemp(prefix=_NEW_PREFIX, dir=parent))
    lock = FolderLock(new)
    folder = parent / f"{_PREFIX}{os.getpid()}-{new.name.removeprefix(_NEW_PREFIX)}"
    try:
        with storage_errors(parent, "written"):
            if is_locked(new):  # otherwise the file system has no locks, and those of others cannot be seen either
                remove_left_over(parent)
            new.rename(folder)
            content = folder / "content"
            content.mkdir()
        yield content
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(new, ignore_errors=True)
        lock.release()


def remove_left_over(parent: Path) -> None:
    """Remove the scratch folders of processes that have ended; others stay."""
    for folder in parent.iterdir():
        is_final = folder.name.startswith(_PREFIX)
        is_old = folder.name.startswith(_NEW_PREFIX) and _age_s(folder) > _NEW_S
        if (is_final or is_old) and not is_locked(folder):
            shutil.rmtree(folder, ignore_errors=True)


def _age_s(folder: Path) -> float:
    with suppress(OSError):
        return time.time() - folder.stat().st_mtime
    return 0.0
