"""Conditions on events: what they mean, and what is refused."""

import pyarrow as pa
import pytest

from track_range.fleet.report.event_query import EventQueryError, event_condition

TABLE = pa.table(
    {
        "kind": ["cut_in", "near_miss", "cut_in", "close_following"],
        "class": ["car", "person", "truck", "car"],
        "min_ttc_s": [1.5, 0.5, None, 4.0],
        "ego_mps": [10.0, -2.0, 20.0, 30.0],
        "frame": [1, 2, 3, 4],
    }
)
IS_TEXT = {field.name: pa.types.is_string(field.type) for field in TABLE.schema}


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ('kind == "cut_in"', [1, 3]),
        ("kind == 'cut-in' and min_ttc_s < 2", [1]),
        ('kind == "Near miss" or class == "truck"', [2, 3]),
        ('not kind == "cut-in"', [2, 4]),
        ('kind in ("cut-in", "near-miss") and class != "person"', [1, 3]),
        ("class not in ['car', 'truck']", [2]),
        ("1 < min_ttc_s <= 4", [1, 4]),
        ("2 > min_ttc_s", [1, 2]),
        ("not min_ttc_s > 1", [2]),  # unknown values meet no comparison
        ("min_ttc_s is None", [3]),
        ("min_ttc_s is not None and ego_mps < -1", [2]),
        ("min_ttc_front_s == 4.0", [4]),
        ("ego_mps > frame and (frame == 1 or frame == 4)", [1, 4]),
        ('class == "class"', []),
        ("min_ttc_s not in (1.5, 7)", [2, 4]),
        ("not min_ttc_s in (1.5,)", [2, 4]),
    ],
)
def test_meaning(text, frames):
    assert TABLE.filter(event_condition(text, IS_TEXT))["frame"].to_pylist() == frames


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("knd == 'cut-in'", "did you mean kind"),
        ("kind == 'cutin'", "expected one of forward_collision"),
        ("min_ttc_s < '2'", "a number"),
        ("class == 2", "a text"),
        ("frame == True", "a number"),
        ("kind = 'cut-in'", "such as 'kind =="),
        ("min_ttc_s", "expected a condition"),
        ("min_ttc_s < ", "expected a condition"),
        ("2 < 3", "expected a condition"),
        ("min_ttc_s.real < 2", "expected a condition"),
        ("__import__('os').getcwd() == 'x'", "expected a condition"),
        ("kind in 'cut_in'", "expected a condition"),
        ("kind == min_ttc_s", "two texts or two numbers"),
        (f"frame == {10**30}", "a number"),
        ("frame < 2 if frame else kind", "expected a condition"),
        ("(" * 600 + "frame < 2" + ")" * 600, "expected a condition"),
    ],
)
def test_refused(text, words):
    with pytest.raises(EventQueryError, match=words):
        event_condition(text, IS_TEXT)
