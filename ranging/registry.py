"""Registry of ranging methods: built-in, from other packages, and registered at run time.

A package registers a `RangingMethod` under the entry point group `track_range.ranging_methods`:

    [project.entry-points."track_range.ranging_methods"]
    my_method = "my_package.my_module:MY_METHOD"
"""

import difflib
import re
import string
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
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
        "depth": "track_range.ranging.methods.network_depth:DEPTH",
        "disparity": "track_range.ranging.methods.network_disparity:DISPARITY",
        "recorded": "track_range.ranging.methods.recorded_depth:RECORDED",
    },
    RangingMethod,
    _check,
)

# functions that describe the method of one of several networks, by the kind of the networks: its
# name is KIND-FILE, that of a single network KIND, which is a built-in method
NETWORK_METHODS: dict[str, Callable[[str], RangingMethod] | str] = {
    "depth": "track_range.ranging.methods.network_depth:network_method",
    "disparity": "track_range.ranging.methods.network_disparity:network_method",
}

_LETTERS = string.ascii_uppercase + string.digits
# of networks after the first one of their kind, which have the colour of their description
_NETWORK_COLOURS = ("#b5651d", "#0f7f8c", "#a0457e", "#5f7d1e", "#3c5fb0", "#8c4a3c")


def methods(optional: Collection[str] | None = None) -> tuple[RangingMethod, ...]:
    """All ranging methods: built-in, then from entry points sorted by name, then registered, in
    their order; of optional ones those that are named (None = all).
    """
    known = METHODS.usable.values()
    if optional is None:
        return tuple(known)
    return tuple(one for one in known if not one.is_optional or one.name in optional)


def origins() -> dict[str, str]:
    """Origin of each method that is not built in, by name: the entry point, or the function that
    creates the method. Optional methods follow from the options of a run.
    """
    made = {
        name: method.create for name, method in METHODS.registered.items() if not method.is_optional
    }
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
    """The method with this name, or the `RangingMethod` that "package.module:OBJECT" names, which
    is registered for the lifetime of the process, as an optional method.

    The command line also searches for the module in the current folder, after the installed ones.
    Raises MethodError: there is no such method, or it cannot be imported or registered.
    """
    if ":" not in text:
        known = METHODS.usable
        if text not in known:
            near = difflib.get_close_matches(text, known, n=3)
            expected = f"did you mean {' or '.join(near)}? Expected" if near else "expected"
            raise MethodError(
                f"unknown ranging method {quoted(text)}: {expected} {', '.join(known)}, or "
                "package.module:OBJECT."
            )
        return known[text]
    search_current_folder()
    module, _, attribute = text.partition(":")
    try:
        method: object = imported(f"{module.removesuffix('.py')}:{attribute}")
    except Exception as error:  # a module of another package may raise anything
        raise MethodError(f"{text}: cannot be imported as a ranging method ({error}).") from error
    if not isinstance(method, RangingMethod):
        raise MethodError(f"{text}: expected a RangingMethod, found {type(method).__name__}.")
    chosen = replace(method, is_optional=True)
    existing = METHODS.usable.get(method.name)
    is_installed = METHODS.origin(method.name).startswith(f"{text} ")
    if existing is not None and (is_installed or existing in (method, chosen)):
        return existing
    register(chosen)
    return chosen


def network_names(kind: str, files: Sequence[Path]) -> dict[str, Path]:
    """Files of networks by the names of their methods: KIND of one file, KIND-FILE of several, with
    the name of the file in lower case and "-" for other characters than letters and digits.

    Raises MethodError: two files have the same name.
    """
    if len(files) == 1:
        return {kind: files[0]}
    named = dict[str, Path]()
    for file in files:
        own = re.sub(r"[^a-z0-9]+", "-", file.stem.lower()).strip("-") or "network"
        other = named.setdefault(f"{kind}-{own}", file)
        if other is not file:
            raise MethodError(
                f"{file}: the columns of two networks have the names of their files, and those of "
                f"{other} and this one would both be {kind}-{own}_m; rename a file, or "
                "give it once."
            )
    return named


def register_networks(names: Iterable[str]) -> None:
    """Register the methods KIND-FILE of networks among `names`, unless they are known; other names
    are left alone.
    """
    for name in names:
        of_network = re.fullmatch(r"([a-z]+)-[a-z0-9-]+", name)
        if of_network is None or name in METHODS.usable:
            continue
        if (describe := NETWORK_METHODS.get(of_network[1])) is not None:
            register(_distinct(imported(describe)(name)))


def _distinct(method: RangingMethod) -> RangingMethod:
    """The method with a letter that no other one has, of its name if possible, and another
    colour.
    """
    used = {other.letter for other in methods()}
    wanted = (*method.name.partition("-")[2].upper(), *_LETTERS)
    letter = next((one for one in wanted if one in _LETTERS and one not in used), None)
    if letter is None:
        raise MethodError(
            f"{method.name}: all letters are in use; give fewer networks to this run."
        )
    colours = [other.colour for other in methods()]
    colour = next((one for one in _NETWORK_COLOURS if one not in colours), method.colour)
    return replace(method, letter=letter, colour=colour)


def methods_of_run(
    chosen: Sequence[str] = (), networks: Collection[str] = (), show_only: Collection[str] = ()
) -> tuple[RangingMethod, ...]:
    """The methods that a run may have, in the order of `methods`.

    `chosen`: names or objects of the methods, see `method_of`; empty = all that are installed or
    registered, of which optional ones measure if the run has their input. The methods of `networks`
    and those of `show_only`, which do not fuse, are part of it in any case. Raises MethodError:
    there is no such method.
    """
    register_networks(networks)
    shown = {method_of(text).name for text in show_only}
    names = {*networks, *shown, *(method_of(text).name for text in chosen)}
    if not chosen:
        names |= {*METHODS.built_in, *(method.name for method in methods(()))}
    return tuple(
        replace(method, fuses=False) if method.name in shown else method
        for method in methods()
        if method.name in names
    )


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
    """Rangers by name, in measuring order, of the `listed` methods with their requirements met;
    None = of the usual `methods_of_run`.

    Each factory gets the context with the rangers created before. Raises MethodError: the `reads`
    of the methods form a cycle.
    """
    rangers: dict[str, Ranger] = {}
    for method in in_measuring_order(methods_of_run() if listed is None else listed):
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
