"""README's commands are those of the program: each command and each option in it exists."""

import re

import pytest
import typer

from tests.readme_lines import (
    PROJECT,
    README,
    block_commands,
    blocks,
    command_of,
    commands,
    inline_code,
    is_command,
    subcommand,
)
from track_range.cli.app import app

OPTION = re.compile(r"--[a-z][a-z0-9-]*")


def options_of(command):
    return {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}


def all_options(command):
    """Options of a command and of all below it."""
    below = (subcommand(command, name) for name in getattr(command, "commands", {}))
    return options_of(command).union(*(all_options(each) for each in below))


@pytest.mark.parametrize("line", [line for line in commands() if line.startswith("track-range")])
def test_commands_and_options_exist(line):
    _, command, rest = command_of(line)
    assert {word for word in rest if OPTION.fullmatch(word)} <= options_of(command) | {"--help"}


def test_options_in_the_text_and_in_comments_exist():
    comments = [line.partition("#")[2] for block in blocks() for line in block]
    named = {option for code in (*inline_code(), *comments) for option in OPTION.findall(code)}
    assert len(named) > 15
    assert named <= all_options(typer.main.get_command(app)) | {"--help"}


def test_commands_are_told_from_tables():
    assert len(commands()) > 30
    assert all(is_command(line) for line in block_commands())
    assert "```" not in README  # commands stand in indented blocks, where they are looked for


def test_files_and_pictures_that_are_linked_are_there():
    linked = re.findall(r"\]\(([^)#]+)\)", README)
    assert len(linked) >= 4
    assert [link for link in linked if not link.startswith("http") and not (PROJECT / link).exists()] == []
