"""Trackers by name: the built-in ones, those of installed packages, and any class as `package.module:Class`.

A tracker is one file with a class that has `update` (`track_range.tracking.tracker.Tracker`) and is made from
`TrackerOptions`, and one registration: a line in `_registered`, an entry point of the group
`track_range.trackers` in another package, or a call of `register_tracker`.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from track_range.foundation.errors import UserError
from track_range.tracking.tracker import Tracker, TrackerOptions
from track_range.tracking.tracks import Tracks

ENTRY_POINT_GROUP = "track_range.trackers"

TrackerFactory = Callable[[TrackerOptions], Tracker]
"""Makes a tracker that has seen no frame: a class, or a function."""


class TrackerError(UserError):
    """No such tracker, a class that is none, or wrong results of one; the message is one sentence for the user."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisteredTracker:
    """A tracker that can be chosen.

    Attributes:
        name: as in `--tracker`.
        factory: makes one; a string "package.module:attribute" is imported when it is used for the first time.
        uses_reid: whether it uses `TrackerOptions.reid`.
    """

    name: str
    factory: TrackerFactory | str
    uses_reid: bool = False


_registered: dict[str, RegisteredTracker] = {
    "deepsort": RegisteredTracker(name="deepsort", factory="track_range.tracking.deepsort:deepsort", uses_reid=True),
    "sort": RegisteredTracker(name="sort", factory="track_range.tracking.deepsort:sort"),
}


def register_tracker(name: str, factory: TrackerFactory | str, *, uses_reid: bool = False) -> None:
    """Make a tracker available as `--tracker NAME`; see `RegisteredTracker` for the arguments.

    Raises:
        TrackerError: another tracker has this name.
        ValueError: the name is empty or contains a colon.
    """
    if not name or ":" in name:
        raise ValueError(f"{name!r}: expected a tracker's name without a colon")
    if name in tracker_names():
        raise TrackerError(f"the name of the tracker '{name}' is in use: choose another one.")
    _registered[name] = RegisteredTracker(name=name, factory=factory, uses_reid=uses_reid)


def tracker_names() -> tuple[str, ...]:
    """Names that `--tracker` accepts: registered trackers first, then those of entry points."""
    installed = sorted(point.name for point in entry_points(group=ENTRY_POINT_GROUP))
    return tuple(dict.fromkeys([*_registered, *installed]))


def find_tracker(name: str) -> RegisteredTracker:
    """The tracker of a name or of `package.module:Class`, checked as far as that is possible without making one.

    A module is also searched for in the current folder.

    Raises:
        TrackerError: there is none, or it cannot be made from `TrackerOptions`.
    """
    if name in _registered:
        return _registered[name]
    points = [point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name == name]
    if not points and ":" not in name:
        known = ", ".join(tracker_names())
        raise TrackerError(f"unknown tracker '{name}': expected {known}, or package.module:Class.")
    factory = _imported(points[0].value if points else name)
    try:
        inspect.signature(factory).bind(TrackerOptions())
    except (TypeError, ValueError) as error:
        raise TrackerError(f"{name}: expected a class or function of one argument, the TrackerOptions.") from error
    return RegisteredTracker(name=name, factory=factory, uses_reid=bool(getattr(factory, "uses_reid", False)))


def create_tracker(name: str, options: TrackerOptions | None = None) -> Tracker:
    """A new tracker that has seen no frame.

    Args:
        name: one of `tracker_names()`, or `package.module:Class`.
        options: None = the defaults.

    Raises:
        TrackerError: there is none of that name, it does not take `TrackerOptions`, or what it makes has no method
            `update`.
    """
    factory = find_tracker(name).factory
    make = _imported(factory) if isinstance(factory, str) else factory
    try:
        tracker = make(options or TrackerOptions())
    except TypeError as error:
        raise TrackerError(f"{name}: cannot be made from TrackerOptions ({error}).") from error
    if not callable(getattr(tracker, "update", None)):
        raise TrackerError(f"{name}: expected a method update(detections, time_s, image), found none.")
    return tracker


def checked_tracks(tracker: Tracker, found: Any) -> Tracks:
    """What a tracker's `update` has returned.

    Raises:
        TrackerError: it is no `Tracks`.
    """
    if not isinstance(found, Tracks):
        name = f"{type(tracker).__module__}:{type(tracker).__qualname__}"
        raise TrackerError(f"{name}: expected Tracks from the tracker's update, got {type(found).__name__}.")
    return found


def _imported(path: str) -> TrackerFactory:
    """The class or function "package.module:attribute".

    Raises:
        TrackerError: the module cannot be imported, or has no such class or function.
    """
    module_name, _, attribute = path.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # an installed command does not search the current folder by itself
    try:
        found = import_module(module_name)
        for part in attribute.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError, ValueError) as error:
        raise TrackerError(f"{path}: cannot be imported as a tracker ({error}).") from error
    if not callable(found):
        raise TrackerError(f"{path}: expected a class or function, found {type(found).__name__}.")
    factory: TrackerFactory = found
    return factory
