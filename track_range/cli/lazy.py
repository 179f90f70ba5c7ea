"""Groups of commands whose modules are imported when one of them is invoked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, ClassVar, NamedTuple

import typer
from typer.core import TyperGroup


class Lazy(NamedTuple):
    """A command of a group.

    Attributes:
        module: holds the command, or a group of them, as a `typer.Typer` called `app`, or NAME in "module:NAME".
        summary: help text of the command.
    """

    module: str
    summary: str


class LazyGroup(TyperGroup):
    """A group that lists its commands by their summaries, and imports the one that is invoked."""

    modules: ClassVar[Mapping[str, Lazy]] = {}

    def load(self, name: str) -> Any:
        """The command or group `name`, imported."""
        module, _, app = self.modules[name].module.partition(":")
        command = typer.main.get_command(getattr(import_module(module), app or "app"))
        command.name, command.help = name, self.modules[name].summary  # type: ignore[attr-defined, unused-ignore]
        return command

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """As of any group, with the command imported."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, command if name is None else self.load(name), rest


def lazy_app(modules: Mapping[str, Lazy], **settings: Any) -> typer.Typer:
    """A group of the commands in `modules`; `settings` are typer.Typer's."""
    group = type("Group", (LazyGroup,), {"modules": modules})
    app = typer.Typer(cls=group, no_args_is_help=True, rich_markup_mode="rich", **{"add_completion": False, **settings})
    for name, lazy in modules.items():
        app.command(name, help=lazy.summary)(_placeholder)
    return app


def single_app(callback: Callable[..., None]) -> typer.Typer:
    """An `app` of one command, for `Lazy`."""
    app = typer.Typer(add_completion=False, rich_markup_mode="rich")
    app.command()(callback)
    return app


def _placeholder() -> None:
    """In place of a command that has not been imported."""
