"""YAML and JSON: plain values, limits, and errors in one sentence with file and line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings, strategies as st

from tests.support.error_messages import error_message
from track_range.foundation.errors import UserError
from track_range.foundation.files.structured_text import (
    MAX_CONTAINERS,
    MAX_DEPTH,
    MAX_YAML_VALUES,
    parse_json,
    parse_yaml,
    read_json,
    read_yaml,
    yaml_text,
)


def yaml_value(text: str) -> Any:
    return parse_yaml(text, "a.yaml", UserError, "a rig")


def json_value(text: str) -> Any:
    return parse_json(text, "a.json", UserError, "a rig")


def refused(parse: Any, text: str) -> str:
    """The message of the error: one short sentence that begins with the file."""
    message = error_message(UserError, parse, text)
    assert message.startswith(("a.yaml", "a.json"))
    return message


BOMB = "a: &a [x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefghij", "bcdefghijk", strict=True)
)
"""Nested aliases: 2^10 values."""


@pytest.mark.parametrize(
    ("text", "key_word"),
    [
        (BOMB, "alias"),
        ("a: &x [1]\nb: &y [*x]", "line 2"),
        ("b: *x", "alias"),
        ("a: &x [*x]", "alias"),
        ("a: &x [" + "1, " * 5000 + "1]\nb: [" + "*x, " * 5 + "*x]", "values"),
        ("[" * 3000, f"more than {MAX_DEPTH} nested"),
        ("- " * 3000, "nested"),
        ("{a: " * 3000, "nested"),
        ("a: !!int abc", "'abc'"),
        ("a: !!int ''", "integer"),
        ("a: !!bool maybe", "'maybe'"),
        ("a: !!float x", "number"),
        ("a: !!timestamp 2001-99-99", "tag"),
        ("a: !!binary x", "tag"),
        ("!!python/object/apply:os.system [ls]", "tag"),
        ("a: !rig x", "'!rig'"),
        ("a: " + "9" * 5000, "64 bits"),
        ("a: 0x" + "f" * 5000, "64 bits"),
        ("a: 1" + ":1" * 5000, "64 bits"),
        ("a: 9223372036854775808", "64 bits"),
        ("b: 1\na: 1\nb: 2", "'b' is given twice"),
        ("{" + "a,b," * 1000 + "}", "twice"),
        ("- 1\n" * (MAX_YAML_VALUES + 1), "values"),
        ("? [1]\n: 2", "key"),
        ("a: [1", "line"),
        ("a: '", "line"),
        ("\tb: 1", "line 1"),
        ("--- a\n--- b", "line 2"),
        ("\0", "does not allow"),
        ("\ud800", "not YAML"),
        ("%YAML 9.9\n---\na", "line 1"),
        ("!!seq x", "line 1"),
    ],
)
def test_yaml_errors(text: str, key_word: str) -> None:
    assert key_word in refused(yaml_value, text)


@pytest.mark.parametrize(
    ("text", "key_word"),
    [
        ("[" * 3000, "nested"),
        ("[" * 100_000, "nested"),
        ("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "nested"),
        ('{"a": ' * 3000, "nested"),
        ("9" * 5000, "64 bits"),
        ("[-9223372036854775809]", "64 bits"),
        ("[1,\nNaN]", "NaN"),
        ("[Infinity]", "Infinity"),
        ("[1e400]", "1e400"),
        ('{"a": 1, "a": 2}', "'a'"),
        ('"\\ud800"', "Unicode"),
        ('{\n"a" 1}', "line 2"),
        ("", "line 1"),
        ("\ud800", "line 1"),
    ],
)
def test_json_errors(text: str, key_word: str) -> None:
    assert key_word in refused(json_value, text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("", None),
        ("a: 2001-99-99", {"a": "2001-99-99"}),
        ("a: 2001-01-01", {"a": "2001-01-01"}),
        ("a: [1, 2.5, -1.0e-5, yes, null, ~, 'x']", {"a": [1, 2.5, -1e-5, True, None, None, "x"]}),
        ("<<: {a: 1}", {"<<": {"a": 1}}),
        ("a: .inf", {"a": float("inf")}),
        ("[" * MAX_DEPTH + "]" * MAX_DEPTH, json.loads("[" * MAX_DEPTH + "]" * MAX_DEPTH)),
        ("é: 😀", {"é": "😀"}),
    ],
)
def test_yaml_values(text: str, value: object) -> None:
    assert yaml_value(text) == value


def test_many_empty_objects() -> None:
    assert json_value("[{}, {}, {}]") == [{}, {}, {}]
    assert str(MAX_CONTAINERS) in refused(json_value, "[" + "{}," * MAX_CONTAINERS + "{}]")


def test_json_values() -> None:
    assert json_value('{"a": [1, -2.5e3, true, null, "\\u00e9"]}') == {
        "a": [1, -2500.0, True, None, "é"]
    }
    assert json_value("[" * MAX_DEPTH + "]" * MAX_DEPTH) == json.loads(
        "[" * MAX_DEPTH + "]" * MAX_DEPTH
    )


def test_files(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_bytes(b"\xef\xbb\xbfa: 1\r\n")
    assert read_yaml(tmp_path / "a.yaml", UserError, "a rig") == {"a": 1}
    with pytest.raises(UserError, match=r"a\.yaml.*JSON"):
        read_json(tmp_path / "a.yaml", UserError, "a rig")
    with pytest.raises(UserError, match=r"a\.yaml.*3 bytes"):
        read_yaml(tmp_path / "a.yaml", UserError, "a rig", max_bytes=3)


def test_written_yaml_has_no_aliases() -> None:
    numbers = [1.0, 2.0]
    text = yaml_text({"b": numbers, "a": numbers}, default_flow_style=None)
    assert text == "b: [1.0, 2.0]\na: [1.0, 2.0]\n"
    assert yaml_value(text) == {"a": numbers, "b": numbers}


_PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text("abcxyz<=", max_size=3), inner, max_size=4)
    ),
    max_leaves=6,
)


@settings(max_examples=20, deadline=None)
@given(value=st.dictionaries(st.text("abc", min_size=1), _PLAIN, max_size=3))
def test_plain_values_survive(value: dict[str, Any]) -> None:
    assert json_value(json.dumps(value)) == value
    assert yaml_value(yaml_text(value)) == value
    assert yaml_value(yaml.safe_dump(value)) == value or "&" in yaml.safe_dump(value)


@settings(max_examples=50, deadline=None)
@given(text=st.text("[]{}:,-?!&*|>'\"#%@` \n\tab01.é😀\0\x85\ud800", max_size=40))
def test_any_text(text: str) -> None:
    for parse in (yaml_value, json_value):
        message = ""
        try:
            parse(text)
        except UserError as error:
            message = str(error)
        assert len(message) < 300
        assert message.isprintable()


@pytest.mark.parametrize(
    ("text", "word"), [("a: &x 1\nb: &x 2\n", "duplicate anchor"), ("--- 1\n--- 2\n", "document")]
)
def test_errors_with_a_context(text, word):
    with pytest.raises(UserError, match=word):
        parse_yaml(text, "a.yaml", UserError, "settings")


def test_an_alias_of_plain_values() -> None:
    """As PyYAML writes a matrix that a calibration has twice."""
    assert parse_yaml("a: &x [1, 2]\nb: *x", "a.yaml", UserError, "a rig") == {
        "a": [1, 2],
        "b": [1, 2],
    }
