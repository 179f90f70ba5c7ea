"""contacts.csv: contacts of the ego vehicle with objects, the ground truth of collision warnings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES
from track_range.foundation.files.csv_tables import read_csv_table
from track_range.foundation.files.input_files import quoted
from track_range.results.events.files import EventFileError

COLUMNS = ("object_id", "class", "contact_s")

_LIMITS = {"object_id": (0.0, 2.0**53, "an integer from 0"), "contact_s": (0.0, 1e9, "a time in seconds from 0")}
"""Smallest and largest value of each column of numbers, and the expected value for messages."""


@dataclass(frozen=True, slots=True)
class Contact:
    """A contact that happens, or would happen without braking, with an object of a road class."""

    object_id: int
    class_name: str
    contact_s: float  # from the first frame


def read_contacts(path: Path) -> tuple[Contact, ...]:
    """Contacts of a file, in its order; EventFileError if it cannot be read or lacks a valid value."""
    table = read_csv_table(path, EventFileError, f"contacts with the columns {','.join(COLUMNS)}", exact=True)
    table.require(COLUMNS)
    numbers = {}
    for name, (low, high, expected) in _LIMITS.items():
        values = table.numbers(name)
        is_valid = (values >= low) & (values <= high)
        if name == "object_id":
            is_valid &= values.round() == values
        table.check(name, values, is_valid, expected)
        numbers[name] = values.tolist()
    names = [name.lower() for name in table.texts("class")]
    for row, name in enumerate(names):
        if name not in ROAD_CLASS_OF:
            raise table.fault(row, f"expected one of the classes {', '.join(ROAD_CLASSES)}, got {quoted(name)}.")
    rows = zip(numbers["object_id"], names, numbers["contact_s"], strict=True)
    return tuple(Contact(int(object_id), ROAD_CLASS_OF[name], contact_s) for object_id, name, contact_s in rows)
