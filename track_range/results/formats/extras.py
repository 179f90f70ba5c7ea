"""Imports of the optional packages of result formats, with the pip command where one is missing."""

from __future__ import annotations

from importlib import import_module

from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import shortened
from track_range.foundation.library_telemetry import disable_telemetry


class ExtraError(UserError):
    """A result format requires a package that is not installed."""


def check_extra(format_name: str, extra: str, *packages: str) -> None:
    """Import packages of a format, which `extra` of track-range installs, and disable their telemetry.

    ExtraError if one of them is not installed.
    """
    disable_telemetry()
    for package in packages:
        top_level = package.partition(".")[0]
        try:
            import_module(package)
        except ImportError as error:
            is_missing = isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] == top_level
            raise ExtraError(
                f"the format {format_name} requires the package {top_level}: install it with "
                f"pip install 'track-range[{extra}]'."
                if is_missing
                else f"the format {format_name}: the package {top_level} cannot be imported ({shortened(str(error))}); "
                f"reinstall it with pip install --force-reinstall 'track-range[{extra}]'."
            ) from error
