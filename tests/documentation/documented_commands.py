"""What the README and the pages of docs/ show as commands and as Python code."""

import re
import shlex
from pathlib import Path

import typer

from track_range.cli.app import app

PROJECT = Path(__file__).resolve().parents[2]
PAGES = {
    path.relative_to(PROJECT).as_posix(): path.read_text(encoding="utf-8")
    for path in (
        PROJECT / "README.md",
        PROJECT / "CONTRIBUTING.md",
        *sorted((PROJECT / "docs").rglob("*.md")),
    )
}
"""Text of each page, by its path."""

README = PAGES["README.md"]

PROGRAMS = (
    "track-range",
    "make",
    "pip",
    "python",
    "python3",
    "git",
    "cd",
    "export",
    "source",
    "curl",
)
"""First words of commands; a block of which the first line has one is a block of commands."""

_FENCED = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(text):
    """Indented and unlabelled fenced blocks of a page, each a list of its lines without the
    indentation."""
    fenced = [code.splitlines() for language, code in _FENCED.findall(text) if not language]
    indented = re.findall(r"^(?: {4}.*\n)+", _FENCED.sub("", text), re.MULTILINE)
    return [*fenced, *([line[4:] for line in block.splitlines()] for block in indented)]


def python_blocks(text):
    """Blocks of Python code of a page."""
    return [code for language, code in _FENCED.findall(text) if language == "python"]


def inline_code(text):
    """Code in running text, on one line each."""
    text = re.sub(r"^ {4}.*\n", "", _FENCED.sub("", text), flags=re.MULTILINE)
    return [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", text)]


def commands(text):
    """Commands of a page, each once, without their comments."""
    in_blocks = [
        without_comment(line) for block in blocks(text) if is_command(block[0]) for line in block
    ]
    return list(dict.fromkeys([*in_blocks, *filter(is_command, inline_code(text))]))


def track_range_commands():
    """(page, command) of every `track-range` command with at least one argument."""
    return [
        (page, line)
        for page, text in PAGES.items()
        for line in commands(text)
        if line.startswith("track-range ") and "..." not in line
    ]


def is_command(line):
    """Whether a line begins with a program and has more words than that."""
    return line.startswith(tuple(f"{program} " for program in PROGRAMS))


def without_comment(line):
    return re.sub(r"\s+#.*$", "", line).strip()


def subcommand(group, name):
    """A command of a group, imported where the group imports it when it is invoked."""
    return group.load(name) if hasattr(group, "load") else group.commands[name]


def command_of(line):
    """Name of the command that a line of `track-range` gives, its typer command, and its other
    words."""
    command, rest, name = typer.main.get_command(app), shlex.split(line)[1:], []
    while hasattr(command, "commands") and rest and rest[0] in command.commands:
        name.append(rest.pop(0))
        command = subcommand(command, name[-1])
    # the command `run` needs no name
    if not name and rest[0].startswith("-") and rest != ["--version"]:
        name, command = ["run"], subcommand(command, "run")
    return " ".join(name), command, rest


OPTION = re.compile(r"--[a-z][a-z0-9-]*")


def options_of(command):
    return {
        option
        for parameter in command.params
        for option in (*parameter.opts, *parameter.secondary_opts)
    }
