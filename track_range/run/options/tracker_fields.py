"""Options of the tracker that several commands have: types of their fields, and a check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from track_range.foundation.errors import UsageError
from track_range.foundation.options import option

TrackerField = Annotated[
    str,
    option(
        "Tracker: deepsort (motion and appearance), sort (motion only), or a class of an installed package or of a "
        "module in the current folder, in which only the command line searches.",
        metavar="NAME|MODULE:CLASS",
        is_shared=True,
    ),
]
ReidField = Annotated[
    Path | None,
    option(
        "Re-identification network (ONNX) that describes the appearance of objects (default: a built-in colour "
        "descriptor).",
        is_shared=True,
    ),
]


def check_tracker(name: str, reid: Path | None) -> None:
    """Check that the tracker exists, and that it compares appearance if a re-identification network is given.

    Raises:
        UsageError: no such tracker, or it does not use the network.
    """
    from track_range.tracking.registry import TrackerError, find_tracker

    try:
        tracker = find_tracker(name)
    except TrackerError as error:
        raise UsageError(f"--tracker: {error}") from error
    if reid is not None and not tracker.uses_reid:
        raise UsageError(
            f"--reid: --tracker {name} does not compare appearance; omit --reid or use --tracker deepsort."
        )
