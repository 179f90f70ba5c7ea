"""Schema of summary.json, for reading files that were damaged, edited, or written by another version.

Values of wrong types are omitted, and the rest is used; keys that are not listed here may have any value.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

Number = Annotated[float, Field(strict=True)]
Figure = Annotated[float, Field(strict=True, gt=-1e15, lt=1e15, allow_inf_nan=False)] | None
"""Finite number, or null = unknown; the limits are larger than any value of a run."""
Text = Annotated[str, Field(strict=True)] | None


class _Section(BaseModel):
    model_config = ConfigDict(extra="allow")


class _Figures(_Section):
    """Section in which all other keys are figures too."""

    __pydantic_extra__: dict[str, Figure]


class _Band(_Figures):
    from_m: Number
    to_m: Number


class _Method(_Figures):
    bands: list[_Band] | None = None
    by_class: dict[str, dict[str, Figure]] | None = None


class _Tracks(_Figures):
    classes: list[Text] | None = None


class _RigDistance(_Figures):
    distance_m: Number


class _Health(_Section):
    state: Text = None
    sentence: Text = None
    move_sentence: Text = None
    unseen: Text = None
    distances: list[_RigDistance] = []


class _Alignment(_Figures):
    source: Text = None
    is_applied: Any = None
    health: _Health | None = None


class _Events(_Section):
    n: Figure = None
    hours: Figure = None
    by_kind: dict[str, Figure] = {}
    worst: dict[str, Any] | None = None


class _Utc(_Section):
    start: Text = None
    source: Text = None
    uncertainty_s: Figure = None


class _EgoSpeed(_Section):
    source: Text = None
    offset_s: Figure = None
    offset_sigma_s: Figure = None
    median_mps: Figure = None
    coverage: Figure = None


class _LearntScale(_Figures):
    n_tracks: Number
    baseline_m: Number
    focal_px: Number
    relative_sigma: Number


class _Summary(_Section):
    schema_version: Figure = None
    settings_hash: Text = None
    frames: Figure = None
    starts_s: Figure = None
    utc: _Utc | None = None
    ego_speed: _EgoSpeed | None = None
    wall_s: Figure = None
    frames_per_s: Figure = None
    focal_px: Figure = None
    focal_sigma: Figure = None
    baseline_m: Figure = None
    truth: Text = None
    calibration: Text = None
    stages_ms: dict[str, Figure] = {}
    closing: dict[str, Figure] = {}
    stereo_unmatched: dict[str, Figure] = {}
    stereo_surfaces: dict[str, Figure] = {}
    methods: dict[str, _Method] = {}
    common: dict[str, _Method] = {}
    inputs: dict[str, Any] = {}
    settings: dict[str, Any] = {}
    versions: dict[str, Any] = {}
    tracks: _Tracks | None = None
    events: _Events | None = None
    alignment: _Alignment | None = None
    learnt_scale: _LearntScale | None = None
    files: dict[str, Text] = {}
    notes: list[Text] = []


def valid_summary(summary: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Part of a summary with values of the right types, and the dotted names of the omitted values."""
    valid, invalid = _copied(summary), list[str]()
    while True:
        try:
            _Summary.model_validate(valid)
        except ValidationError as error:
            # A section without a required key is omitted as a whole.
            paths = {e["loc"][:-1] if e["type"] == "missing" else e["loc"] for e in error.errors()}
            ordered = sorted(
                paths, key=lambda path: [(-1, part) if isinstance(part, str) else (part, "") for part in path]
            )
            invalid += [".".join(map(str, path)) for path in ordered]
            for *sections, name in reversed(ordered):  # the last item of a list first
                container = valid
                for part in sections:
                    container = container[part]
                del container[name]
        else:
            return valid, invalid


def _copied(value: Any) -> Any:
    """Deep copy with mutable mappings and lists; keys are strings."""
    if isinstance(value, Mapping):
        return {str(key): _copied(part) for key, part in value.items()}
    return [_copied(part) for part in value] if isinstance(value, list) else value
