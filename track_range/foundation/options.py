"""Options of commands and functions: pydantic models whose fields are the options, each declared once.

The command line makes its parameters from the fields (`track_range.cli.parameters`), settings files hold the same
fields, and Python code passes the same names.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from types import UnionType
from typing import Any, Self, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from track_range.foundation.errors import UsageError


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
        panel: heading under which the help lists it.
        is_repeated: a field of many values is filled by giving the option again; otherwise by values with commas.
        is_argument: positional, without a flag.
        is_file_only: no option of the command line, only a key of settings files.
        old_names: earlier names of the field, still accepted in files and as hidden options.
        constraints: of `pydantic.Field`: ge, le, gt, lt, allow_inf_nan.
    """
    shown = {
        "flag": flag,
        "metavar": metavar,
        "panel": panel,
        "is_repeated": is_repeated,
        "is_argument": is_argument,
        "is_file_only": is_file_only,
        "old_names": old_names,
    }
    return Field(description=description, json_schema_extra={"option": shown}, **constraints)  # type: ignore[dict-item]


def option_of(field: FieldInfo) -> Mapping[str, Any]:
    """The arguments that `option` was given for a field."""
    extra = field.json_schema_extra
    shown = extra.get("option") if isinstance(extra, dict) else None
    if not isinstance(shown, Mapping):
        raise TypeError("a field of Options needs an option(...)")
    return shown


def value_type(field: FieldInfo) -> Any:
    """The type of a field's value, without None."""
    annotation = field.annotation
    if get_origin(annotation) in (Union, UnionType):
        kinds = [kind for kind in get_args(annotation) if kind is not type(None)]
        return kinds[0] if len(kinds) == 1 else Union[tuple(kinds)]  # noqa: UP007 - built at run time
    return annotation


def is_list(field: FieldInfo) -> bool:
    """Whether a field holds any number of values: `tuple[X, ...]`."""
    kind = value_type(field)
    return get_origin(kind) is tuple and get_args(kind)[-1] is Ellipsis


class Options(BaseModel):
    """Base of options: immutable, and without unknown names."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)  # built when first used: --help is faster

    @model_validator(mode="before")
    @classmethod
    def _old_names_and_lists(cls, given: Any) -> Any:
        """Values under the fields' present names, and texts such as "car,bus" as lists."""
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
        """The option of a field, such as "--start", or its metavar for an argument; other names as they are."""
        field = cls.model_fields.get(name)
        if field is None or option_of(field)["is_file_only"]:
            return name
        shown = option_of(field)
        if shown["is_argument"]:
            return str(shown["metavar"] or name.upper())
        return str(shown["flag"] or "--" + name.replace("_", "-")).partition("/")[0]

    @classmethod
    def problem(cls, error: ValidationError) -> str:
        """The first fault of options as one sentence that begins with the option."""
        first = error.errors()[0]
        if first["type"] == "extra_forbidden":
            name = str(first["loc"][0])
            near = difflib.get_close_matches(name, cls.model_fields, n=1)
            return f"{name}: unknown option{f'; did you mean {near[0]}?' if near else '.'}"
        place = f"{cls.flag(str(first['loc'][0]))}: " if first["loc"] else ""
        return f"{place}{first['msg'].removeprefix('Value error, ')}."

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """Options from values by name; None = not given.

        Raises:
            UsageError: a value is missing, wrong or contradicts another.
        """
        try:
            return cls(**{name: value for name, value in given.items() if value is not None})
        except ValidationError as error:
            raise UsageError(cls.problem(error)) from error
