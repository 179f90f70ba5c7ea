"""The codes of notes in the program are those of the page for robots."""

import ast
import re
from typing import get_args

from tests.documentation.documented_commands import PAGES
from tests.repository.structure import rooms
from track_range.stereo.alignment.pair_finding import Fault

SEVERITIES = {"ok", "warning", "error"}


def codes_in_program():
    """(code, severity) of each `Note(...)` whose values are constants."""
    calls = [
        node
        for files in rooms().values()
        for file in files
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Note"
    ]
    values = [call.args[1:3] for call in calls]
    return {
        tuple(one.value for one in pair)
        for pair in values
        if len(pair) == 2 and all(isinstance(one, ast.Constant) for one in pair)
    }


def documented_codes():
    """(code, severity) of the table of codes."""
    section = PAGES["docs/how-to/robot.md"].partition("## Health")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `\w+` \| (\w+) \| (.+) \|$", section, re.MULTILINE)
    return {(code, severity) for severity, text in rows for code in re.findall(r"`([\w-]+)`", text)}


def test_codes_of_notes_are_documented():
    in_program, documented = codes_in_program(), documented_codes()
    assert len(in_program) > 25
    assert in_program - documented == set()
    of_faults = {f"pair-{fault}" for fault in get_args(Fault) if fault != "fits"}
    others = {code for code, _ in documented} - {code for code, _ in in_program}
    assert others == of_faults
    assert {severity for _, severity in documented} == SEVERITIES
