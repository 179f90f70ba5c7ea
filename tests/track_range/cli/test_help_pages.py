"""Help pages at 80 columns: every option in full, with a text, and examples whose options exist."""

import re

import pytest
import typer

from track_range.cli.app import app


def commands(group, names=()):
    """Every command below a group, with the names that lead to it."""
    for name in group.list_commands(None):
        command = group.load(name)
        if hasattr(command, "load"):
            yield from commands(command, (*names, name))
        if not hasattr(command, "load") or command.invoke_without_command:
            yield (*names, name), command


COMMANDS = dict(commands(typer.main.get_command(app)))


def page(names):
    command = COMMANDS[names]
    with command.make_context(names[-1], [], resilient_parsing=True, terminal_width=80) as context:
        return command.get_help(context)


@pytest.mark.parametrize("names", COMMANDS, ids=" ".join)
def test_page_fits_80_columns(names):
    lines = page(names).splitlines()
    assert max(map(len, lines)) <= 80
    assert not any("…" in line for line in lines)


@pytest.mark.parametrize("names", COMMANDS, ids=" ".join)
def test_every_option_is_listed_in_full(names):
    text = page(names)
    shown = [parameter for parameter in COMMANDS[names].params if not parameter.hidden]
    for option in (
        option for parameter in shown for option in parameter.opts if option.startswith("--")
    ):
        assert re.search(rf"^ +{option}\b", text, re.MULTILINE), option
    assert all(
        parameter.help and parameter.help[0].isupper() and parameter.help[-1] == "."
        for parameter in shown
    )


@pytest.mark.parametrize("names", COMMANDS, ids=" ".join)
def test_examples_use_existing_options(names):
    command = COMMANDS[names]
    known = {option for parameter in command.params for option in parameter.opts}
    assert command.examples
    for example in command.examples:
        assert set(re.findall(r"--[a-z][a-z-]*", example)) <= known
        assert example.startswith("track-range")
