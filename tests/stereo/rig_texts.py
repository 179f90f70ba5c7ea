"""Rig files with a given content, and the messages about those that are refused."""

from __future__ import annotations

from pathlib import Path

import yaml

from tests.support.error_messages import error_message
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.reading import load_rig

SIZE = (1280, 720)


def written(folder: Path, content: object, name: str = "rig.yaml") -> Path:
    """A file with this text, or with this content as YAML."""
    path = folder / name
    path.write_text(
        content if isinstance(content, str) else yaml.safe_dump(content), encoding="utf-8"
    )
    return path


def refused(path: Path, *, size_px: tuple[int, int] = SIZE) -> str:
    """The message of `load_rig`: one sentence with the path."""
    message = error_message(RigError, load_rig, path, size_px=size_px)
    assert str(path) in message
    assert message.endswith(".")
    return message
