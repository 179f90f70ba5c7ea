"""Checks of label files that apply to several formats: identities and the first frame number."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.box_table import BoxTable
from track_range.detection.formats.errors import LabelFileError
from track_range.foundation.files.input_files import shortened

_MOST_NAMED = 5
"""Largest number of labels that a note names."""


def check_identities(table: BoxTable, path: Path) -> None:
    """Check that no identity occurs twice in a frame.

    Raises:
        LabelFileError: one does.
    """
    is_same = (np.diff(table.frame) == 0) & (np.diff(table.track_id) == 0) & (table.track_id[1:] >= 0)
    for row in np.flatnonzero(is_same)[:1].tolist():
        raise LabelFileError(
            f"{path}: expected each track id at most once per frame, got id {table.track_id[row]} twice in frame "
            f"{table.frame[row]}."
        )


def first_frame_note(path: Path, first: int, n_frames: int) -> tuple[str, ...]:
    """A note if the frames that a file lists start at 1, since the first frame of a video is 0.

    Args:
        path: the file.
        first: smallest frame number.
        n_frames: how many frames it lists.
    """
    if first != 1 or n_frames < 2:
        return ()
    return (
        f"{path.name}: its frame numbers start at 1, but the first frame of the video is 0; if all boxes are late by "
        "one frame, convert it with `track-range export --first-frame 1`.",
    )


def other_labels_note(table: BoxTable, path: Path) -> tuple[str, ...]:
    """A note on boxes of labels that are not road classes, such as a renamed label, with the names."""
    is_other = (table.class_id < 0) & ~table.is_region & (table.class_name != "")
    if not is_other.any():
        return ()
    names, counts = np.unique(table.class_name[is_other], return_counts=True)
    most = [f"{shortened(str(name), 30)} ({n})" for name, n in zip(names[:_MOST_NAMED], counts, strict=False)]
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return (
        f"{path.name}: boxes of labels that are not road classes do not count: {', '.join(most)}{more}; the "
        f"classes are {', '.join(ROAD_CLASSES)}.",
    )


def ignored_note(path: Path, n_ignored: int, reason: str) -> tuple[str, ...]:
    """A note on the number of boxes that were ignored for a reason, such as "without width or height"."""
    boxes = "1 box" if n_ignored == 1 else f"{n_ignored} boxes"
    return (f"{path.name}: ignored {boxes} {reason}.",) if n_ignored else ()
