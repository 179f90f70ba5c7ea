"""Typer parameters of commands, made from the fields of `Options`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import typer
from annotated_types import Ge, Le
from pydantic.fields import FieldInfo

from track_range.cli.lazy import HelpCommand
from track_range.foundation.options import Options, choices_of, is_list, option_of, value_type

_O = TypeVar("_O", bound=Options)


def command(model: type[_O], function: Callable[[_O], object]) -> typer.Typer:
    """Application of one command with the fields of `model` as parameters; it calls `function` with the options."""

    def callback(**values: Any) -> None:
        function(model.of(given_values(model, values)))

    return command_of(callback, parameters(model))


def command_of(
    callback: Callable[..., None], listed: list[Parameter], command_class: type[HelpCommand] = HelpCommand
) -> typer.Typer:
    """Application of one command, which calls `callback` with these parameters."""
    callback.__signature__ = Signature(listed)  # type: ignore[attr-defined]
    callback.__annotations__ = {parameter.name: parameter.annotation for parameter in listed}
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(cls=command_class)(callback)
    return app


def parameters(model: type[Options], *, is_only_given: bool = False) -> list[Parameter]:
    """Parameters of the options of a model, with hidden ones for old names.

    With `is_only_given` all defaults are None, so that options that are not given can come from a settings file. Values
    are then checked only by the model, whose errors are one sentence for any source of a value.
    """
    listed = []
    for name, field in model.model_fields.items():
        shown = option_of(field)
        if shown.is_file_only:
            continue
        kind = _typer_type(field)
        if is_only_given and get_origin(kind) is Literal:
            kind = str
        is_optional = is_only_given or (bool(shown.old_names) and not field.is_required())
        default = None if is_optional else _default(field)
        declaration = _declaration(model, name, is_checked=not is_only_given)
        listed.append(_parameter(name, kind, declaration, default))
        for old_name in shown.old_names:
            hidden = typer.Option(_old_flag(model.flag(name), shown.flag, old_name), hidden=True)
            listed.append(_parameter(old_name, kind, hidden, None))
    return listed


def given_values(model: type[Options], values: Mapping[str, Any]) -> dict[str, Any]:
    """Values that are given, by field of the model."""
    given: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        for key in (name, *option_of(field).old_names):
            value = values.get(key)
            if value is not None and not (isinstance(value, list) and not value):
                given.setdefault(name, value)
    return given


def _parameter(name: str, kind: Any, declaration: Any, default: Any) -> Parameter:
    value: Any = kind | None if default is None else kind
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[value, declaration])


def _declaration(model: type[Options], name: str, *, is_checked: bool) -> Any:
    """typer.Option or typer.Argument of a field, with its bounds or choices if `is_checked`."""
    field = model.model_fields[name]
    shown, kind = option_of(field), value_type(field)
    common: dict[str, Any] = {
        "help": _help(field),
        "show_default": False,  # the help text names it
        "metavar": "|".join((*shown.words, shown.metavar or _placeholder(field))) or None,
        "rich_help_panel": model.panel_of(name),
    }
    if (choices := choices_of(field)) and not is_checked:
        common["autocompletion"] = lambda incomplete: [word for word in choices if word.startswith(incomplete)]
    if kind in (int, float) and is_checked:
        common["min"] = next((mark.ge for mark in field.metadata if isinstance(mark, Ge)), None)
        common["max"] = next((mark.le for mark in field.metadata if isinstance(mark, Le)), None)
    if shown.is_argument:
        return typer.Argument(**common)
    return typer.Option(shown.flag or model.flag(name), **common)


def _placeholder(field: FieldInfo) -> str:
    """Placeholder of a value in the help where the option declares none; "" for a switch."""
    return "|".join(choices_of(field)) or _PLACEHOLDERS.get(value_type(field), "TEXT")


_PLACEHOLDERS = {bool: "", int: "N", float: "NUMBER", Path: "FILE"}
"""Default placeholder in the help by type of the value."""


def _typer_type(field: FieldInfo) -> Any:
    """Type for Typer's parsing of a field; unsupported types are parsed as text and validated by the model."""
    if choices := choices_of(field):
        return Literal[*choices]
    kind, is_repeated = value_type(field), option_of(field).is_repeated
    if get_origin(kind) is tuple:
        first, *others = get_args(kind)
        if others != [Ellipsis] and not is_repeated:
            return tuple[tuple(_plain(part) for part in (first, *others))]  # type: ignore[misc]
        return list[_plain(first)] if is_repeated else str  # type: ignore[misc]
    if is_repeated:
        return list[_plain(kind)]  # type: ignore[misc]
    return _plain(kind)


def _plain(kind: Any) -> Any:
    return kind if kind in (str, int, float, bool, Path) else str


def _default(field: FieldInfo) -> Any:
    """Default of a field for Typer; `Parameter.empty` if the field is required."""
    if field.is_required():
        return Parameter.empty
    if is_list(field):
        return ",".join(map(str, field.default)) or None
    return field.default


def _help(field: FieldInfo) -> str:
    """Help text of an option with its default, or "(required)"."""
    text = (field.description or "").removesuffix(".")
    if field.is_required():
        return f"{text}." if option_of(field).is_argument else f"{text} (required)."
    value = ",".join(map(str, field.default)) if is_list(field) else field.default
    if isinstance(value, bool) or not isinstance(value, str | int | float | Path | tuple) or value in ("", Path()):
        return f"{text}."
    if "(default:" in text:
        return f"{text}."
    if isinstance(value, tuple):
        shown = " ".join(f"{part:g}" if isinstance(part, float) else str(part) for part in value)
    else:
        shown = f"{value:g}" if isinstance(value, float) else str(value)
    return f"{text} (default: {shown})."


def _old_flag(flag: str, declared: str | None, old_name: str) -> str:
    """Option for an old name, with a negative form if the current option has one."""
    old = "--" + old_name.replace("_", "-")
    return f"{old}/--no-{old.removeprefix('--')}" if declared and "/" in declared else old
