"""Trackers by name: the built-in ones, those of installed packages, and any class as `package.module:Class`.

A tracker needs one file, with a class that has `update` (`track_range.tracking.tracker.Tracker`) and takes
`TrackerOptions`, and one registration: a line in `_registered`, an entry point of the group `track_range.trackers` in
another package, or a call to `register_tracker`.
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from track_range.foundation.entry_points import entry_points
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import quoted
from track_range.tracking.tracker import Tracker, TrackerOptions
from track_range.tracking.tracks import Tracks

ENTRY_POINT_GROUP = "track_range.trackers"
"""Entry-point group in which other packages register trackers."""

TrackerFactory = Callable[[TrackerOptions], Tracker]
"""A class or function that makes a new tracker from `TrackerOptions`."""


class TrackerError(UserError):
    """A tracker that is unknown or unusable, or that returned wrong results; the message is one sentence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisteredTracker:
    """A tracker that `--tracker` can select.

    Attributes:
        name: its name on the command line.
        factory: makes the tracker; a string "package.module:attribute" is imported on first use.
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
        raise TrackerError(f"tracker name '{name}': already in use; choose another name.")
    _registered[name] = RegisteredTracker(name=name, factory=factory, uses_reid=uses_reid)


def tracker_names() -> tuple[str, ...]:
    """Names that `--tracker` accepts: registered trackers first, then those of entry points."""
    installed = sorted(point.name for point in entry_points(group=ENTRY_POINT_GROUP))
    return tuple(dict.fromkeys([*_registered, *installed]))


def find_tracker(name: str) -> RegisteredTracker:
    """The tracker with a name or `package.module:Class`, checked as far as possible without creating one.

    The module of a `package.module:Class` is also searched for in the current folder, after the installed ones.

    Raises:
        TrackerError: there is no such tracker, or it does not take `TrackerOptions`.
    """
    if name in _registered:
        return _registered[name]
    points = [point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name == name]
    if not points and ":" not in name:
        known = ", ".join(tracker_names())
        raise TrackerError(f"unknown tracker {quoted(name)}: expected {known}, or package.module:Class.")
    if not points and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # an installed command does not search the current folder by itself
    factory = _imported(points[0].value if points else name)
    try:
        inspect.signature(factory).bind(TrackerOptions())
    except (TypeError, ValueError) as error:
        raise TrackerError(f"{name}: expected a class or function with one argument, the TrackerOptions.") from error
    return RegisteredTracker(name=name, factory=factory, uses_reid=bool(getattr(factory, "uses_reid", False)))


def create_tracker(name: str, options: TrackerOptions | None = None) -> Tracker:
    """A new tracker without tracks.

    Args:
        name: one of `tracker_names()`, or `package.module:Class`.
        options: options for the tracker; None = the defaults.

    Raises:
        TrackerError: the name is unknown, the tracker does not take `TrackerOptions`, or it has no method `update`.
    """
    factory = find_tracker(name).factory
    make = _imported(factory) if isinstance(factory, str) else factory
    try:
        tracker = make(options or TrackerOptions())
    except TypeError as error:
        raise TrackerError(f"{name}: cannot be created from TrackerOptions ({error}).") from error
    if not callable(getattr(tracker, "update", None)):
        raise TrackerError(f"{name}: expected a method update(detections, time_s, image), found none.")
    return tracker


def checked_tracks(tracker: Tracker, result: Any) -> Tracks:
    """The result of a tracker's `update`, checked to be `Tracks`.

    Raises:
        TrackerError: the result has another type.
    """
    if not isinstance(result, Tracks):
        name = f"{type(tracker).__module__}:{type(tracker).__qualname__}"
        raise TrackerError(f"{name}: expected Tracks from the tracker's update, got {type(result).__name__}.")
    return result


def _imported(path: str) -> TrackerFactory:
    """The class or function "package.module:attribute".

    Raises:
        TrackerError: the module cannot be imported, or has no such class or function.
    """
    module_name, _, attribute = path.partition(":")
    try:
        target = import_module(module_name)
        for part in attribute.split("."):
            target = getattr(target, part)
    except (ImportError, AttributeError, ValueError) as error:
        raise TrackerError(f"{path}: cannot be imported as a tracker ({error}).") from error
    if not callable(target):
        raise TrackerError(f"{path}: expected a class or function, found {type(target).__name__}.")
    factory: TrackerFactory = target
    return factory
