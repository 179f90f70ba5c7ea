"""Lock of an output folder: one owner, locks of killed processes, removal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from track_range.foundation.files.folder_lock import (
    LOCK_FILE,
    FolderLock,
    FolderLockError,
    is_locked,
    locked_folder,
    read_owner,
)

KILLED = """
import os, signal, sys
from pathlib import Path
from track_range.foundation.files.folder_lock import FolderLock
lock = FolderLock(Path(sys.argv[1]))
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_second_owner_is_refused(tmp_path: Path) -> None:
    with locked_folder(tmp_path):
        assert is_locked(tmp_path)
        for _ in range(2):
            with pytest.raises(
                FolderLockError, match=f"process {os.getpid()}, started 2"
            ) as caught:
                FolderLock(tmp_path)
            assert len(str(caught.value)) - len(str(tmp_path)) < 300
    assert not is_locked(tmp_path)
    assert list(tmp_path.iterdir()) == []
    with locked_folder(tmp_path):
        pass


def test_lock_of_a_killed_process(tmp_path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    assert ended.returncode == -signal.SIGKILL
    owner = read_owner(tmp_path)
    assert owner is not None
    assert not is_locked(tmp_path)
    with locked_folder(tmp_path):
        assert read_owner(tmp_path) != owner


@pytest.mark.parametrize("content", [b"", b"4711", b"[" * 5000, b'{"pid": 1e400}', b"\xff" * 10])
def test_unreadable_lock_files(tmp_path: Path, content: bytes) -> None:
    (tmp_path / LOCK_FILE).write_bytes(content)
    assert read_owner(tmp_path) is None
    with locked_folder(tmp_path):
        (tmp_path / LOCK_FILE).write_bytes(content)
        with pytest.raises(FolderLockError, match="another run is writing"):
            FolderLock(tmp_path)


def test_one_of_many_gets_a_stale_lock(tmp_path: Path) -> None:
    n_owners, n_at_once = 0, 0
    counted = threading.Lock()

    def take() -> None:
        nonlocal n_owners, n_at_once
        for _ in range(30):
            try:
                lock = FolderLock(tmp_path)
            except FolderLockError:
                continue
            with counted:
                n_owners += 1
                n_at_once += 1
                assert n_at_once == 1
            with counted:
                n_at_once -= 1
            lock.release()

    (tmp_path / LOCK_FILE).write_text("{}")
    threads = [threading.Thread(target=take) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert n_owners >= 1
    assert not (tmp_path / LOCK_FILE).exists()


def test_lock_file_that_cannot_be_created(tmp_path: Path) -> None:
    (tmp_path / LOCK_FILE).mkdir()
    with pytest.raises(FolderLockError, match="cannot be created"):
        FolderLock(tmp_path)
    assert not is_locked(tmp_path)
