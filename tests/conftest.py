"""Fixtures that every test may use."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data (never part of the project); tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("TRACK_RANGE_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real data not here: no folder {folder} (set TRACK_RANGE_DATA)")
    return folder
