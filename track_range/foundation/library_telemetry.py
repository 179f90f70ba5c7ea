"""Telemetry of third-party packages, disabled before they are imported.

A package of track-range that imports one of them calls `disable_telemetry` in its `__init__`. Rerun
has no such variable, but only its viewer collects statistics; `track-range view` starts it with
`VIEWER_VARIABLES`.
"""

import os

# environment variable, read at a package's import, and the value that disables its telemetry
TELEMETRY_SWITCHES = {
    # writes a device id and a database of events into the user's cache, and looks up a host to
    # upload them to
    "onnxruntime": ("ORT_DISABLE_TELEMETRY", "1"),
    # reports the cluster, the libraries in use and the operating system
    "ray": ("RAY_USAGE_STATS_ENABLED", "0"),
}
_CLOSED_PORT = "http://127.0.0.1:9"  # address at which nothing listens (the discard port)

VIEWER_VARIABLES = {
    "CI": "true",
    "HTTPS_PROXY": _CLOSED_PORT,
    "ALL_PROXY": _CLOSED_PORT,
    "https_proxy": _CLOSED_PORT,
    "NO_PROXY": "127.0.0.1,localhost",
}
"""Environment of Rerun's viewer, so that it makes no connection.

In continuous integration the viewer collects no statistics; there is no other variable for that,
and `rerun analytics disable` records an event first. The check for a newer version cannot be
disabled, but uses a proxy.
"""


def disable_telemetry() -> None:
    """Set the variables of all switches for this process and its child processes; a user's own
    value has precedence.
    """
    for variable, value in TELEMETRY_SWITCHES.values():
        os.environ.setdefault(variable, value)
