"""Rows and folders of KITTI labels, see `tests.support.recordings.label_rows`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.recordings.label_rows import label_row, write_drives


@pytest.fixture(scope="session")
def row() -> Callable[..., str]:
    return label_row


@pytest.fixture(scope="session")
def drives() -> Callable[..., tuple[Path, Path]]:
    return write_drives
