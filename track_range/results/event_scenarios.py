"""NN-KIND-TRACK.xosc: a scenario of each event, from 3 s before it to 2 s after it.

Its parameters are what was measured in the most critical frame. A simulation that gives others

- moves the object of the event along (`gap_m`) and to the left of (`lateral_offset_m`) the ego
  vehicle's heading in that frame,
- stretches the times of the ego vehicle (`ego_mps`) and of the object (`object_mps`) around that
  frame, so that gap and offset remain those of the parameters.

`ttc_s`, `probability`, `peak_s`, `kind`, `track`, and `start_gap_m`, the gap when the event started, tell
what was measured, and change nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from track_range.results.events.event import Event, clip_interval_s, clip_name
from track_range.results.formats.adas.opendrive_file import ROAD_FILE, write_road
from track_range.results.formats.adas.openscenario_file import (
    EGO,
    Variation,
    object_name,
    write_scenario,
)
from track_range.results.formats.adas.trajectories import Trajectories

_MIN_MPS = 0.5  # smallest speed that is a parameter: times are stretched in proportion to it


def write_event_scenarios(drive: Trajectories, events: Sequence[Event], folder: Path) -> list[str]:
    """Write a scenario of each event that the drive shows, and the road of the drive; the names of
    the scenarios' files.
    """
    names = []
    road = ROAD_FILE if write_road(folder / ROAD_FILE, drive) else ""
    for number, event in enumerate(events, 1):
        scene = drive.between(*clip_interval_s(event))
        variation = _variation(scene, event)
        if variation is None:
            continue
        name = Path(clip_name(number, event.kind, event.track_id)).with_suffix(".xosc").name
        description = f"{event.reason} Measured by track-range"
        write_scenario(folder / name, scene, variation, description, road)
        names.append(name)
    return names


def _variation(scene: Trajectories, event: Event) -> Variation | None:
    """The parameters of an event; None = its object or the ego vehicle has no position."""
    track = scene.rows[scene.rows[:, 6] == event.track_id]
    if not len(track):
        return None
    start_s = float(scene.ego[0, 0])
    peak = track[np.argmin(np.abs(track[:, 0] - event.peak_s))]
    first = track[np.argmin(np.abs(track[:, 0] - event.start_s))]
    gap_m, offset_m, object_mps, ego_mps = peak[8:12].tolist()
    heading_rad = float(scene.ego[np.argmin(np.abs(scene.ego[:, 0] - peak[0])), 3])
    name, peak_s = object_name(track[:, 7], event.track_id), float(peak[0]) - start_s
    measured = {
        "gap_m": gap_m,
        "lateral_offset_m": -offset_m,  # to the left
        "ego_mps": ego_mps,
        "object_mps": object_mps,
        "ttc_s": event.peak_ttc_s,
        "probability": event.peak_probability,
        "peak_s": peak_s,
        "start_gap_m": float(first[8]),
    }
    known = {key: round(value, 3) for key, value in measured.items() if math.isfinite(value)}
    moves = [
        (key, known[key], *direction)
        for key, direction in (
            ("gap_m", (math.cos(heading_rad), math.sin(heading_rad))),
            ("lateral_offset_m", (-math.sin(heading_rad), math.cos(heading_rad))),
        )
        if key in known
    ]
    x, y = (
        " + ".join(f"{move[axis]:.4f} * (${move[0]} - {move[1]:.3f})" for move in moves)
        for axis in (2, 3)
    )
    timings = {}
    for who, key in ((EGO, "ego_mps"), (name, "object_mps")):
        if known.get(key, 0.0) >= _MIN_MPS:
            scale = f"{known[key]:.3f} / ${key}"
            timings[who] = (f"${{{scale}}}", f"${{{peak_s:.3f} * (1 - {scale})}}")
    return Variation(
        parameters={"kind": event.kind, "track": name, **known},
        shifts={name: (x, y)} if moves else {},
        timings=timings,
    )
