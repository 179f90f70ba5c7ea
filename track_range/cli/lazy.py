"""Groups of commands whose modules are imported when one of them is invoked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, ClassVar, NamedTuple

import typer

from track_range.cli.help_pages import HelpCommand, HelpGroup


class Lazy(NamedTuple):
    """A command of a group.

    Attributes:
        module: module with the command, or with a group of commands, as a `typer.Typer` called `app`; "module:NAME"
            where it has another name.
        summary: sentence in the list of commands, and the first one of the command's help page.
        description: paragraph below the summary on the help page; "" = none.
        examples: command lines at the end of the help page.
    """

    module: str
    summary: str
    description: str = ""
    examples: tuple[str, ...] = ()


class LazyGroup(HelpGroup):
    """A group that lists its commands by their summaries and imports only the command that is invoked."""

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
        """Name of the invoked command, the command itself (imported), and the remaining arguments."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, command if name is None else self.load(name), rest


def lazy_app(
    modules: Mapping[str, Lazy], *, description: str = "", examples: tuple[str, ...] = (), **settings: Any
) -> typer.Typer:
    """A group of the commands in `modules`, by name.

    Args:
        modules: the commands in the order of the help page.
        description: as in `Lazy`, for a group that is not in another one.
        examples: as in `Lazy`.
        settings: arguments of typer.Typer.
    """
    group = type("Group", (LazyGroup,), {"modules": modules, "description": description, "examples": examples})
    app = typer.Typer(cls=group, no_args_is_help=True, rich_markup_mode=None, **{"add_completion": False, **settings})
    for name, lazy in modules.items():
        app.command(name, help=lazy.summary)(_placeholder)
    return app


def single_app(callback: Callable[..., None], command_class: type[HelpCommand] = HelpCommand) -> typer.Typer:
    """An application of one command, for `Lazy`."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(cls=command_class)(callback)
    return app


def _placeholder() -> None:
    """Stand-in for a command that has not been imported."""
