"""Import of the optional packages that read telemetry (extra [telemetry])."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from track_range.recording.telemetry.errors import TelemetryError

INSTALL = 'pip install "track-range[telemetry]"'
"""Command that installs the packages of the extra."""


def imported(package: str, source: str) -> Any:
    """A package of the extra [telemetry].

    Args:
        package: name of the module.
        source: the file to read, for the message.

    Raises:
        TelemetryError: it is not installed.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise TelemetryError(f"{source}: reading it needs the package {package}; install it with: {INSTALL}") from error
