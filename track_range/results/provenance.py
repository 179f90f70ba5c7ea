"""Provenance: software, model, calibration and settings that results were made with; stored in the result files.

`foundation.schema_version.SCHEMA_VERSION` is the version of all result files of a run together: docs/schema.md lists
what it promises.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

from track_range.foundation.schema_version import METADATA_PREFIX, SCHEMA_VERSION

_NOT_HASHED = ("out", "table", "write")
"""Settings that do not affect the results."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Origin of results.

    Attributes:
        schema_version: version of the result files.
        version: version of track-range.
        model: properties of the detector, or the name of the file of detections.
        rig: properties of the calibration: kind, name of the file, focal length, baseline, image size.
        settings_hash: `settings_hash` of the settings; "" = unknown.
        utc: UTC of the first frame of the video (`time_s` = 0), its source and its uncertainty; empty = unknown.
    """

    schema_version: int = SCHEMA_VERSION
    version: str = field(default_factory=lambda: version("track-range"))
    model: Mapping[str, Any] = field(default_factory=dict)
    rig: Mapping[str, Any] = field(default_factory=dict)
    settings_hash: str = ""
    utc: Mapping[str, Any] = field(default_factory=dict)

    def section(self) -> dict[str, Any]:
        """Values for summary.json and settings.yaml."""
        return {"schema_version": self.schema_version, "settings_hash": self.settings_hash}

    def metadata(self) -> dict[str, str]:
        """Values as text with the prefix `track_range.`, for the metadata of files; mappings as JSON."""
        values = {
            "version": self.version,
            "schema_version": str(self.schema_version),
            "model": json.dumps(self.model, sort_keys=True),
            "rig": json.dumps(self.rig, sort_keys=True),
            "settings_hash": self.settings_hash,
            "utc": json.dumps(self.utc, sort_keys=True),
        }
        return {f"{METADATA_PREFIX}{key}": value for key, value in values.items()}


def settings_hash(run: Mapping[str, Any]) -> str:
    """SHA-256 of section `run` of a settings.yaml in canonical JSON, without the settings of the output files.

    Two runs have the same hash if they read the same paths with the same options.
    """
    hashed = {key: value for key, value in run.items() if key not in _NOT_HASHED}
    text = json.dumps(hashed, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"
