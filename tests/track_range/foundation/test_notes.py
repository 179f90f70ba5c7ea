"""Notes: sentences with a code."""

import copy
import json
import pickle

from track_range.foundation.errors import Note
from track_range.pipeline.health import Health, health_of

NOTE = Note("The {} camera moved.", "camera-moved", "warning", "right")


def test_a_note_is_its_sentence_and_keeps_its_code():
    moved = NOTE.format("right")
    assert moved == "The right camera moved."
    for same in (moved, pickle.loads(pickle.dumps(moved)), copy.deepcopy(moved)):  # noqa: S301 - our own
        assert isinstance(same, Note)
        values = str(same), same.code, same.severity, same.sensor
        assert values == ("The right camera moved.", "camera-moved", "warning", "right")
    assert json.dumps([moved]) == '["The right camera moved."]'
    assert moved.said("It moved.").code == "camera-moved"
    assert type(f"{moved}") is str


def test_health_keeps_since_when_until_a_note_ends():
    first = health_of([NOTE.format("left")], Health(), 2.0)
    later = health_of([NOTE.format("right"), "A sentence."], first, 5.0)
    assert [item.since_s for item in later.items] == [2.0, 5.0]
    assert [(item.code, item.severity) for item in later.items] == [
        ("camera-moved", "warning"),
        ("note", "ok"),
    ]
    assert health_of([], later, 6.0).severity == "ok"
    again = health_of([NOTE], health_of([], later, 6.0), 9.0)
    assert again.items[0].since_s == 9.0
    assert health_of([NOTE]).to_list()[0]["since_s"] is None
