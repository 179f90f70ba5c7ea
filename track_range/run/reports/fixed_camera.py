"""A camera that stands still: the plane of its road, what it counted, and whether one was not named."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.detection.classes import STATIC_CLASSES
from track_range.foundation.files.input_files import counted
from track_range.ranging.world.road_plane import RoadPlane
from track_range.results.counts.counter import KMH
from track_range.results.counts.files import counts_section
from track_range.results.rows.rows import Rows, most_frequent
from track_range.results.table import RunRows
from track_range.run.reports.report import Reports

# a camera that stands: its speed in nearly all frames in which it is known, which are most, and the
# shortest recording that shows it
_STANDS_MPS, _STANDS_FRACTION, _KNOWN_FRACTION, _STANDS_S = 0.15, 0.97, 0.8, 5.0


@dataclass(slots=True)
class FixedCamera(Reports):
    """The plane and the counts of a camera that stands still."""

    rows: RunRows
    plane: RoadPlane | None
    is_static: bool  # whether the run was told so
    recorded: Rows | None = None  # rows of the finished run

    def notes(self) -> Sequence[str]:
        """Notes on a plane that mirrors what was given, on crossings that are not sure, and on a
        camera that stands although the run was not told.
        """
        notes = []
        if not self.is_static and self._stands():
            notes.append(
                "The camera stands still in the whole recording: if it is a fixed camera, "
                "--static-camera measures speeds over ground and counts at lines (docs/how-to/fixed.md)."
            )
        if self.plane is not None and self.plane.is_mirrored:
            notes.append(
                "The points of --ground count y to the right; world_y_m counts it to the left."
            )
        for name, n in self.rows.counter.n_unsure.items():
            if n:
                notes.append(
                    f"Line or zone {name}: {counted(n, 'track')} began or ended on it, which may be "
                    "missed or counted twice."
                )
        return notes

    def summary(self) -> Mapping[str, Any]:
        """Sections `fixed_camera` and `counts`, if there are any."""
        counter, plane = self.rows.counter, self.plane
        entries: dict[str, Any] = {}
        if self.is_static:
            known = None if plane is None else {"source": plane.source, **plane.summary()}
            users = [] if self.recorded is None else list(_road_users(self.recorded))
            entries["fixed_camera"] = {"ground": known, "road_users": users}
        if counter.places:
            entries["counts"] = counts_section(counter.places, counter.crossings, counter.n_unsure)
        return entries

    def _stands(self) -> bool:
        speeds = np.abs(np.array(self.rows.ego_mps, np.float64))
        known = speeds[np.isfinite(speeds)]  # of the first frames, none is
        is_long = self.rows.seconds >= _STANDS_S and len(known) > _KNOWN_FRACTION * len(speeds)
        return bool(is_long and (known < _STANDS_MPS).mean() >= _STANDS_FRACTION)


def _road_users(rows: Rows) -> Iterator[dict[str, Any]]:
    """The road users of a run with their median speeds; None = unknown. The standard deviation is
    the median one of its frames, whose errors are alike.
    """
    observed = np.asarray(rows["observed"], np.bool_)
    for own in rows.by_track():
        name = most_frequent(rows["class"][own])
        if name in STATIC_CLASSES:
            continue
        speeds, sigmas = (KMH * rows[key][own] for key in ("speed_mps", "speed_sigma_mps"))
        is_known = np.isfinite(speeds) & observed[own]
        known = {"speed_kmh": speeds, "speed_sigma_kmh": sigmas}
        medians = {
            key: round(float(np.median(values[is_known])), 2) if is_known.any() else None
            for key, values in known.items()
        }
        yield {
            "track_id": int(rows["track_id"][own[0]]),
            "class": name,
            **medians,
            "from_s": round(float(rows["time_s"][own[0]]), 3),
            "to_s": round(float(rows["time_s"][own[-1]]), 3),
        }
