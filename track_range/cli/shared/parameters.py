"""Typer parameters of commands, made from the fields of `Options`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import Parameter, Signature
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

import typer
from annotated_types import Ge, Le
from pydantic.fields import FieldInfo

from track_range.cli.shared.bare_recordings import refuse_bare, refuse_expanded
from track_range.cli.shared.lazy import CommandGroup, HelpCommand, Lazy, lazy_app
from track_range.foundation.schemas.options import (
    Options,
    choices_of,
    is_list,
    option_of,
    value_type,
)

_O = TypeVar("_O", bound=Options)

_CONTEXT = "context"  # parameter of a command with sub-commands

# in the help, by type; "" for a switch
_PLACEHOLDERS = {bool: "", int: "N", float: "NUMBER", Path: "FILE"}


class PairOptions:
    """Mix-in of commands with the option --stereo, which takes one or two values: one is the
    recording of both cameras.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line with --stereo as its parameter takes it; see `_split_pairs`.

        UsageError: more files than --mono or --stereo takes, as after a pattern that was not
        quoted.
        """
        for option, most in (("--mono", 1), ("--stereo", 2)):
            after = args[args.index(option) + 1 :] if option in args else []
            refuse_expanded(
                option, [*takewhile(lambda value: not value.startswith("-"), after)], most
            )
        parameters: list[Any] = self.params  # type: ignore[attr-defined]
        stereo = next(parameter for parameter in parameters if parameter.name == "stereo")
        parts = _split_pairs(args, is_single=stereo.nargs == 1)
        return super().parse_args(ctx, parts)  # type: ignore[misc,no-any-return]


class PairCommand(PairOptions, HelpCommand):
    """Command with the option --stereo."""


class PairGroup(PairOptions, CommandGroup):
    """Command with the option --stereo that has sub-commands too, the first one for recordings."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line; UsageError: recordings without an option or a sub-command."""
        if not self.modules.keys() & args[:1]:
            refuse_bare(args, ctx.command_path, next(iter(self.modules)))
        return super().parse_args(ctx, args)


def _split_pairs(args: list[str], *, is_single: bool) -> list[str]:
    """Arguments in which `--stereo` has two values: two options if `is_single`; a missing RIGHT is
    "", or else LEFT.
    """
    split, rest = list[str](), list(args)
    while rest:
        name, equals, value = rest.pop(0).partition("=")
        if name == "--":
            return [*split, name, *rest]
        if name != "--stereo":
            split.append(f"{name}{equals}{value}")
            continue
        values = [value] if equals else []
        while rest and len(values) < 2 and not rest[0].startswith("-"):
            values.append(rest.pop(0))
        if not values:
            split.append(name)  # the parser reports that a value is missing
        elif is_single:
            split += [f"{name}={part}" for part in (*values, "")[:2]]
        else:
            split += [name, values[0], values[-1]]
    return split


def command(model: type[_O], function: Callable[[_O], object]) -> typer.Typer:
    """Application of one command with the fields of `model` as parameters; it calls `function` with
    the options.
    """

    def callback(**values: Any) -> None:
        function(model.of(given_values(model, values)))

    return command_of(
        callback, parameters(model), PairCommand if "stereo" in model.model_fields else HelpCommand
    )


def command_group(
    model: type[_O], function: Callable[[_O], object], modules: Mapping[str, Lazy]
) -> typer.Typer:
    """As `command`, for a command that has the sub-commands `modules` too."""

    def callback(**values: Any) -> None:
        context = values.pop(_CONTEXT)
        if context.invoked_subcommand is None:
            function(model.of(given_values(model, values)))

    context = Parameter(_CONTEXT, Parameter.KEYWORD_ONLY, annotation=typer.Context)
    app = lazy_app(modules, group=PairGroup, no_args_is_help=False, invoke_without_command=True)
    app.callback()(_with_parameters(callback, [context, *parameters(model)]))
    return app


