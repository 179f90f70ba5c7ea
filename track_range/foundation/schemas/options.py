"""Options of commands and functions: pydantic models in which each option is declared once, as a
field.

`track_range.cli.shared.parameters` creates the parameters of the command line from the fields; settings
files and the Python API use the same names.
"""

import difflib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Any, ClassVar, Literal, Self, Union, get_args, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted, shortened
from track_range.foundation.schemas.validation import first_problem


@dataclass(frozen=True, slots=True, kw_only=True)
class Declaration:
    """Everything about an option besides its type, default and help text."""

    # such as "--start" or "--overlay/--no-overlay"; None = the field's name with hyphens
    flag: str | None = None
    metavar: str | None = None  # placeholder of the value in the help, without the words
    words: tuple[str, ...] = ()  # values with a special meaning, such as "auto" and "off"
    # returns the values of an option of type `str` that has no others; called when they are needed,
    # since tables of formats import libraries
    choices: Callable[[], Iterable[str]] | None = None
    # heading of the option's section in the help; None = that of the model in which the option is
    # declared
    panel: str | None = None
    # the option is repeated for each value of a list, instead of given once with commas
    is_repeated: bool = False
    is_argument: bool = False  # the option is positional, without a flag
    is_file_only: bool = False  # the option exists only in settings files, not on the command line
    # a text that may be the path of a file or folder; fields of type `Path` are
    is_file: bool = False
    # the first part of the results that the option changes; "" = that of the model in which the
    # option is declared
    stage: str = ""
    # the clips of a fleet may have different values, in a column of the manifest
    is_per_clip: bool = False
    # all clips of a fleet have one value: a manifest has no column with this name
    is_shared: bool = False
    # why a fleet does not take the option, and what to do instead; "" = it takes it
    instead: str = ""
    # earlier names of the field, still accepted in files and as hidden options
    old_names: tuple[str, ...] = ()


def option(description: str, **given: Any) -> Any:
    """Describe a field of `Options`, in its annotation `Annotated[TYPE, ...]`.

    `description` is the help text: a noun phrase with unit, allowed values and default where they
    are not obvious; `given` contains attributes of `Declaration` and limits, which are arguments of
    `pydantic.Field`.
    """
    limits = {
        name: given.pop(name) for name in {"ge", "le", "gt", "lt", "min_length"} & given.keys()
    }
    declaration: Any = Declaration(**given)
    return Field(description=description, json_schema_extra={"option": declaration}, **limits)


def option_of(field: FieldInfo) -> Declaration:
    """The declaration of a field."""
    extra = field.json_schema_extra
    declaration: object = extra.get("option") if isinstance(extra, dict) else None
    if not isinstance(declaration, Declaration):
        raise TypeError("a field of Options needs an option(...)")
    return declaration


def value_type(field: FieldInfo) -> Any:
    """The type of a field's value, None excluded."""
    annotation = field.annotation
    if get_origin(annotation) in (Union, UnionType):
        types = [part for part in get_args(annotation) if part is not type(None)]
        return types[0] if len(types) == 1 else Union[tuple(types)]  # noqa: UP007 - built at run time
    return annotation


def is_list(field: FieldInfo) -> bool:
    """Whether a field is a list, `tuple[X, ...]`."""
    python_type = value_type(field)
    return get_origin(python_type) is tuple and get_args(python_type)[-1] is Ellipsis


def is_path(field: FieldInfo) -> bool:
    """Whether the value of a field, or each of a list, is the path of a file or folder."""
    kind = value_type(field)
    return (get_args(kind)[0] if is_list(field) else kind) is Path


def is_file(field: FieldInfo) -> bool:
    """Whether the value of a field is, or may be, the path of a file or folder, or several."""
    return is_path(field) or option_of(field).is_file


def choices_of(field: FieldInfo) -> Sequence[str]:
    """The allowed values of a field with a fixed choice; () for other fields."""
    python_type, listed = value_type(field), option_of(field).choices
    return (
        get_args(python_type)
        if get_origin(python_type) is Literal
        else ()
        if listed is None
        else tuple(listed())
    )


_CONTRADICTION = "contradiction"  # type of error


def contradiction(sentence: str, options: Sequence[str]) -> PydanticCustomError:
    """Error of a validator for fields of a model that contradict each other; see
    `Options.causes`.
    """
    return PydanticCustomError(
        _CONTRADICTION, "{sentence}", {"sentence": sentence, "options": options}
    )


