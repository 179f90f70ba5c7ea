"""open_speed: the ego speed of a run, from its setting and from the telemetry of its recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.ego_speed import EgoSpeed, EgoSpeedError, open_ego_speed
from track_range.video.files.video_part import VideoPart
from track_range.video.live.reader import LiveReader
from track_range.video.recording import Recording

AUTO, OFF = "auto", "off"
"""Values of --ego-speed that are neither a number nor a path."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedSource:
    """Ego speed of a run and its origin.

    Attributes:
        ego: the speed; None = unknown.
        notes: messages for the user.
        files: the files that were read.
    """

    ego: EgoSpeed | None = None
    notes: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()

    def summary(self, ego_mps: FloatArray) -> dict[str, Any] | None:
        """Section `ego_speed` of summary.json; None = the speed is unknown.

        Args:
            ego_mps: (N,) speed at the N frames of the run, NaN = unknown.
        """
        if self.ego is None:
            return None
        known = ego_mps[np.isfinite(ego_mps)]
        return {
            "source": self.ego.source,
            "offset_s": None,
            "offset_sigma_s": None,
            "median_mps": round(float(np.median(known)), 3) if len(known) else None,
            "coverage": round(len(known) / len(ego_mps), 4) if len(ego_mps) else None,
        }


def open_speed(setting: str, recording: Recording) -> SpeedSource:
    """Ego speed of a run.

    Args:
        setting: "auto", "off", a number in km/h, or the path of a file or folder.
        recording: the opened recording.

    Raises:
        EgoSpeedError: the number or the named file cannot be used.
    """
    if setting == OFF:
        return SpeedSource()
    if setting != AUTO:
        return SpeedSource(ego=open_ego_speed(setting))
    reader = recording.inputs.left
    if isinstance(reader, LiveReader) or not reader.parts:
        return SpeedSource()
    return _table_beside(reader.parts[0])


def _table_beside(part: VideoPart) -> SpeedSource:
    """Ego speed from ego_speed.csv or an oxts folder beside the first file of a recording."""
    notes: list[str] = []
    for path in (part.path.parent / "ego_speed.csv", part.path.parent / "oxts"):
        if path.exists():
            try:
                ego = open_ego_speed(str(path))
            except EgoSpeedError as error:
                notes.append(f"Ego speed: not used: {error}")
                continue
            note = f"Ego speed: from {path.name} beside the video; --ego-speed off ignores it."
            return SpeedSource(ego=ego, notes=(*notes, note), files=(path,))
    return SpeedSource(notes=tuple(notes))
