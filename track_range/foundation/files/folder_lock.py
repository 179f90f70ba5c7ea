"""Lock of an output folder: one run at a time writes to it.

The operating system locks the file `.running` in the folder. It releases the lock when the process
ends, even after kill -9, so that a file left by a killed run does not lock the folder, and two runs
that find such a file cannot both take it. The file contains the process, its start time and the
host, for messages.

On file systems without such locks (some network file systems) the folder is not locked.
"""

import errno
import json
import os
import socket
import sys
import weakref
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from track_range.foundation.errors import UserError
from track_range.foundation.files.atomic_files import describe

LOCK_FILE = ".running"

# of file systems without locks
_UNSUPPORTED = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)
_MAX_OWNER_BYTES = 1000  # largest number of bytes that are read from a lock file
# offset of the byte that is locked on Windows, where a locked byte cannot be read
_LOCKED_BYTE = 1 << 30


class FolderLockError(UserError):
    """Another run is writing to the folder, or the folder cannot be locked."""


class FolderLock:
    """Lock of a folder until `release`, the end of the process, or its deletion; may raise
    FolderLockError.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK_FILE
        try:
            descriptor = _open_locked(self._path)
        except OSError as error:
            raise FolderLockError(
                f"{self._path}: cannot be created ({describe(error)})."
            ) from error
        if descriptor is None:
            owner = read_owner(folder)
            detail = "" if owner is None else f" ({owner})"
            raise FolderLockError(
                f"{folder}: another run{detail} is writing to this folder; wait for its end, or "
                "choose another --out."
            )
        started = datetime.now().astimezone().isoformat(" ", "seconds")
        owner_json = json.dumps(
            {"pid": os.getpid(), "started": started, "host": socket.gethostname()}
        )
        # on a full disk the lock works, only the message to another run lacks the process
        with suppress(OSError):
            os.ftruncate(descriptor, 0)
            os.write(descriptor, owner_json.encode())
        self._release = weakref.finalize(self, _release, descriptor, self._path, os.getpid())

    def release(self) -> None:
        """Remove the lock file and release the lock; a second call does nothing."""
        self._release()


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Context in which no other run can write to an existing folder; raises FolderLockError if
    another run does.
    """
    lock = FolderLock(folder)
    try:
        yield
    finally:
        lock.release()


def is_locked(folder: Path) -> bool:
    """Whether a run is writing to the folder."""
    try:
        descriptor = os.open(folder / LOCK_FILE, os.O_RDWR)
    except OSError:
        return False
    try:
        return not _try_lock(descriptor)
    finally:
        os.close(descriptor)


def read_owner(folder: Path) -> str | None:
    """The process in the lock file of a folder, which may have ended, for messages; None without a
    readable file.
    """
    try:
        with (folder / LOCK_FILE).open("rb") as file:
            content = json.loads(file.read(_MAX_OWNER_BYTES))
        host = str(content["host"])[:60]
        place = "" if host == socket.gethostname() else f" on {host}"
        return f"process {int(content['pid'])}{place}, started {str(content['started'])[:40]}"
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None


def _open_locked(path: Path) -> int | None:
    """Descriptor of the locked file; None if another process has locked it."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
        try:
            if not _try_lock(descriptor):
                os.close(descriptor)
                return None
            # The previous owner may have removed the file between these calls; a lock on it would
            # not count.
            with suppress(FileNotFoundError):
                if sys.platform == "win32" or os.path.samestat(os.fstat(descriptor), os.stat(path)):
                    return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _try_lock(descriptor: int) -> bool:
    """Lock a file for this process; False if another process has locked it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
            try:
                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            finally:
                os.lseek(descriptor, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _UNSUPPORTED:
            return True
        if error.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
            return False
        raise
    return True


def _release(descriptor: int, path: Path, pid: int) -> None:
    if os.getpid() == pid:  # not in a forked process, which has a copy of the descriptor
        with suppress(OSError):
            # before the lock is released, so that the file of the next run is not removed
            path.unlink()
    with suppress(OSError):
        os.close(descriptor)
    if sys.platform == "win32" and os.getpid() == pid:
        with suppress(OSError):
            path.unlink()
