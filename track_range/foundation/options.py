"""Options of commands and functions: pydantic models in which each option is declared once, as a field.

`track_range.cli.parameters` creates the parameters of the command line from the fields; settings files and the Python
API use the same names.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from types import UnionType
from typing import Any, Self, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import shortened
from track_range.foundation.validation import first_problem


def option(
    description: str,
    *,
    flag: str | None = None,
    metavar: str | None = None,
    panel: str | None = None,
    is_repeated: bool = False,
    is_argument: bool = False,
    is_file_only: bool = False,
    old_names: tuple[str, ...] = (),
    **constraints: Any,
) -> Any:
    """Describe a field of `Options`, in its annotation `Annotated[TYPE, ...]`.

    Args:
        description: help text: a noun phrase with unit, allowed values and default where they are not obvious.
        flag: such as "--start" or "--overlay/--no-overlay"; None = the field's name with hyphens.
        metavar: placeholder of the value in the help.
        panel: heading of the option's section in the help.
        is_repeated: the option is repeated for each value of a list, instead of given once with commas.
        is_argument: the option is positional, without a flag.
        is_file_only: the option exists only in settings files, not on the command line.
        old_names: earlier names of the field, still accepted in files and as hidden options.
        constraints: arguments of `pydantic.Field`: ge, le, gt, lt, allow_inf_nan.
    """
    declaration = {
        "flag": flag,
        "metavar": metavar,
        "panel": panel,
        "is_repeated": is_repeated,
        "is_argument": is_argument,
        "is_file_only": is_file_only,
        "old_names": old_names,
    }
    return Field(description=description, json_schema_extra={"option": declaration}, **constraints)  # type: ignore[dict-item]


def option_of(field: FieldInfo) -> Mapping[str, Any]:
    """The arguments of `option` in the declaration of a field."""
    extra = field.json_schema_extra
    declaration = extra.get("option") if isinstance(extra, dict) else None
    if not isinstance(declaration, Mapping):
        raise TypeError("a field of Options needs an option(...)")
    return declaration


def value_type(field: FieldInfo) -> Any:
    """The type of a field's value, None excluded."""
    annotation = field.annotation
    if get_origin(annotation) in (Union, UnionType):
        kinds = [kind for kind in get_args(annotation) if kind is not type(None)]
        return kinds[0] if len(kinds) == 1 else Union[tuple(kinds)]  # noqa: UP007 - built at run time
    return annotation


def is_list(field: FieldInfo) -> bool:
    """Whether a field is a list, `tuple[X, ...]`."""
    kind = value_type(field)
    return get_origin(kind) is tuple and get_args(kind)[-1] is Ellipsis


class Options(BaseModel):
    """Base class of option models: immutable, unknown names are errors."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, defer_build=True, allow_inf_nan=False
    )  # built when first used: --help is faster

    @model_validator(mode="before")
    @classmethod
    def _old_names_and_lists(cls, given: Any) -> Any:
        """Values by the current names of the fields, with texts such as "car,bus" split into lists."""
        if not isinstance(given, Mapping):
            return given
        values = dict(given)
        for name, field in cls.model_fields.items():
            for old_name in option_of(field)["old_names"]:
                if old_name in values:
                    values.setdefault(name, values.pop(old_name))
            if isinstance(values.get(name), str) and is_list(field):
                values[name] = tuple(part.strip() for part in values[name].split(",")) if values[name].strip() else ()
        return values

    @classmethod
    def flag(cls, name: str) -> str:
        """The option of a field, such as "--start", or the metavar of an argument; unknown names are unchanged."""
        field = cls.model_fields.get(name)
        if field is None or option_of(field)["is_file_only"]:
            return name
        declaration = option_of(field)
        if declaration["is_argument"]:
            return str(declaration["metavar"] or name.upper())
        return str(declaration["flag"] or "--" + name.replace("_", "-")).partition("/")[0]

    @classmethod
    def problem(cls, error: ValidationError) -> str:
        """The first validation error as one sentence that begins with the option."""
        first = error.errors()[0]
        if first["type"] == "extra_forbidden":
            name = str(first["loc"][0])
            near = difflib.get_close_matches(name, cls.model_fields, n=1)
            return f"{shortened(name)}: unknown option{f'; did you mean {near[0]}?' if near else '.'}"
        place = f"{cls.flag(str(first['loc'][0]))}: " if first["loc"] else ""
        return f"{place}{first_problem(error)[1]}."

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """Options from values by name; None values are treated as not given.

        Raises:
            UsageError: a value is missing, invalid or contradicts another.
        """
        try:
            return cls(**{name: value for name, value in given.items() if value is not None})
        except ValidationError as error:
            raise UsageError(cls.problem(error)) from error