def command_of(
    callback: Callable[..., None],
    listed: list[Parameter],
    command_class: type[HelpCommand] = HelpCommand,
) -> typer.Typer:
    """Application of one command, which calls `callback` with the given parameters."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(cls=command_class)(_with_parameters(callback, listed))
    return app


def _with_parameters(callback: Callable[..., None], listed: list[Parameter]) -> Callable[..., None]:
    """The function, for Typer with the given parameters."""
    callback.__signature__ = Signature(listed)  # type: ignore[attr-defined]
    callback.__annotations__ = {parameter.name: parameter.annotation for parameter in listed}
    return callback


def parameters(model: type[Options], *, is_only_given: bool = False) -> list[Parameter]:
    """Parameters of the options of a model, with hidden ones for old names.

    Options that are not given are None, so that the model knows which are. With `is_only_given`, no
    option is required, since a settings file may contain it, and values are checked only by the
    model, whose errors are one sentence for any source.
    """
    listed = []
    for name, field in model.model_fields.items():
        shown = option_of(field)
        if shown.is_file_only:
            continue
        kind = _typer_type(field)
        if is_only_given and get_origin(kind) is Literal:
            kind = str
        default = Parameter.empty if field.is_required() and not is_only_given else None
        declaration = _declaration(model, name, is_checked=not is_only_given)
        listed.append(_parameter(name, kind, declaration, default))
        for old_name in shown.old_names:
            old = "--" + old_name.replace("_", "-")
            is_switch = "/" in (shown.flag or "")  # with a negative form
            flag = f"{old}/--no-{old.removeprefix('--')}" if is_switch else old
            listed.append(_parameter(old_name, kind, typer.Option(flag, hidden=True), None))
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
    return Parameter(
        name, Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[value, declaration]
    )


def _declaration(model: type[Options], name: str, *, is_checked: bool) -> Any:
    """typer.Option or typer.Argument of a field, with its bounds or choices if `is_checked`."""
    field = model.model_fields[name]
    shown, kind = option_of(field), value_type(field)
    placeholder = "|".join(choices_of(field)) or _PLACEHOLDERS.get(kind, "TEXT")
    common: dict[str, Any] = {
        "help": _help(field),
        "show_default": False,  # the help text names it
        "metavar": "|".join((*shown.words, shown.metavar or placeholder)) or None,
        "rich_help_panel": model.panel_of(name),
    }
    if (choices := choices_of(field)) and not is_checked:
        common["autocompletion"] = lambda incomplete: [
            word for word in choices if word.startswith(incomplete)
        ]
    if kind in (int, float) and is_checked:
        common["min"] = next((mark.ge for mark in field.metadata if isinstance(mark, Ge)), None)
        common["max"] = next((mark.le for mark in field.metadata if isinstance(mark, Le)), None)
    if shown.is_argument:
        return typer.Argument(**common)
    return typer.Option(shown.flag or model.flag(name), **common)


def _typer_type(field: FieldInfo) -> Any:
    """Type for Typer's parsing of a field; unsupported types are parsed as text and validated by
    the model.
    """
    if choices := choices_of(field):
        return Literal[*choices]
    kind, is_repeated = value_type(field), option_of(field).is_repeated
    parts = get_args(kind) if get_origin(kind) is tuple else (kind,)
    if is_repeated:
        return list[_plain(parts[0])]  # type: ignore[misc]
    if len(parts) > 1 and parts[1:] != (Ellipsis,):
        return tuple[tuple(map(_plain, parts))]  # type: ignore[misc]
    return _plain(kind)  # str for a list


def _plain(kind: Any) -> Any:
    return kind if kind in (str, int, float, bool, Path) else str


def _help(field: FieldInfo) -> str:
    """Help text of an option with its default, or "(required)"."""
    text = (field.description or "").removesuffix(".")
    if option_of(field).metavar and (choices := choices_of(field)):  # too many for a placeholder
        text = f"{text}: {', '.join(choices)}"
    if field.is_required():
        return f"{text}." if option_of(field).is_argument else f"{text} (required)."
    value = ",".join(map(str, field.default)) if is_list(field) else field.default
    is_shown = isinstance(value, str | int | float | Path | tuple) and not isinstance(value, bool)
    if not is_shown or value in ("", Path()) or "(default:" in text:
        return f"{text}."
    parts = value if isinstance(value, tuple) else (value,)
    shown = " ".join(f"{part:g}" if isinstance(part, float) else str(part) for part in parts)
    return f"{text} (default: {shown})."
