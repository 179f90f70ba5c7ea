"""Imports of the optional packages of result formats, with the pip command where one is missing."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

from track_range.foundation.errors import UserError
from track_range.foundation.telemetry import disable_telemetry


class ExtraError(UserError):
    """A result format requires a package that is not installed."""


def check_extra(format_name: str, extra: str, *packages: str) -> None:
    """Check that packages can be imported, and disable their telemetry.

    Args:
        format_name: name of the result format.
        extra: extra of track-range that installs the packages.
        packages: import names.

    Raises:
        ExtraError: one of them is not installed.
    """
    disable_telemetry()
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        raise ExtraError(
            f"the format {format_name} requires the package {', '.join(missing)}: install it with "
            f"pip install 'track-range[{extra}]'."
        )
    for package in packages:
        try:
            import_module(package)
        except ImportError as error:
            raise ExtraError(
                f"the format {format_name}: the package {package} cannot be imported ({error}); reinstall it with "
                f"pip install --force-reinstall 'track-range[{extra}]'."
            ) from error
