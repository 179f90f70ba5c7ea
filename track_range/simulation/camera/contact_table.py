"""contacts.csv, the contacts of the ego vehicle with road users: one row per road user, earliest first.

    object_id,class,contact_s

`object_id` is the id of truth.csv; `contact_s` is the time since the first frame. `world/contacts.py` defines which
contacts count: those that happen, and those that would happen without the braking of the ego vehicle.
"""

from __future__ import annotations

from collections.abc import Iterable

from track_range.detection.classes import ROAD_CLASS_OF
from track_range.simulation.world.contacts import EgoContact

HEADER = "object_id,class,contact_s\n"


def contacts_text(contacts: Iterable[EgoContact]) -> str:
    """Content of contacts.csv, with its header also without contacts."""
    rows = (
        f"{contact.track_id},{ROAD_CLASS_OF[contact.kitti_type.lower()]},{contact.contact_s:.4f}\n"
        for contact in contacts
    )
    return HEADER + "".join(rows)
