"""Patterns of the names of a clip's files."""

import re
import time

import pytest
from hypothesis import given, settings, strategies as st

from track_range.fleet.inputs.clip import FleetInputError
from track_range.fleet.inputs.pattern import FilePattern, Template

TEXTS = st.text(
    st.characters(exclude_characters="/_", exclude_categories=("Cs",)), min_size=1, max_size=20
)


@settings(max_examples=25, deadline=None)
@given(clip=TEXTS, vehicle=TEXTS)
def test_filled_name_gives_the_same_values(clip, vehicle):
    pattern = FilePattern.of("{vehicle}/{clip}_left.mp4,{vehicle}/{clip}_right.mp4")
    values = {"vehicle": vehicle, "clip": clip}
    for template in (pattern.left, pattern.right):
        assert template.expression().fullmatch(template.filled(values)).groupdict() == values


@settings(max_examples=50, deadline=None)
@given(text=st.text("{}clp,/._a!:0 \n", max_size=40))
def test_any_text_is_a_pattern_or_an_error(text):
    pattern, message = None, ""
    try:
        pattern = FilePattern.of(text)
    except FleetInputError as error:
        message = str(error)
    if pattern is None:
        assert "--pattern" in message
        assert len(message) < 300
    else:
        values = dict.fromkeys(pattern.left.names, "a")
        assert pattern.left.expression().fullmatch(pattern.left.filled(values)) is not None


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("left.mp4", "{clip}"),
        ("{clip}.mp4,{clip}.mp4", "different"),
        ("{clip}_l.mp4,{clip}_r.mp4,{clip}_f.mp4", "comma"),
        ("{clip}.mp4,", "comma"),
        ("{clip", "brace"),
        ("{clip}}.mp4", "brace"),
        ("{clip:>3}.mp4", "letters"),
        ("{clip!r}.mp4", "letters"),
        ("{0}{clip}.mp4", "letters"),
        ("{clip}{vehicle}.mp4", "separator"),
        ("/data/{clip}.mp4", "relative"),
        ("../{clip}.mp4", "relative"),
        ("s3://bucket/{clip}.mp4", "relative"),
        ("{rig}/{clip}.mp4", "{rig}"),
        ("{vehicle}/{clip}_l.mp4,{clip}_r.mp4", "same placeholders"),
        ("-".join(f"{{a{i}}}" for i in range(9)) + "-{clip}", "at most"),
    ],
)
def test_invalid_patterns(text, word):
    with pytest.raises(FleetInputError, match=re.escape(word)):
        FilePattern.of(text)


@pytest.mark.parametrize(
    ("pattern", "name", "values"),
    [
        ("{clip}.mp4", "day 1/a.b.mp4", {"clip": "day 1/a.b"}),
        ("{vehicle}_{clip}.mp4", "car_1_2.mp4", {"vehicle": "car", "clip": "1_2"}),
        ("{vehicle}/{clip}.mp4", "a/b/c.mp4", {"vehicle": "a", "clip": "b/c"}),
        ("{clip}/{clip}.mp4", "a/a.mp4", {"clip": "a"}),
        ("{clip}/{clip}.mp4", "a/b.mp4", None),
        ("{{{clip}}}.mp4", "{a}.mp4", {"clip": "a"}),
        ("./{clip}.mp4", "a.mp4", {"clip": "a"}),
        ("{clip}.mp4", ".mp4", None),
        ("{clip}.mp4", "a.mp4x", None),
        ("{clip}_(1)+.mp4", "a_(1)+.mp4", {"clip": "a"}),
    ],
)
def test_matches(pattern, name, values):
    match = FilePattern.of(pattern).left.expression().fullmatch(name)
    assert (None if match is None else match.groupdict()) == values


def test_long_names_are_compared_quickly():
    expression = FilePattern.of("{a}_{b}_{c}_{clip}_left.mp4").left.expression()
    start_s = time.process_time()
    assert expression.fullmatch("_".join("x" * 60) + "_right.mp4") is None
    assert time.process_time() - start_s < 5


def test_template_without_value():
    with pytest.raises(KeyError):
        Template.of("rigs/{vehicle}.yaml", "--rig").filled({"clip": "a"})
