"""Telemetry of third-party packages, disabled before they are imported.

A package of track-range that imports one of them calls `disable_telemetry` in its `__init__`. Packages without such a
variable: Rerun, only the viewer of which collects statistics. `track-range view` starts it with `VIEWER_VARIABLES`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TelemetrySwitch:
    """Environment variable that disables the telemetry of a package.

    Attributes:
        package: name under which the package is imported.
        variable: environment variable, read when the package is imported.
        value: value that disables the telemetry.
    """

    package: str
    variable: str
    value: str


TELEMETRY_SWITCHES = (
    # writes a device id and a database of events into the user's cache, and looks up a host to upload them to
    TelemetrySwitch("onnxruntime", "ORT_DISABLE_TELEMETRY", "1"),
    # reports the cluster, the libraries in use and the operating system
    TelemetrySwitch("ray", "RAY_USAGE_STATS_ENABLED", "0"),
)


_CLOSED_PORT = "http://127.0.0.1:9"
"""Address at which nothing listens (the discard port)."""

VIEWER_VARIABLES = {
    "CI": "true",
    "HTTPS_PROXY": _CLOSED_PORT,
    "ALL_PROXY": _CLOSED_PORT,
    "https_proxy": _CLOSED_PORT,
    "NO_PROXY": "127.0.0.1,localhost",
}
"""Environment of Rerun's viewer, so that it makes no connection.

In continuous integration it collects no statistics; it has no other variable for that, and `rerun analytics disable`
records an event before it disables them. Its check for a newer version cannot be disabled, but uses a proxy.
"""


def disable_telemetry() -> None:
    """Set the variables of all switches for this process and those it starts; a user's own value has precedence."""
    for switch in TELEMETRY_SWITCHES:
        os.environ.setdefault(switch.variable, switch.value)
