"""TelemetryError: telemetry that cannot be read or used."""

from __future__ import annotations

from track_range.foundation.errors import UserError


class TelemetryError(UserError):
    """Telemetry that cannot be used; the message gives the file and the reason.

    An error for a file that the user named; a note of the run for a file that was found automatically.
    """
