"""Folder of a worker for remote recordings and unfinished results, removed with the worker.

A worker that is killed leaves its folder. The driver removes it if it is on the same machine, otherwise the next worker
there does.
"""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
from pathlib import Path

from track_range.foundation.processes import is_running

_PREFIX = "track-range-fleet-"


def folder_of(pid: int, cache_dir: Path | None) -> Path:
    """Folder of the worker with a process id on this machine.

    Args:
        pid: the process.
        cache_dir: folder for it; None = the temporary folder.
    """
    return (cache_dir or Path(_temporary_folder())) / f"{_host_prefix()}{pid}"


def open_scratch(cache_dir: Path | None) -> Path:
    """The folder of this process, as its temporary folder from now on; those of processes that were killed are removed.

    Raises:
        OSError: the folder cannot be created.
    """
    folder = folder_of(os.getpid(), cache_dir)
    if folder.parent.is_dir():
        for old in folder.parent.glob(f"{_host_prefix()}*"):
            pid = old.name.removeprefix(_host_prefix())
            if pid.isdigit() and not is_running(int(pid)):
                shutil.rmtree(old, ignore_errors=True)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    tempfile.tempdir = str(folder)
    return folder


def _host_prefix() -> str:
    return f"{_PREFIX}{platform.node() or 'host'}-"


def _temporary_folder() -> str:
    """The temporary folder of the machine, also after `open_scratch`."""
    before, tempfile.tempdir = tempfile.tempdir, None
    try:
        return tempfile.gettempdir()
    finally:
        tempfile.tempdir = before
