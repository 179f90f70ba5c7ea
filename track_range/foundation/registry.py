"""Registry: objects of one kind by name, built in, from other packages (entry points), or
registered at run time.
"""

import os
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache, reduce
from importlib import import_module, metadata
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from track_range.foundation.errors import UserError

T = TypeVar("T")


class Registry(Generic[T]):
    """Objects of one kind by name; a text "package.module:attribute" stands for the object that
    `imported` returns.

    `built_in` are our own objects, in their order; other packages register with the `group` of
    entry points. Objects that a user chooses by name are found with `find`. Objects of which the
    program chooses are `usable` ones: the name is then their own attribute `name`, if they have
    one, and a text may stand for a tuple of objects. Where several of them fit an input,
    `by_priority` has them in the order in which they are tried, by their attribute `priority`:

        0       the usual priority: the object recognises what no other one does
        below   it recognises by a general rule, such as any JSON, and is tried after those
        above   it is tried before those, since it recognises a special case of one of them

    Those of equal priority are tried in the order of `names`.
    """

    all: ClassVar[list["Registry[Any]"]] = []  # in the order of their creation

    def __init__(
        self,
        group: str,
        built_in: Mapping[str, T | str],
        kind: type[T] | None = None,
        check: Callable[[T, Collection[T], Collection[str]], None] | None = None,
    ) -> None:
        """See the class; `kind` is the class of `usable` objects.

        `check` raises a UserError if an object of another package does not fit those before it and
        the names of entry points.
        """
        self.group, self.built_in = group, built_in
        self.registered: dict[str, T] = {}  # things that were added at run time, in this order
        self._kind, self._check = kind, check
        self._objects: _Objects[T] | None = None  # None = not needed yet
        self.all.append(self)

    @property
    def installed(self) -> tuple[metadata.EntryPoint, ...]:
        """Entry points sorted by name; packages that were installed since the last call are
        seen.
        """
        # takes 0.03 ms; reading all of 200 packages each time would take 30 ms
        return _entry_points(
            self.group, tuple((folder, _changed_ns(folder)) for folder in sys.path)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of built-in objects, entry points, then registered objects; nothing is imported."""
        installed = (point.name for point in self.installed)
        return tuple(dict.fromkeys((*self.built_in, *installed, *self.registered)))

    def find(self, name: str) -> T | str | None:
        """The object with a name, None if there is none; built-in objects have precedence, then
        registered objects.
        """
        installed = {point.name: point.value for point in reversed(self.installed)}
        return {**installed, **self.registered, **self.built_in}.get(name)

    @property
    def usable(self) -> Mapping[str, T]:
        """The objects by name, imported, in the order of `names`.

        Entry points are read once for each `sys.path`, since a frame needs the objects often. Those
        that cannot be used are left out; `notes` has the reasons.
        """
        if self._objects is None or self._objects.path != sys.path:
            self._objects = self._import_all()
        return {**self._objects.things, **self.registered}

    def named(self, name: str) -> T:
        """The usable object with a name; KeyError if there is none."""
        return imported(self.built_in[name]) if name in self.built_in else self.usable[name]

    @property
    def by_priority(self) -> tuple[T, ...]:
        """The `usable` objects, those of highest priority first."""
        return tuple(sorted(self.usable.values(), key=lambda thing: -getattr(thing, "priority", 0)))

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence for each entry point that was to be used and cannot be; it names the
        package.
        """
        return self._objects.notes if self._objects and self._objects.path == sys.path else ()

    def origin(self, name: str) -> str:
        """The entry point and package, "package.module:attribute (package 1.0)", of an object from
        `usable` or `names`; "" = it is from no other package.
        """
        if name in self.built_in or name in self.registered:
            return ""
        origins = {point.name: _origin(point) for point in self.installed}
        origins |= self._objects.origins if self._objects else {}
        return origins.get(name, "")

    @contextmanager
    def restored(self) -> Iterator[None]:
        """Context at whose end the registrations made inside it are removed."""
        before = dict(self.registered)
        try:
            yield
        finally:
            self.registered = before

    def _import_all(self) -> "_Objects[T]":
        known: dict[str, T] = {}
        for name, thing in self.built_in.items():
            known |= self._named(name, imported(thing))
        origins, notes = dict[str, str](), list[str]()
        points = self.installed
        for point in points:
            try:
                loaded = self._named(point.name, _loaded(point))
                self._check_all(loaded, known, [other.name for other in points])
            except UserError as error:
                reason = " ".join(str(error).removesuffix(".").split())
                notes.append(
                    f"Entry point {point.name} = {_origin(point)} cannot be used: {reason}."
                )
            else:
                known |= loaded
                origins |= dict.fromkeys(loaded, _origin(point))
        return _Objects([*sys.path], known, origins, tuple(notes))

    def _check_all(
        self, loaded: Mapping[str, T], known: Mapping[str, T], pending: Sequence[str]
    ) -> None:
        for name, thing in loaded.items():
            if self._check is not None:
                self._check(thing, known.values(), pending)
            if name in known:
                raise PluginError(f"the name {name!r} is already in use")

    def _named(self, name: str, thing: Any) -> dict[str, T]:
        """The object, or the objects of a tuple, by name; PluginError: not of the registry's kind."""
        kind: Any = self._kind or object
        is_one = isinstance(thing, kind) or not isinstance(thing, tuple)
        things: list[Any] = [thing] if is_one else [*thing]
        for one in things:
            if not isinstance(one, kind):
                raise PluginError(f"expected a {kind.__name__}, got {type(one).__name__}")
        return {getattr(one, "name", name): one for one in things}


class _Objects(NamedTuple, Generic[T]):
    """The built-in objects, and those of entry points."""

    path: list[str]  # `sys.path` when they were imported
    things: dict[str, T]  # by name
    origins: dict[str, str]  # by name, see `Registry.origin`
    notes: tuple[str, ...]


class PluginError(UserError):
    """An entry point of another package that cannot be used."""


def plugin_notes() -> tuple[str, ...]:
    """The `notes` of all registries."""
    return tuple(note for registry in Registry.all for note in registry.notes)


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


def _loaded(point: metadata.EntryPoint) -> object:
    try:
        return point.load()
    # a module of another package may raise anything; the program continues without it
    except Exception as error:
        raise PluginError(f"{type(error).__name__}: {error}") from error


def _origin(point: metadata.EntryPoint) -> str:
    package = "" if point.dist is None else f" ({point.dist.name} {point.dist.version})"
    return f"{point.value}{package}"


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
