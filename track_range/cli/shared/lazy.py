"""Groups of commands whose modules are imported when a command is invoked, and the layout of all
help pages.

Help pages are plain text that reads well at 80 columns: options under their headings, then
examples. Rich's boxes would show the types of values in a column, cut off long option names and
leave 30 characters for texts.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any, ClassVar, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

# largest width of the first column, in characters; longer names have their text on the next line
_OPTION_COLUMNS = 26
# key of a context's data: whether the first argument names a sub-command
_IS_SUB_COMMAND = "track_range.is_sub_command"


class HelpPage:
    """Mix-in of commands and groups: the layout of their help page."""

    description: str = ""
    examples: Sequence[str] = ()

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line; errors of values are worded like those of files."""
        try:
            return super().parse_args(ctx, args)  # type: ignore[misc,no-any-return]
        except typer.BadParameter as error:
            from pydantic import ValidationError

            if isinstance(error.__cause__, ValidationError):
                from track_range.foundation.schemas.validation import first_problem

                error.message = f"{first_problem(error.__cause__)[1].removesuffix('.')}."
            raise

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, and options under the headings of their panels, in the order of
        declaration.
        """
        arguments: list[tuple[str, str]] = []
        panels: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):  # type: ignore[attr-defined]
            if parameter.hidden:
                continue
            if parameter.param_type_name == "argument":
                arguments.append((_argument_name(parameter), parameter.help or ""))
                continue
            is_help = parameter.opts == ["--help"]
            panel = "Help" if is_help else parameter.rich_help_panel or "Options"
            panels.setdefault(panel, []).append((_option_name(parameter), parameter.help or ""))
        _write_list(formatter, "Arguments", arguments)
        help_option = panels.pop("Help", [])
        if len(panels) <= 1:  # a page with one list has --help at its end
            _write_list(
                formatter,
                "Options",
                [*(row for rows in panels.values() for row in rows), *help_option],
            )
            return
        for panel, rows in panels.items():
            _write_list(formatter, panel, rows)
        _write_list(formatter, "Help", help_option)

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write the summary and the description."""
        super().format_help_text(ctx, formatter)  # type: ignore[misc]
        if self.description:
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_text(self.description)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples, each on a line that can be copied."""
        super().format_epilog(ctx, formatter)  # type: ignore[misc]
        if self.examples:
            with formatter.section("Examples"):
                for example in self.examples:
                    formatter.write(f"{'':>{formatter.current_indent}}{example}\n")

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Pieces of the usage line: the options, then the arguments by their placeholders."""
        pieces = ["[OPTIONS]"]
        for parameter in self.get_params(ctx):  # type: ignore[attr-defined]
            if parameter.param_type_name == "argument" and not parameter.hidden:
                pieces.append(_argument_name(parameter))
        return pieces


class HelpCommand(HelpPage, TyperCommand):
    """Command with a help page of this layout."""


class HelpGroup(HelpPage, TyperGroup):
    """Group of commands with a help page of this layout, which lists the commands with their full
    summaries.
    """

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, then the options of the group."""
        listed = ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx))
        commands = [
            (name, command.help or "") for name, command in listed if command and not command.hidden
        ]
        _write_list(formatter, "Commands", commands)
        super().format_options(ctx, formatter)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Pieces of the usage line."""
        return ["COMMAND [OPTIONS]"]


def _write_list(formatter: Any, heading: str, rows: Iterable[tuple[str, str]]) -> None:
    """Write names and texts in two columns under a heading; nothing if there are no rows."""
    rows = list(rows)
    if not rows:
        return
    column = min(max(len(name) for name, _ in rows), _OPTION_COLUMNS) + 2
    with formatter.section(heading):
        margin = " " * formatter.current_indent
        for name, text in rows:
            # no line breaks at hyphens, which are parts of names (unlike click's own lists)
            lines = textwrap.wrap(
                text,
                formatter.width - column - len(margin),
                break_on_hyphens=False,
                break_long_words=False,
            ) or [""]
            if len(name) > column - 2:
                lines.insert(0, name)
            else:
                lines[0] = f"{name:{column}}{lines[0]}"
            formatter.write(f"{margin}{lines[0]}".rstrip() + "\n")
            formatter.write("".join(f"{margin}{'':{column}}{line}\n" for line in lines[1:]))


def _argument_name(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper())


def _option_name(parameter: Any) -> str:
    """Names of an option and the placeholder of its value, such as "--start S" or "--sgbm /
    --no-sgbm".
    """
    names = ", ".join(parameter.opts)
    if parameter.secondary_opts:
        return f"{names} / {', '.join(parameter.secondary_opts)}"
    return names if parameter.is_flag or not parameter.metavar else f"{names} {parameter.metavar}"


class Lazy(NamedTuple):
    """A command of a group, or a group of commands."""

    module: str  # with a `typer.Typer` called `app`; "module:NAME" where it has another name
    summary: str  # in the list of commands, and the first sentence of the command's help page
    description: str = ""  # paragraph below the summary on the help page
    examples: tuple[str, ...] = ()  # command lines at the end of the help page


class LazyGroup(HelpGroup):
    """A group that lists its commands by their summaries and imports only the command that is
    invoked.
    """

    modules: ClassVar[Mapping[str, Lazy]] = {}

    def load(self, name: str) -> Any:
        """The command or group `name`, imported."""
        lazy = self.modules[name]
        module, _, app = lazy.module.partition(":")
        command: Any = typer.main.get_command(getattr(import_module(module), app or "app"))
        command.name, command.help = name, lazy.summary
        command.description, command.examples = lazy.description, lazy.examples
        return command

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Name of the invoked command, the command itself (imported), and the remaining
        arguments.
        """
        name, command, rest = super().resolve_command(ctx, args)
        return name, command if name is None else self.load(name), rest


class CommandGroup(LazyGroup):
    """A command that has sub-commands too: its own options are parsed unless the first argument
    names a sub-command.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the options of the command, or only the name of a sub-command."""
        ctx.meta[_IS_SUB_COMMAND] = bool(args) and not args[0].startswith("-")
        return super().parse_args(ctx, args)

    def get_params(self, ctx: Any) -> list[Any]:
        """Parameters of the command, of which none but --help applies beside a sub-command."""
        params = super().get_params(ctx)
        if ctx.meta.get(_IS_SUB_COMMAND):
            return [parameter for parameter in params if parameter.opts == ["--help"]]
        return params

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Pieces of the usage line."""
        return ["[OPTIONS] | COMMAND [OPTIONS]"]


def lazy_app(
    modules: Mapping[str, Lazy],
    *,
    examples: tuple[str, ...] = (),
    group: type[LazyGroup] = LazyGroup,
    **settings: Any,
) -> typer.Typer:
    """A group of the commands in `modules`, of the class `group`; `examples` only for a top-level
    group; `settings` for typer.Typer.
    """
    app = typer.Typer(
        cls=type("Group", (group,), {"modules": modules, "examples": examples}),
        rich_markup_mode=None,
        **{"no_args_is_help": True, "add_completion": False, **settings},
    )
    for name, lazy in modules.items():
        app.command(name, help=lazy.summary)(_placeholder)
    return app


def _placeholder() -> None:
    """Stand-in for a command that has not been imported."""
