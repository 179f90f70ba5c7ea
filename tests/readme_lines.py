"""What README shows as commands: lines of its indented blocks, and code in its running text."""

import re
import shlex
from pathlib import Path

import typer

from track_range.cli.app import app

PROJECT = Path(__file__).resolve().parents[1]
README = (PROJECT / "README.md").read_text(encoding="utf-8")

PROGRAMS = ("track-range", "make", "pip", "python", "python3", "git", "cd", "export", "source", "curl")
"""What a line of the shell may begin with; a block whose first line does is one of commands."""

INPUT_OPTIONS = ("--stereo", "--mono", "--settings")
"""Where the text leaves `track-range` out, a command begins with one of these, and what follows it."""


def blocks():
    """Indented blocks of README, each a list of its lines without the indentation."""
    found = re.findall(r"^(?: {4}.*\n)+", README, re.MULTILINE)
    return [[line[4:] for line in block.splitlines()] for block in found]


def inline_code():
    """Code in running text, on one line each."""
    text = re.sub(r"^ {4}.*\n", "", README, flags=re.MULTILINE)
    return [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", text)]


def block_commands():
    """Lines of the blocks of commands, as they stand but for comments."""
    return [without_comment(line) for block in blocks() if is_command(block[0]) for line in block]


def inline_commands():
    """Commands in running text, with `track-range` where they leave it out."""
    whole = [code for code in inline_code() if is_command(code)]
    short = [code for code in inline_code() if code.startswith(INPUT_OPTIONS) and " " in code]
    return [*whole, *(f"track-range {code}" for code in short)]


def commands():
    """All of them, each once, in README's order."""
    return list(dict.fromkeys([*block_commands(), *inline_commands()]))


def is_command(line):
    """Whether a line begins with a program and has more words than that."""
    return line.startswith(tuple(f"{program} " for program in PROGRAMS))


def without_comment(line):
    return re.sub(r"\s+#.*$", "", line).strip()


def subcommand(group, name):
    """A command of a group, imported where the group imports it when it is invoked."""
    return group.load(name) if hasattr(group, "load") else group.commands[name]


def command_of(line):
    """Name of the command that a line of `track-range` gives, its typer command, and its other words."""
    command, rest, name = typer.main.get_command(app), shlex.split(line)[1:], []
    while hasattr(command, "commands") and rest and rest[0] in command.commands:
        name.append(rest.pop(0))
        command = subcommand(command, name[-1])
    if not name and rest[0].startswith("-"):  # the main job needs no name
        name, command = ["run"], subcommand(command, "run")
    assert not hasattr(command, "commands"), f"{line}: no such command"
    return " ".join(name), command, rest
