"""Names of the clips of events, and of their folder."""

from __future__ import annotations

import re

from track_range.results.events.event import EVENT_KINDS

CLIPS_FOLDER = "clips"
"""Folder of the clips in that of a run."""

_CLIP_NAME = re.compile(rf"\d{{2,}}-(?:{'|'.join(EVENT_KINDS)})-\d+\.mp4", re.ASCII)


def clip_name(number: int, kind: str, track_id: int) -> str:
    """File name of a clip, such as "02-cut_in-17.mp4".

    Args:
        number: number of the event's row in events.csv, from 1.
        kind: kind of the event.
        track_id: identity of its object.
    """
    return f"{number:02}-{kind}-{track_id}.mp4"


def is_clip_name(name: str) -> bool:
    """Whether a file name is that of a clip."""
    return _CLIP_NAME.fullmatch(name) is not None
