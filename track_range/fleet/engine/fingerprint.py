"""Fingerprints of the inputs of a clip: by size and time of change, and by content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from track_range.fleet.inputs.clip import Clip, is_file_setting
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location


def present_fingerprint(clip: Clip) -> str:
    """`fingerprint` of a clip's files as they are; "" if the storage cannot be reached."""
    try:
        stats = {role: Location.of(address).stat() for role, address in clip.files().items()}
    except StorageError:
        return ""
    return fingerprint(
        clip, {role: (-1, -1) if stat is None else (stat.size, stat.mtime_ns) for role, stat in stats.items()}
    )


def fingerprint(clip: Clip, files: Mapping[str, tuple[int, int]]) -> str:
    """Files of a clip with size and time of change, and its settings, as canonical JSON."""
    return _canonical(clip, {role: list(state) for role, state in files.items()})


def content_hash(clip: Clip, digests: Mapping[str, str]) -> str:
    """Hash of the content of the files of a clip, given as SHA-256, and of its settings."""
    return f"sha256:{hashlib.sha256(_canonical(clip, digests).encode()).hexdigest()}"


def _canonical(clip: Clip, files: Mapping[str, Any]) -> str:
    settings = {name: value for name, value in clip.settings.items() if not is_file_setting(name, value)}
    return json.dumps({"files": files, "settings": settings}, sort_keys=True, separators=(",", ":"))