class Options(BaseModel):
    """Base class of option models: immutable, unknown names are errors.

    Numbers, paths and lists of names are accepted for texts, and texts such as "car,bus" for lists.
    """

    panel: ClassVar[str | None] = None  # heading in the help; None = that of the other options
    stage: ClassVar[str] = ""  # of the options that declare none

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        defer_build=True,
        allow_inf_nan=False,
        coerce_numbers_to_str=True,
    )  # built when first used: --help is faster

    @model_validator(mode="before")
    @classmethod
    def _current_names(cls, given: Any) -> Any:
        return cls.with_current_names(given) if isinstance(given, Mapping) else given

    @classmethod
    def with_current_names(cls, given: Mapping[str, Any]) -> dict[str, Any]:
        """Values by name, of which some may have earlier names of the fields."""
        values = dict(given)
        for name, field in cls.model_fields.items():
            for old_name in option_of(field).old_names:
                if old_name in values:
                    values.setdefault(name, values.pop(old_name))
        return values

    @field_validator("*", mode="before")
    @classmethod
    def _in_its_type(cls, value: Any, info: ValidationInfo) -> Any:
        """A value from Python or YAML in the type of its field where the meaning is clear; the
        choices are checked.
        """
        field = cls.model_fields[info.field_name or ""]
        python_type, declaration = value_type(field), option_of(field)
        if is_list(field) and is_path(field) and isinstance(value, str | os.PathLike):
            return (value,)  # names of files may have commas
        if isinstance(value, str) and is_list(field):
            return tuple(part.strip() for part in value.split(",")) if value.strip() else ()
        if python_type is not str:
            return value
        if value is False and "off" in declaration.words:
            return "off"  # YAML reads an unquoted `off` as false
        if isinstance(value, list | tuple) and all(isinstance(part, str) for part in value):
            return ",".join(value)
        if (
            declaration.choices is not None
            and value is not None
            and value not in (names := choices_of(field))
        ):
            raise ValueError(
                f"expected {', '.join(map(repr, names[:-1]))} or {names[-1]!r}, found "
                f"{quoted(value)}"
            )
        return os.fspath(value) if isinstance(value, os.PathLike) else value

    @classmethod
    def fields_where(cls, is_chosen: Callable[[FieldInfo], object]) -> frozenset[str]:
        """Names of the fields for which a condition holds."""
        return frozenset(name for name, field in cls.model_fields.items() if is_chosen(field))

    @classmethod
    def panel_of(cls, name: str) -> str | None:
        """Heading under which a field is listed in the help."""
        declared_in = cls._declared_in(name)
        return option_of(cls.model_fields[name]).panel or getattr(declared_in, "panel", None)

    @classmethod
    def stage_of(cls, name: str) -> str:
        """The first part of the results that an option changes; "" = it has none."""
        declared_in = cls._declared_in(name)
        return option_of(cls.model_fields[name]).stage or getattr(declared_in, "stage", "")

    @classmethod
    def _declared_in(cls, name: str) -> type:
        return next(base for base in cls.__mro__ if name in base.__annotations__)

    @classmethod
    def flag(cls, name: str) -> str:
        """The option of a field, such as "--start", or the metavar of an argument; unknown names
        are unchanged.
        """
        field = cls.model_fields.get(name)
        if field is None or option_of(field).is_file_only:
            return name
        declaration = option_of(field)
        if declaration.is_argument:
            return declaration.metavar or name.upper()
        return (declaration.flag or "--" + name.replace("_", "-")).partition("/")[0]

    @classmethod
    def keywords(cls) -> dict[str, str]:
        """Fields by keyword in Python: the name, or the flag's name, such as `duration` for
        duration_s.
        """
        flags = {
            name: cls.flag(name).removeprefix("--").replace("-", "_") for name in cls.model_fields
        }
        return {keyword: name for name, of_flag in flags.items() for keyword in (of_flag, name)}

    @classmethod
    def problem(cls, error: ValidationError) -> str:
        """The first validation error as one sentence that begins with the option."""
        first = error.errors()[0]
        if first["type"] == "extra_forbidden":
            name = str(first["loc"][0])
            near = difflib.get_close_matches(name, cls.model_fields, n=1)
            return (
                f"{shortened(name)}: unknown option{f'; did you mean {near[0]}?' if near else '.'}"
            )
        if first["type"] == _CONTRADICTION:
            return f"{first['msg'].removesuffix('.')}."
        place = f"{cls.flag(str(first['loc'][0]))}: " if first["loc"] else ""
        return f"{place}{first_problem(error)[1]}."

    @classmethod
    def causes(cls, error: ValidationError) -> tuple[str, ...]:
        """The fields that the first validation error is about: several if they contradict each
        other.
        """
        first = error.errors()[0]
        if first["type"] == _CONTRADICTION:
            return tuple(first["ctx"]["options"])
        return tuple(str(name) for name in first["loc"][:1])

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """Options from values by name, None = not given; UsageError for missing, invalid or
        conflicting options.
        """
        try:
            return cls(**{name: value for name, value in given.items() if value is not None})
        except ValidationError as error:
            raise UsageError(cls.problem(error)) from error
