"""Fingerprints of the inputs of a clip: by size and time of change, and by content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from track_range.fleet.inputs.clip import Clip, is_file_setting
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.listings import FolderListings
from track_range.fleet.storage.location import Location


def present_fingerprint(clip: Clip, listings: FolderListings | None = None) -> str:
    """`fingerprint` of a clip's files as they are; "" if the storage cannot be reached.

    Args:
        clip: the clip.
        listings: sizes and times, for many clips; None = those at this moment.
    """
    listings = listings or FolderListings()
    try:
        states = {role: listings.state(Location.of(address)) for role, address in clip.files(listings.stat).items()}
    except StorageError:
        return ""
    return fingerprint(
        clip, {role: (-1, -1) if state is None else (state.size, state.mtime_ns) for role, state in states.items()}
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
