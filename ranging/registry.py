"""Registry of ranging methods: built-in, from other packages, and registered at run time.

A package registers a `RangingMethod` under the entry point group `track_range.ranging_methods`:

    [project.entry-points."track_range.ranging_methods"]
    my_method = "my_package.my_module:MY_METHOD"
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from types import MappingProxyType

from track_range.foundation.errors import named_errors
from track_range.foundation.files.input_files import quoted
from track_range.foundation.processes import search_current_folder
from track_range.foundation.registry import Registry, imported
from track_range.ranging.methods.method import MethodContext, MethodError, Ranger, RangingMethod


def _check(
    method: RangingMethod, others: Collection[RangingMethod], pending: Collection[str] = ()
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


# built-in ones in the order of columns, tables and stages
METHODS = Registry(
    "track_range.ranging_methods",
    {
        "mono": "track_range.ranging.methods.size_regression:MONO",
        "ground": "track_range.ranging.methods.ground_plane:GROUND",
        "lane": "track_range.ranging.methods.lane_width:LANE",
        "stereo": "track_range.ranging.methods.patch_stereo:STEREO",
        "sgbm": "track_range.ranging.methods.dense_stereo:SGBM",
        "expansion": "track_range.ranging.methods.expansion:EXPANSION",
    },
    RangingMethod,
    _check,
)


def methods() -> tuple[RangingMethod, ...]:
    """All ranging methods: built-in, then from entry points sorted by name, then registered, in
    their order.
    """
    return tuple(METHODS.usable.values())


def origins() -> dict[str, str]:
    """Origin of each method that is not built in, by name: the entry point, or the function that
    creates the method.
    """
    made = {name: method.create for name, method in METHODS.registered.items()}
    return {name: origin for name in METHODS.usable if (origin := METHODS.origin(name))} | {
        name: f"{make.__module__}:{getattr(make, '__qualname__', '')}"
        for name, make in made.items()
    }


def register(method: RangingMethod) -> None:
    """Add a method for the lifetime of the process.

    Raises MethodError: another method has its name or its letter, or it names a method that does
    not exist.
    """
    _check(method, methods())
    METHODS.registered[method.name] = method


def method_of(text: str) -> RangingMethod:
    """The method with this name, or the `RangingMethod` that "package.module:OBJECT" names, which is
    registered for the lifetime of the process.

    The command line also searches for the module in the current folder, after the installed ones.
    Raises MethodError: there is no such method, or it cannot be imported or registered.
    """
    if ":" not in text:
        known = METHODS.usable
        if text not in known:
            raise MethodError(
                f"unknown ranging method {quoted(text)}: expected {', '.join(known)}, or "
                "package.module:OBJECT."
            )
        return known[text]
    search_current_folder()
    try:
        method: object = imported(text)
    except Exception as error:  # a module of another package may raise anything
        raise MethodError(f"{text}: cannot be imported as a ranging method ({error}).") from error
    if not isinstance(method, RangingMethod):
        raise MethodError(f"{text}: expected a RangingMethod, found {type(method).__name__}.")
    known = METHODS.usable.get(method.name)
    is_installed = METHODS.origin(method.name).startswith(f"{text} ")
    if known is not None and (is_installed or known == method):
        return known
    register(method)
    return method


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
        is_for_plane = method.uses_road_plane or "right_image" in method.needs
        if context.road_plane is not None and not is_for_plane:
            continue  # sizes and horizons are learnt from drives
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
