"""Curve files: size models as JSON, with a version and the kind of model.

`cuboids` (packaged): priors over sizes, yaw and the ground plane (`cuboid_sizes`). `log-linear`: a log-linear curve per
class (`log_linear`). `table`: a plain curve per class, such as Zhang's polynomial, made monotonic (`tables`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from track_range.foundation.atomic_files import describe, write_text
from track_range.foundation.errors import UserError
from track_range.ranging.size_models import cuboid_sizes, log_linear, tables
from track_range.ranging.size_models.size_model import StoredSizeModel

CURVE_VERSION = 2
"""Version of the file format that is written and read."""

_VERSION_KEY = "track_range_size_curves"
"""Key of the version in a curve file, which also identifies the format."""


class CurveError(UserError):
    """A curve file that cannot be used, or labels to which no curve can be fitted; the message gives the reason."""


_READERS: Mapping[str, Callable[[Mapping[str, Any]], StoredSizeModel]] = {
    cuboid_sizes.KIND: cuboid_sizes.cuboids_in,
    log_linear.KIND: log_linear.log_linear_in,
    tables.KIND: tables.tables_in,
}
"""Reader of each kind of curve file."""


def load_curves(path: Path | None = None) -> StoredSizeModel:
    """The size model in a curve file; None = the packaged file.

    Raises:
        CurveError: no such file, another format or version, an unknown kind or class, or an invalid value.
    """
    name, document = _read_document(path)
    kind = str(document.get("kind"))
    if kind not in _READERS:
        raise CurveError(f"{name}: expected a curve file of kind {', '.join(_READERS)}, got {kind}.")
    try:
        return _READERS[kind](document)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise CurveError(f"{name}: expected a track-range curve file ({error!r}).") from error


def save_curves(model: StoredSizeModel, path: Path) -> None:
    """Write a size model as a curve file, atomically.

    Raises:
        CurveError: the file cannot be written.
    """
    document = {_VERSION_KEY: CURVE_VERSION, **model.document()}
    try:
        write_text(path, json.dumps(document, indent=2) + "\n")
    except OSError as error:
        raise CurveError(f"{path}: cannot be written ({describe(error)}).") from error


def _read_document(path: Path | None) -> tuple[str, Mapping[str, Any]]:
    """Name and content of a curve file; None = the packaged file.

    Raises:
        CurveError: no such file, or another format or version.
    """
    packaged = resources.files("track_range.ranging").joinpath("curves/cuboids.json")
    name = str(path or packaged)
    try:
        document = json.loads((path or packaged).read_text(encoding="utf-8"))
        version = document[_VERSION_KEY]
    except OSError as error:
        raise CurveError(f"{name}: cannot be read ({error.strerror or error}).") from error
    except (ValueError, KeyError, TypeError) as error:
        raise CurveError(f"{name}: expected a track-range curve file ({error!r}).") from error
    if version != CURVE_VERSION:
        raise CurveError(
            f"{name}: expected curve file version {CURVE_VERSION}, got {version}; fit it again with `track-range fit`."
        )
    return name, document
