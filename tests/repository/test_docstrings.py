"""The sections of docstrings have the layout of Google's style, which editors and the pages of the API read."""

import ast
import pydoc
import re
from collections.abc import Iterator

import pytest

import track_range as tr
from tests.repository.structure import PROJECT, rooms

_SECTION = re.compile(r"( *)(Args|Attributes|Raises|Returns|Yields):")
_ITEM = re.compile(r"\*{0,2}(\w+): \S.*")
_ERRORS = re.compile(r"\w+(?:, \w+)*: \S.*")  # errors with one reason stand together
_INDENT = 4
Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def faults_of(source: str) -> Iterator[str]:
    """The lines of a module's docstrings that are neither the start of an item nor its continuation."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, Documented) and (text := ast.get_docstring(node)):
            yield from _faults_in(text.splitlines(), _names_in(node))


def _names_in(node: Documented) -> set[str]:
    """What the docstring of a function or class may describe: arguments, and attributes of a class."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        given = node.args
        arguments = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
        return {argument.arg for argument in arguments if argument is not None}
    names = {target.id for target in ast.walk(node) if isinstance(target, ast.Name)}
    names |= {
        attribute.attr for attribute in ast.walk(node) if isinstance(attribute, ast.Attribute)
    }
    for part in node.body:
        if isinstance(part, ast.FunctionDef):
            names |= {part.name} | _names_in(part)
    return names


def _faults_in(lines: list[str], names: set[str]) -> Iterator[str]:
    for number, line in enumerate(lines):
        section = _SECTION.fullmatch(line)
        if section is None:
            continue
        at = len(section[1]) + _INDENT
        has_item = False
        for part in lines[number + 1 :]:
            text = part.strip()
            indent = len(part) - len(part.lstrip())
            if not text or indent < at:
                break
            if indent == at:
                is_one = section[2] in ("Returns", "Yields") and not has_item
                if not (is_one or _is_item(section[2], text, names)):
                    yield text
                has_item = True
            elif indent < at + _INDENT or not has_item:
                yield text
        if not has_item:
            yield line.strip()


def _is_item(section: str, text: str, names: set[str]) -> bool:
    if section == "Raises":
        return _ERRORS.fullmatch(text) is not None
    item = _ITEM.fullmatch(text)
    return item is not None and item[1] in names


@pytest.mark.parametrize("room", rooms())
def test_sections_have_the_layout_of_google_style(room):
    faults = [
        f"{path.relative_to(PROJECT)}: {line}"
        for path in rooms()[room]
        for line in faults_of(path.read_text(encoding="utf-8"))
    ]
    assert not faults


RIGHT = '''
def opened(left, *, rig=None, **options):
    """A recording.

    Args:
        left: a file,
            or several.
        rig: a calibration; None = a file next to `left`,
            if any.
        **options: of the run.

    Raises:
        RigError, VideoError: a file cannot be
            used.
    """
'''


def test_a_right_layout():
    assert list(faults_of(RIGHT)) == []


@pytest.mark.parametrize(
    ("before", "after", "fault"),
    [
        ("            or several.", "        or several.", "or several."),
        ("            if any.", "        None: if any.", "None: if any."),
        ("            used.", "        used.", "used."),
        ("            used.", "          used.", "used."),
        ("        **options: of the run.", "        other: of the run.", "other: of the run."),
        ("        left: a file,", "            left: a file,", "left: a file,"),
    ],
)
def test_wrong_layouts(before, after, fault):
    assert fault in list(faults_of(RIGHT.replace(before, after)))


def test_help_of_a_run_begins_with_how_to_create_one():
    text = pydoc.plain(pydoc.render_doc(tr.Run))
    assert text.index("Run.stereo") < text.index("settings:")
    assert "opened_detectors" not in text[: text.index("Methods defined here")]
