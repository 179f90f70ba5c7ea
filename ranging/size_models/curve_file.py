"""Files of what is known of sizes: JSON with a version, the kind of model, from what it was taken, and its numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from track_range.foundation.atomic_files import describe, write_text
from track_range.foundation.errors import UserError

CURVE_VERSION = 2
_VERSION_KEY = "track_range_size_curves"


class CurveError(UserError):
    """A curve file that cannot be used, or labels that no curve can be fitted on; the message says why."""


def write_curve_file(path: Path, kind: str, content: Mapping[str, Any]) -> None:
    """Write a model of `kind` as JSON, whole or not at all.

    Raises:
        CurveError: the file cannot be written.
    """
    document = {_VERSION_KEY: CURVE_VERSION, "kind": kind, **content}
    try:
        write_text(path, json.dumps(document, indent=2) + "\n")
    except OSError as error:
        raise CurveError(f"{path}: cannot be written ({describe(error)}).") from error


def read_curve_file(path: Path | None) -> tuple[str, Mapping[str, Any]]:
    """Name and content of a curve file; None = the packaged one.

    Raises:
        CurveError: no such file, not our format, or of another version.
    """
    packaged = resources.files("track_range.ranging").joinpath("curves/cuboids.json")
    name = str(path or packaged)
    try:
        document = json.loads((path or packaged).read_text(encoding="utf-8"))
        version = document[_VERSION_KEY]
    except OSError as error:
        raise CurveError(f"{name}: cannot be read ({error.strerror or error}).") from error
    except (ValueError, KeyError, TypeError) as error:
        raise CurveError(f"{name}: not a curve file of track-range ({error!r}).") from error
    if version != CURVE_VERSION:
        raise CurveError(
            f"{name}: version {version} of a curve file; this track-range reads version {CURVE_VERSION}: "
            "fit it anew with `track-range fit`."
        )
    return name, document
