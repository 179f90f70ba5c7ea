"""Registry: objects of one kind by name, built in, from other packages (entry points), or
registered at run time.
"""

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache, reduce
from importlib import import_module, metadata
from typing import Generic, TypeVar

T = TypeVar("T")


class Registry(Generic[T]):
    """Objects of one kind by name; a text "package.module:attribute" stands for the object that
    `imported` returns.

    `built_in` are our own objects, in their order; other packages register with the `group` of
    entry points.
    """

    def __init__(self, group: str, built_in: Mapping[str, T | str]) -> None:
        self.group, self.built_in = group, built_in
        self.registered: dict[str, T] = {}  # things that were added at run time, in this order

    @property
    def installed(self) -> tuple[metadata.EntryPoint, ...]:
        """Entry points sorted by name; packages that were installed since the last call are
        seen.
        """
        # takes 0.1 ms; reading all of 200 packages each time would take 30 ms
        return _entry_points(
            self.group, tuple((folder, _changed_ns(folder)) for folder in sys.path)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of built-in objects, registered objects, then entry points."""
        return tuple(
            dict.fromkeys(
                (*self.built_in, *self.registered, *(point.name for point in self.installed))
            )
        )

    def find(self, name: str) -> T | str | None:
        """The object with a name, None if there is none; built-in objects have precedence, then
        registered objects.
        """
        installed = {point.name: point.value for point in reversed(self.installed)}
        return {**installed, **self.registered, **self.built_in}.get(name)

    @contextmanager
    def restored(self) -> Iterator[None]:
        """Context at whose end the registrations made inside it are removed."""
        before = dict(self.registered)
        try:
            yield
        finally:
            self.registered = before


def imported(thing: T | str) -> T:
    """The object that a text "package.module:attribute" names; other values are returned as they
    are.

    Errors of the import are not caught.
    """
    if not isinstance(thing, str):
        return thing
    module, _, attribute = thing.partition(":")
    named: T = reduce(getattr, attribute.split("."), import_module(module))  # type: ignore[assignment]
    return named


@lru_cache(maxsize=32)
def _entry_points(
    group: str, _folders: tuple[tuple[str, int], ...]
) -> tuple[metadata.EntryPoint, ...]:
    return tuple(sorted(metadata.entry_points(group=group), key=lambda point: point.name))


def _changed_ns(folder: str) -> int:
    """Time of the last change of a folder of packages; -1 = it does not exist."""
    try:
        return os.stat(folder or os.curdir).st_mtime_ns
    except OSError:
        return -1
