"""Options of the tracker that several commands have, for `Annotated[TYPE, tracker_option(...)]`."""

from __future__ import annotations

from typing import Any

from track_range.foundation.options import option


def tracker_option(**shown: Any) -> Any:
    """Name or class of the tracker: `str`."""
    return option(
        "Tracker: deepsort (motion and appearance), sort (motion only), or a class of an installed package or of a "
        "module in the current folder, in which only the command line searches.",
        metavar="NAME|MODULE:CLASS",
        **shown,
    )


def reid_option(**shown: Any) -> Any:
    """Re-identification network: `Path | None`."""
    return option(
        "Re-identification network (ONNX) that describes the appearance of objects (default: a built-in colour "
        "descriptor).",
        **shown,
    )
