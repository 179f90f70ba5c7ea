"""Alignment files: align.yaml, with units in the keys, as written by `track-range align`.

    track_range_align: 1
    offset_px: 0.45                 d_true = d_measured + offset_px + bow_px u^2, see `stereo.alignment.model`
    offset_sigma_px: 0.05
    bow_px: 1.57
    bow_sigma_px: 0.12
    row_offset_px: 0.22
    residual_px: 0.21
    source: this drive, 32 frames

Missing keys have the values of an alignment that was not measured.
"""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from track_range.stereo.alignment.model import KEYS, Alignment
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.rig_format import write_rig_text

_VERSION = 1
_VERSION_KEY = "track_range_align"

_MAX_BYTES = 100_000
"""Largest size of an alignment file."""

_MAX_PX = 100.0
"""Largest plausible value of a calibrated pair; larger values are in other units."""

_FIELDS = {KEYS.get(field.name, field.name): field.name for field in fields(Alignment)}
"""Fields of `Alignment` by key."""

_SIGMAS = ("residual_px", "offset_sigma_px", "bow_sigma_px")
"""Keys of standard deviations, which are not negative."""

_HINT = "write one with `track-range align`"


def save_alignment(alignment: Alignment, path: Path) -> None:
    """Write an alignment file atomically.

    Raises:
        RigError: the file cannot be written.
    """
    content = {_VERSION_KEY: _VERSION, **alignment.to_dict()}
    write_rig_text(path, yaml.safe_dump(content, sort_keys=False, width=120, allow_unicode=True))


def load_alignment(path: Path) -> Alignment:
    """The alignment of a file.

    Raises:
        RigError: the file cannot be read, is not an alignment, or has a wrong value.
    """
    content = _content(path)
    version = content.pop(_VERSION_KEY)
    if type(version) is not int or version != _VERSION:
        raise RigError(f"{path}: expected version {_VERSION} of the alignment format, found version {version!r}.")
    if "offset_px" not in content:
        raise RigError(f"{path}: expected the key 'offset_px', found none; {_HINT}.")
    if unknown := sorted(str(key) for key in content if key not in _FIELDS):
        raise RigError(f"{path}: unknown key '{unknown[0]}'; expected {', '.join(_FIELDS)}.")
    source = content.pop("source", str(path))
    if not isinstance(source, str):
        raise RigError(f"{path}: expected text for 'source', found {source!r}.")
    values = {_FIELDS[key]: _number(value, key, path) for key, value in content.items()}
    return Alignment(**values, source=source)


def _content(path: Path) -> dict[Any, Any]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise RigError(f"{path}: expected an alignment file of at most 100 kB, found a larger file; {_HINT}.")
        content = yaml.safe_load(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        raise RigError(f"{path}: no such file; {_HINT}.") from error
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); {_HINT}.") from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise RigError(
            f"{path}: expected an alignment in YAML, found another format or a damaged file; {_HINT}."
        ) from error
    if not isinstance(content, dict) or _VERSION_KEY not in content:
        raise RigError(f"{path}: expected an alignment, found no key '{_VERSION_KEY}'; {_HINT}.")
    return content


def _number(value: object, key: str, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise RigError(f"{path}: expected a number of pixels for '{key}', found {value!r}.")
    if abs(value) > _MAX_PX or (key in _SIGMAS and value < 0):
        low = 0 if key in _SIGMAS else -_MAX_PX
        raise RigError(f"{path}: expected '{key}' between {low:g} and {_MAX_PX:g} px, found {value!r}.")
    return float(value)
