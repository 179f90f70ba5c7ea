"""Registry: objects of one kind by name, built in, from other packages (entry points), or
registered at run time.
"""

import os
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache, partial, reduce
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from track_range.foundation.errors import UserError, named_errors

T = TypeVar("T")
Answer = TypeVar("Answer")


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
        error: type[UserError] | None = None,
    ) -> None:
        """See the class; `kind` is the class of `usable` objects.

        `check` raises a UserError if an object of another package does not fit those before it and
        the names of entry points. Exceptions of the functions in its fields become `error`, with
        the name of the package; None = those who call them name it.
        """
        self.group, self.built_in = group, built_in
        self.registered: dict[str, T] = {}  # things that were added at run time, in this order
        self._kind, self._check = kind, check
        self._failure = error and type(error.__name__, (PluginError, error), {})
        self._noted: dict[str, None] = {}  # notes on what was left out when it was used
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
        registered objects. `notes` name the packages whose objects they hide.
        """
        own = {**self.registered, **self.built_in}
        points = [point for point in self.installed if point.name == name]
        for point in points if name in own else points[1:]:
            self._noted[_note(point, PluginError(f"the name {name!r} is already in use"))] = None
        return own.get(name, points[0].value if points else None)

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

    def answers(
        self, ask: Callable[[T], Answer], *, is_last_raised: bool = False
    ) -> Iterator[tuple[T, Answer]]:
        """The objects in the order of `by_priority`, each with its answer to `ask`, such as whether
        it recognises a file.

        Objects of packages that fail are left out, and `notes` name them. With `is_last_raised`,
        the last failure is raised after the last answer.
        """
        failure = None
        for thing in self.by_priority:
            try:
                answer = ask(thing)
            except PluginError as error:
                failure = error
                self._noted[str(error)] = None
            else:
                yield thing, answer
        if is_last_raised and failure is not None:
            raise failure

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence for each entry point that was to be used and cannot be; it names the
        package.
        """
        imports = self._objects.notes if self._objects and self._objects.path == sys.path else ()
        installed = [_origin(point) for point in self.installed] if self._noted else []
        used = (note for note in self._noted if any(origin in note for origin in installed))
        return tuple(dict.fromkeys((*imports, *used)))

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
                notes.append(_note(point, error))
            else:
                if self._failure is not None:
                    loaded = {
                        name: _guarded(thing, point, self._failure)
                        for name, thing in loaded.items()
                    }
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
        """The object, or the objects of a tuple, by name.

        PluginError: they are not of the registry's kind, or a tuple has none, or not a name for
        each.
        """
        kind: Any = self._kind or object
        is_one = isinstance(thing, kind) or not isinstance(thing, tuple)
        things: list[Any] = [thing] if is_one else [*thing]
        for one in things:
            if not isinstance(one, kind):
                raise PluginError(f"expected a {kind.__name__}, got {type(one).__name__}")
            if not isinstance(priority := getattr(one, "priority", 0), int):
                raise PluginError(f"expected an integer as priority, got {priority!r}")
        named = {getattr(one, "name", name): one for one in things}
        if not is_one and not (things and all(hasattr(one, "name") for one in things)):
            raise PluginError(
                f"expected a tuple of objects with names, got {len(things)} without them"
            )
        if len(named) < len(things):
            raise PluginError(f"expected a name for each of {len(things)} objects, got equal names")
        return named


class _Objects(NamedTuple, Generic[T]):
    """The built-in objects, and those of entry points."""

    path: list[str]  # `sys.path` when they were imported
    things: dict[str, T]  # by name
    origins: dict[str, str]  # by name, see `Registry.origin`
    notes: tuple[str, ...]


class PluginError(UserError):
    """An entry point of another package that cannot be used, or whose function fails."""


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
    # a module of another package may raise anything, and may end the program, such as a script
    # without a guard; the program continues without it
    except (Exception, SystemExit) as error:
        raise PluginError(f"{type(error).__name__}: {error}") from error


def _guarded(thing: Any, point: metadata.EntryPoint, failure: type[UserError]) -> Any:
    """A dataclass of another package, with exceptions of the functions in its fields as
    `failure`.
    """
    if not is_dataclass(thing):
        return thing
    functions = {
        field.name: partial(_call, value, point, failure)
        for field in fields(thing)
        if field.init and callable(value := getattr(thing, field.name))
    }
    return replace(thing, **functions) if functions else thing  # type: ignore[type-var]


def _call(
    function: Callable[..., Any],
    point: metadata.EntryPoint,
    failure: type[UserError],
    *arguments: Any,
    **named: Any,
) -> Any:
    file = next((f"{value}: entry" for value in arguments if isinstance(value, Path)), "Entry")
    with named_errors(point.module, f"{file} point {point.name} = {_origin(point)}", failure):
        result = function(*arguments, **named)
        if isinstance(result, Iterator):  # a generator fails only when it is read
            return iter([_guarded(one, point, failure) for one in result])
        return result


def _note(point: metadata.EntryPoint, error: UserError) -> str:
    reason = " ".join(str(error).removesuffix(".").split())
    return f"Entry point {point.name} = {_origin(point)} cannot be used: {reason}."


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
