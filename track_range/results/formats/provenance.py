"""Provenance: software, model, calibration and settings that results were made with; stored in the
result files.

`foundation.schemas.schema_version.SCHEMA_VERSION` is the version of all result files of a run:
docs/reference/schema.md lists what it promises.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any, Self

from track_range.foundation.schemas.schema_version import METADATA_PREFIX, SCHEMA_VERSION

_NOT_HASHED = frozenset(  # settings of the output files, which do not affect the rows
    (
        *(
            "out",
            "overwrite",
            "table",
            "write",
            "mcap_profile",
            "mcap_images",
            "overlay",
            "clips",
            "keep_gps",
        ),
        *("disparity", "overlay_disparity", "overlay_cuboids", "overlay_recorded"),
    )
)

_MODEL = ("detector", "detections")
_RIG = ("focal_px", "baseline_m", "image_size_px")  # in section `found` of settings.yaml


@dataclass(frozen=True, slots=True, kw_only=True)
class Provenance:
    """Origin of results."""

    version: str = field(default_factory=lambda: version("track-range"))
    # the detector, or the name of the file of detections
    model: Mapping[str, Any] = field(default_factory=dict)
    # calibration: kind, file, focal length, baseline, image size
    rig: Mapping[str, Any] = field(default_factory=dict)
    settings_hash: str = ""  # `settings_hash` of the settings; "" = unknown
    # of time_s = 0, its source and uncertainty; empty = unknown
    utc: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of_inputs(cls, detected: Mapping[str, Any], settings_hash: str) -> Self:
        """Origin of a run's results, from section `found` of its settings.yaml, which may lack
        values.
        """
        versions, file, utc = detected.get("versions"), detected.get("rig"), detected.get("utc")
        run_version = versions.get("track-range") if isinstance(versions, Mapping) else None
        rig = {
            "calibration": detected.get("calibration"),
            "file": os.path.basename(str(file)) if file else None,
        }
        return cls(
            version=run_version if isinstance(run_version, str) else version("track-range"),
            model={key: detected[key] for key in _MODEL if key in detected},
            rig={**rig, **{key: detected[key] for key in _RIG if key in detected}},
            settings_hash=settings_hash,
            utc=utc if isinstance(utc, Mapping) else {},
        )

    def metadata(self) -> dict[str, str]:
        """Values as text with the prefix `track_range.`, for the metadata of files; mappings as
        JSON.
        """
        values = {
            "version": self.version,
            "schema_version": str(SCHEMA_VERSION),
            "model": _canonical(self.model),
            "rig": _canonical(self.rig),
            "settings_hash": self.settings_hash,
            "utc": _canonical(self.utc),
        }
        return {f"{METADATA_PREFIX}{key}": value for key, value in values.items()}


def settings_hash(
    run: Mapping[str, Any],
    methods: Mapping[str, str] | None = None,
    file_hashes: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """SHA-256 of sections `run` and `methods` of a settings.yaml in canonical JSON, without
    settings of output files, and of the content of the files that the run reads.

    `file_hashes` are the hashes of these files by setting, such as `rig`. Two runs have the same
    hash if they read the same content from the same paths with the same options and methods,
    whatever they write.
    """
    hashed = {key: value for key, value in run.items() if key not in _NOT_HASHED}
    others = {"methods": methods, "file_hashes": file_hashes}
    text = _canonical({**hashed, **{key: value for key, value in others.items() if value}})
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def _canonical(section: Mapping[str, Any]) -> str:
    """JSON with sorted keys; dates and other values that only YAML has are written as text."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {str(key): plain(part) for key, part in value.items()}
        if isinstance(value, list | tuple):
            return [plain(part) for part in value]
        return value if value is None or isinstance(value, str | int | float) else str(value)

    return json.dumps(plain(section), sort_keys=True, separators=(",", ":"), ensure_ascii=True)
