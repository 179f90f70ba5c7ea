"""The registry of ranging methods: the built-in ones, those of other packages, those registered by a program.

Packages register a `RangingMethod` under the entry point group `track_range.ranging_methods`:

    [project.entry-points."track_range.ranging_methods"]
    my_method = "my_package.my_module:MY_METHOD"
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

from track_range.ranging.method import MethodContext, MethodError, RangingMethod
from track_range.ranging.ranger import Ranger

ENTRY_POINT_GROUP = "track_range.ranging_methods"

_METHODS_FOLDER = "track_range.ranging.methods"
_BUILT_IN = (
    ("size_regression", "MONO"),
    ("ground_plane", "GROUND"),
    ("lane_width", "LANE"),
    ("patch_stereo", "STEREO"),
    ("dense_stereo", "SGBM"),
)
"""Module and description of each, in the order of columns, tables and stages."""

_registered: dict[str, RangingMethod] = {}
"""Methods registered by `register`, after the built-in ones and those of entry points."""


def methods() -> tuple[RangingMethod, ...]:
    """All ranging methods: the built-in ones, those of entry points by name, then those registered, in their order."""
    return (*_installed()[0], *_registered.values())


def method_notes() -> tuple[str, ...]:
    """One sentence for each entry point that cannot be used."""
    return _installed()[1]


def register(method: RangingMethod) -> None:
    """Add a method, for this process.

    Raises:
        MethodError: another method has its name or its letter.
    """
    _check_unique(method, methods())
    _registered[method.name] = method


@contextmanager
def registered(method: RangingMethod) -> Iterator[None]:
    """A method that is registered inside of the with-block only.

    Raises:
        MethodError: as `register`.
    """
    register(method)
    try:
        yield
    finally:
        del _registered[method.name]


def in_reading_order(listed: Sequence[RangingMethod]) -> tuple[RangingMethod, ...]:
    """The methods in their order, but each after those of them that it reads.

    Raises:
        MethodError: methods read each other in a circle.
    """
    waiting, ordered = list(listed), list[RangingMethod]()
    while waiting:
        names = {method.name for method in waiting}
        ready = next((method for method in waiting if names.isdisjoint(method.reads)), None)
        if ready is None:
            raise MethodError(f"ranging methods {', '.join(sorted(names))}: they read each other in a circle")
        waiting.remove(ready)
        ordered.append(ready)
    return tuple(ordered)


def create_rangers(context: MethodContext, listed: Sequence[RangingMethod] | None = None) -> dict[str, Ranger]:
    """The rangers of all methods (or of those listed) that can run, by name, in the order in which they measure.

    Adds them to `context.rangers`.

    Raises:
        MethodError: methods read each other in a circle.
    """
    for method in in_reading_order(methods() if listed is None else listed):
        if method.needs <= context.available and (ranger := method.create(context)) is not None:
            context.rangers[method.name] = ranger
    return context.rangers


@cache
def _installed() -> tuple[tuple[RangingMethod, ...], tuple[str, ...]]:
    """The built-in methods and those of entry points, and notes on entry points that cannot be used."""
    found = [getattr(import_module(f"{_METHODS_FOLDER}.{module}"), name) for module, name in _BUILT_IN]
    notes = []
    for entry in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda entry: entry.name):
        try:
            method = _loaded(entry)
            _check_unique(method, found)
        except MethodError as error:
            notes.append(f"The entry point {entry.name} = {entry.value} cannot be used: {error}.")
        else:
            found.append(method)
    return tuple(found), tuple(notes)


def _loaded(entry: EntryPoint) -> RangingMethod:
    try:
        method = entry.load()
    except Exception as error:  # whatever another package's module raises, the run goes on without it
        raise MethodError(f"{type(error).__name__}: {error}") from error
    if not isinstance(method, RangingMethod):
        raise MethodError(f"expected a RangingMethod, got {type(method).__name__}")
    return method


def _check_unique(method: RangingMethod, others: Sequence[RangingMethod]) -> None:
    for other in others:
        if method.name == other.name or method.letter == other.letter:
            raise MethodError(
                f"ranging method {method.name!r}: expected a name and a letter of its own, "
                f"but {other.name!r} has the letter {other.letter!r}"
            )
