"""Registry of ranging methods: built-in, from other packages, and registered at run time.

A package registers a `RangingMethod` under the entry point group `track_range.ranging_methods`:

    [project.entry-points."track_range.ranging_methods"]
    my_method = "my_package.my_module:MY_METHOD"
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint
from types import MappingProxyType

from track_range.foundation.errors import named_errors
from track_range.foundation.registry import Registry, imported
from track_range.ranging.methods.method import MethodContext, MethodError, Ranger, RangingMethod

# built-in ones in the order of columns, tables and stages
METHODS: Registry[RangingMethod] = Registry(
    "track_range.ranging_methods",
    {
        "mono": "track_range.ranging.methods.size_regression:MONO",
        "ground": "track_range.ranging.methods.ground_plane:GROUND",
        "lane": "track_range.ranging.methods.lane_width:LANE",
        "stereo": "track_range.ranging.methods.patch_stereo:STEREO",
        "sgbm": "track_range.ranging.methods.dense_stereo:SGBM",
        "expansion": "track_range.ranging.methods.expansion:EXPANSION",
    },
)


def methods() -> tuple[RangingMethod, ...]:
    """All ranging methods: built-in, then from entry points sorted by name, then registered, in
    their order.
    """
    return (*_installed()[0], *METHODS.registered.values())


def method_notes() -> tuple[str, ...]:
    """One message for each entry point that cannot be used."""
    return _installed()[1]


def origins() -> dict[str, str]:
    """Origin of each method that is not built in, by name: the entry point, or the function that
    creates the method.
    """
    created_by = {name: method.create for name, method in METHODS.registered.items()}
    made = {
        name: f"{make.__module__}:{getattr(make, '__qualname__', '')}"
        for name, make in created_by.items()
    }
    return _installed()[2] | made


def register(method: RangingMethod) -> None:
    """Add a method for the lifetime of the process.

    Raises MethodError: another method has its name or its letter, or it names a method that does
    not exist.
    """
    _check(method, methods())
    METHODS.registered[method.name] = method


def in_measuring_order(listed: Sequence[RangingMethod]) -> tuple[RangingMethod, ...]:
    """The methods in a stable topological order, each after the methods that it reads; MethodError
    on a cycle.
    """
    pending, ordered = list(listed), list[RangingMethod]()
    while pending:
        names = {method.name for method in pending}
        ready = next((method for method in pending if names.isdisjoint(method.reads)), None)
        if ready is None:
            raise MethodError(
                f"ranging methods {', '.join(sorted(names))}: their `reads` form a cycle"
            )
        pending.remove(ready)
        ordered.append(ready)
    return tuple(ordered)


def create_rangers(
    context: MethodContext, listed: Sequence[RangingMethod] | None = None
) -> dict[str, Ranger]:
    """Rangers by name, in measuring order, of all methods (or the `listed` methods) with their
    requirements met.

    Each factory gets the context with the rangers created before. Raises MethodError: the `reads`
    of the methods form a cycle.
    """
    rangers: dict[str, Ranger] = {}
    for method in in_measuring_order(methods() if listed is None else listed):
        if method.needs <= context.available:
            with named_errors(
                method.create.__module__, f"ranging method {method.name!r}", MethodError
            ):
                ranger = method.create(replace(context, rangers=MappingProxyType(rangers)))
            if not isinstance(ranger, Ranger | None):
                given = f"expected create() to return a Ranger or None, got {type(ranger).__name__}"
                raise MethodError(f"ranging method {method.name!r}: {given}.")
            if ranger is not None:
                rangers[method.name] = ranger
    return rangers


@cache
def _installed() -> tuple[tuple[RangingMethod, ...], tuple[str, ...], dict[str, str]]:
    """Built-in methods and methods of entry points, notes on entry points, and the origins of their
    methods.
    """
    installed = [imported(method) for method in METHODS.built_in.values()]
    notes, origins = [], dict[str, str]()
    for entry in METHODS.installed:
        try:
            method = _loaded(entry)
            _check(method, installed, tuple(other.name for other in METHODS.installed))
            installed.append(method)
            package = "" if entry.dist is None else f" ({entry.dist.name} {entry.dist.version})"
            origins[method.name] = f"{entry.value}{package}"
        except MethodError as error:
            notes.append(f"Entry point {entry.name} = {entry.value} cannot be used: {error}.")
    return tuple(installed), tuple(notes), origins


def _loaded(entry: EntryPoint) -> RangingMethod:
    try:
        method = entry.load()
    # a module of another package may raise anything; the run continues without it
    except Exception as error:
        raise MethodError(f"{type(error).__name__}: {error}") from error
    if not isinstance(method, RangingMethod):
        raise MethodError(f"expected a RangingMethod, got {type(method).__name__}")
    return method


def _check(
    method: RangingMethod, others: Sequence[RangingMethod], pending: Sequence[str] = ()
) -> None:
    """MethodError: the method has another method's name or letter, or names an unknown method."""
    known = [*(other.name for other in others), *pending]
    if unknown := [
        name
        for name in (*method.reads, method.fallback_for)
        if name is not None and name not in known
    ]:
        raise MethodError(
            f"ranging method {method.name!r}: expected reads and fallback_for among "
            f"{', '.join(known)}, which are registered before, got {unknown[0]!r}"
        )
    for other in others:
        if method.name == other.name or method.letter == other.letter:
            raise MethodError(
                f"ranging method {method.name!r}: expected a unique name and letter, "
                f"but {other.name!r} is registered with the letter {other.letter!r}"
            )
