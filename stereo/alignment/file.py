"""Alignment files: align.yaml, with the unit in every key, as `track-range align` writes it.

    track_range_align: 1
    offset_px: 0.45                 d_true = d_measured + offset_px + bow_px u^2, see `stereo.alignment`
    offset_sigma_px: 0.05
    bow_px: 1.57
    bow_sigma_px: 0.12
    row_offset_px: 0.22
    residual_px: 0.21
    source: this drive, 32 frames

Keys that are left out keep what an alignment that nobody measured has.
"""

from __future__ import annotations

import math
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import yaml

from track_range.stereo.alignment.model import Alignment
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.rig_format import write_rig_text

_VERSION = 1
_VERSION_KEY = "track_range_align"
_MAX_BYTES = 100_000
_MAX_PX = 100.0
"""No pair that is called calibrated is as wrong; a number in other units is."""

_NUMBERS = tuple(field.name for field in fields(Alignment) if field.name != "source")
_SIGMAS = ("residual_px", "offset_sigma_px", "bow_sigma_px")
_HINT = "write one with `track-range align`"


def save_alignment(alignment: Alignment, path: Path) -> None:
    """Write an alignment; the file appears whole or not at all.

    Raises:
        RigError: the file cannot be written.
    """
    content = {_VERSION_KEY: _VERSION, **asdict(alignment)}
    write_rig_text(path, yaml.safe_dump(content, sort_keys=False, width=120, allow_unicode=True))


def load_alignment(path: Path) -> Alignment:
    """The alignment of a file.

    Raises:
        RigError: it cannot be read, is no alignment, or holds what cannot be.
    """
    content = _content(path)
    version = content.pop(_VERSION_KEY)
    if type(version) is not int or version != _VERSION:
        raise RigError(f"{path}: it is an alignment of version {version!r}, this program reads version {_VERSION}.")
    if "offset_px" not in content:
        raise RigError(f"{path}: the key 'offset_px' is missing; {_HINT}.")
    known = {*_NUMBERS, "source"}
    if unknown := sorted(str(key) for key in content if key not in known):
        raise RigError(f"{path}: the key '{unknown[0]}' is unknown; correct it.")
    for key in _NUMBERS:
        if key in content:
            content[key] = _number(content[key], key, path)
    source = content.get("source", str(path))
    if not isinstance(source, str):
        raise RigError(f"{path}: 'source' is {source!r}; text is wanted.")
    return Alignment(**{**content, "source": source})


def _content(path: Path) -> dict[Any, Any]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise RigError(f"{path}: it is far too large for an alignment; {_HINT}.")
        content = yaml.safe_load(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        raise RigError(f"{path}: there is no such file; {_HINT}.") from error
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); {_HINT}.") from error
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise RigError(f"{path}: it is not readable as YAML, so no alignment; {_HINT}.") from error
    if not isinstance(content, dict) or _VERSION_KEY not in content:
        raise RigError(f"{path}: it is no alignment (no key '{_VERSION_KEY}'); {_HINT}.")
    return content


def _number(value: object, key: str, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise RigError(f"{path}: '{key}' is {value!r}; a number of pixels is wanted.")
    if abs(value) > _MAX_PX or (key in _SIGMAS and value < 0):
        least = 0 if key in _SIGMAS else -_MAX_PX
        raise RigError(f"{path}: '{key}' is {value!r}; {least:g} .. {_MAX_PX:g} px is plausible.")
    return float(value)
