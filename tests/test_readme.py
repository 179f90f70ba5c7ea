"""README's commands are those of the program: each command and each option in it exists."""

import re
import shlex
from pathlib import Path

import pytest
import typer

from track_range.cli import app

README = (Path(__file__).resolve().parents[1] / "README.md").read_text(encoding="utf-8")


def commands():
    """Every command line in README, in blocks and in running text, without its comment."""
    blocks = re.findall(r"^    (track-range .*)$", README, re.MULTILINE)
    inline = re.findall(r"`(track-range [^`]+)`", README)
    return [line.split("#")[0].strip() for line in (*blocks, *inline)]


def command_of(words):
    """The command that the words name, and what is left of them; the main job needs no name."""
    command = typer.main.get_command(app)
    rest = list(words)
    while hasattr(command, "commands") and rest and rest[0] in command.commands:
        command = command.commands[rest.pop(0)]
    if hasattr(command, "commands"):
        assert rest[0].startswith("-"), f"{words}: no such command"
        command = command.commands["run"]
    return command, rest


@pytest.mark.parametrize("line", sorted(set(commands())))
def test_commands_and_options_exist(line):
    command, rest = command_of(shlex.split(line.replace("\n", " "))[1:])
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
    named = {word for word in rest if re.fullmatch(r"--[a-z][a-z0-9-]*", word)}
    assert named <= known | {"--help"}


def test_there_are_commands_to_check():
    assert len(commands()) > 25
