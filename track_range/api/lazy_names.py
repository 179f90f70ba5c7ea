"""Names of a module that are imported when they are first used."""

import warnings
from collections.abc import Mapping
from importlib import import_module
from typing import Any


class LazyNames:
    """Public names of a front module, by the module that defines them.

    `names` are by full name of the module; "name=NAME" where the name differs there, and "name="
    for the module itself. `former` are names of earlier versions with their present places,
    "module:NAME": they are not listed, and their use is a DeprecationWarning.
    """

    def __init__(
        self, module: str, names: Mapping[str, str], former: Mapping[str, str] | None = None
    ) -> None:
        self._module, self._former = module, former or {}
        self._places = {
            name.partition("=")[0]: (place, name.rpartition("=")[2])
            for place, listed in names.items()
            for name in listed.split()
        }

    @property
    def listed(self) -> list[str]:
        """The names, without those of earlier versions."""
        return list(self._places)

    @property
    def modules(self) -> set[str]:
        """The modules that define the names, also those of earlier versions."""
        former = {place.partition(":")[0] for place in self._former.values()}
        return former | {place for place, _ in self._places.values()}

    def value(self, name: str) -> Any:
        """The value of a name, for `__getattr__`; AttributeError if there is none."""
        if name in self._former:
            place, _, attribute = self._former[name].partition(":")
            warnings.warn(
                f"{self._module}.{name} is the former name of {place}.{attribute}, and ends with "
                "the next version",
                DeprecationWarning,
                stacklevel=3,
            )
        elif name in self._places:
            place, attribute = self._places[name]
        else:
            raise AttributeError(f"module {self._module!r} has no attribute {name!r}")
        module = import_module(place)
        return getattr(module, attribute) if attribute else module
