"""run.mf4: ASAM MDF 4.11 with the ego vehicle, the lead vehicle, and the tracks in object slots.

A group of channels for the ego vehicle, one for the lead vehicle, and one for each slot from its
first track on, with a sample per frame. A track keeps its slot while it lives, and the slot is then
empty for a frame. What is not known has the channel's invalidation bit. Numbers are 32-bit floats.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.atomic_files import atomic_path
from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.run_info import RunInfo
from track_range.results.formats.scene import check_extra
from track_range.results.rows.column import ColumnKind, ResultColumn
from track_range.results.rows.columns import declared_columns
from track_range.stereo.geometry.mounting import Mounting

MDF_FILE = "run.mf4"
_VERSION = "4.11"
_TRANSPOSED_DEFLATE: Final = 2  # compression of the data blocks
_N_BUFFERED = 512  # frames in memory; the records before are in a temporary file
_TYPES: Mapping[ColumnKind, str] = {"number": "<f4", "whole": "<u4", "flag": "u1", "name": "u1"}

_OF_OBJECTS: Mapping[str, str] = {  # channel of a slot, column of the rows
    "id": "track_id",
    "class": "class",
    "score": "score",
    "observed": "observed",
    "distance": "fused_m",
    "distance_sigma": "fused_sigma_m",
    "distance_filtered": "fused_kf_m",
    "distance_filtered_sigma": "fused_kf_sigma_m",
    "x": "x_m",
    "x_sigma": "x_sigma_m",
    "y": "y_m",
    "y_sigma": "y_sigma_m",
    "vehicle_x": "vehicle_x_m",
    "vehicle_y": "vehicle_y_m",
    "vehicle_z": "vehicle_z_m",
    "closing_speed": "closing_mps",
    "closing_speed_sigma": "closing_sigma_mps",
    "lateral_speed": "lateral_mps",
    "lateral_speed_sigma": "lateral_sigma_mps",
    "ttc": "ttc_s",
    "ttc_sigma": "ttc_sigma_s",
    "gap": "gap_m",
    "speed": "speed_mps",
    "speed_sigma": "speed_sigma_mps",
    "heading": "heading_deg",
    "state": "state",
    "state_probability": "state_probability",
    "lane_index": "lane_index",
    "path_offset": "path_offset_m",
    "contact_probability": "contact_probability",
    "warning": "warning",
    "is_lead": "is_lead",
    "length": "length_m",
    "length_sigma": "length_sigma_m",
    "width": "width_m",
    "width_sigma": "width_sigma_m",
    "height": "height_m",
    "height_sigma": "height_sigma_m",
    "yaw": "yaw_deg",
    "yaw_sigma": "yaw_sigma_deg",
    "front_known": "front_known",
    "centre_x": "centre_x_m",
    "centre_x_sigma": "centre_x_sigma_m",
    "centre_y": "centre_y_m",
    "centre_y_sigma": "centre_y_sigma_m",
    "centre_z": "centre_z_m",
    "centre_z_sigma": "centre_z_sigma_m",
    "centre_vehicle_x": "centre_vehicle_x_m",
    "centre_vehicle_y": "centre_vehicle_y_m",
    "centre_vehicle_z": "centre_vehicle_z_m",
}
_OF_LEAD: Mapping[str, str] = {
    "id": "track_id",
    "class": "class",
    "gap": "gap_m",
    "gap_sigma": "fused_kf_sigma_m",
    "closing_speed": "closing_mps",
    "closing_speed_sigma": "closing_sigma_mps",
    "speed": "speed_mps",
    "speed_sigma": "speed_sigma_mps",
    "headway": "headway_s",
    "ttc": "ttc_front_s",
    "deceleration_required": "drac_mps2",
}
_COMPUTED: Mapping[str, tuple[ResultColumn, ...]] = {  # channels that are no columns, by group
    "ego": (
        ResultColumn("speed", "m/s", "", "speed of the vehicle along its axis, forwards"),
        ResultColumn("speed_sigma", "m/s", "", ""),
        ResultColumn("yaw_rate", "rad/s", "", "yaw rate, positive to the left"),
        ResultColumn("x", "m", "", "position of the camera in the frame map, along its first axis"),
        ResultColumn("y", "m", "", "position of the camera in the frame map, to the left"),
        ResultColumn(
            "heading", "rad", "", "heading of the vehicle in the frame map, counterclockwise"
        ),
    ),
    "lead": (
        ResultColumn("headway_sigma", "s", "", ""),
        ResultColumn("ttc_sigma", "s", "", ""),
        ResultColumn("deceleration_required_sigma", "m/s2", "", ""),
    ),
    "obj": (ResultColumn("age", "s", "", "time since the first frame of the track"),),
}
_COLUMNS: Mapping[str, Mapping[str, str]] = {"ego": {}, "lead": _OF_LEAD, "obj": _OF_OBJECTS}


def channels_of(group: str) -> tuple[ResultColumn, ...]:
    """The channels of the group "ego", "lead", or of a slot such as "obj_01", by their names."""
    kind, declared = group.partition("_")[0], declared_columns()
    columns = [replace(declared[of], name=name) for name, of in _COLUMNS[kind].items()]
    return tuple(replace(one, name=f"{group}_{one.name}") for one in (*columns, *_COMPUTED[kind]))


def comment_of(channel: ResultColumn) -> str:
    """What a channel means, in plain text; an unknown value is invalid in place of empty."""
    if channel.name.endswith("_sigma"):
        return f"standard deviation of {channel.name.removesuffix('_sigma')}"
    return re.sub(r"[\[\]`]", "", channel.meaning).partition(";")[0]


class MdfWriter:
    """Writer of run.mf4, whose records are in a temporary file until the end of the run."""

    files = (MDF_FILE,)

    def check_requirements(self) -> None:
        """Raise ExtraError unless the required packages are installed."""
        check_extra("mf4", "adas", "asammdf")

    def open(self, info: RunInfo, folder: Path) -> None:
        """Start without frames."""
        self.check_requirements()
        from asammdf import MDF

        self._info, self._path, self._mdf = info, folder / MDF_FILE, MDF(version=_VERSION)
        self._declared = declared_columns()
        self._groups: dict[str, int] = {}  # in the temporary file
        self._frames: list[tuple[float, dict[str, FloatArray]]] = []  # buffered, values by group
        self._slots: list[tuple[int, float] | None] = []  # track and its first time
        self._slots_before = self._slots

    def write(self, result: FrameResult) -> None:
        """Add a frame."""
        if len(self._frames) == _N_BUFFERED:
            self._flush()
        self._slots_before, self._slots = self._slots, self._slots_of(result)
        frame = {"ego": _ego_values(result, self._info.mounting or Mounting())}
        values = _values(result, self._declared)
        leads = np.flatnonzero(values["is_lead"] == 1)
        frame["lead"] = _lead_values(result, self._declared, int(leads[0]) if len(leads) else None)
        tracks = np.array(list(values.values())).T
        row_of = {int(track_id): row for track_id, row in zip(values["id"], tracks, strict=True)}
        unknown = np.full(len(values) + 1, np.nan)
        for slot, held in enumerate(self._slots, start=1):
            row = unknown if held is None else np.append(row_of[held[0]], result.time_s - held[1])
            frame[f"obj_{slot:02d}"] = row
        self._frames.append((result.time_s, frame))

    def discard_last(self) -> None:
        """Discard the last frame, which is always in memory."""
        self._slots = self._slots_before
        del self._frames[-1:]

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Write the file."""
        try:
            self._flush()
            self._describe((summary or {}).get("notes") or self._info.notes)
            with atomic_path(self._path) as partial:
                self._mdf.save(partial, overwrite=True, compression=_TRANSPOSED_DEFLATE)
        finally:
            self._mdf.close()

    def _slots_of(self, result: FrameResult) -> list[tuple[int, float] | None]:
        """The slots with the tracks of a frame; new ones are where the frame before had none."""
        present = set(result.tracks.track_id.tolist())
        free = [index for index, held in enumerate(self._slots) if held is None]
        slots = [held if held is not None and held[0] in present else None for held in self._slots]
        for track_id in sorted(present - {held[0] for held in slots if held is not None}):
            if not free:
                free.append(len(slots))
                slots.append(None)
            slots[free.pop(0)] = (track_id, result.time_s)
        return slots

    def _flush(self) -> None:
        """Move the buffered frames to the temporary file."""
        from asammdf import Signal

        for name in dict.fromkeys(name for _, frame in self._frames for name in frame):
            time_s = np.array([time_s for time_s, frame in self._frames if name in frame])
            rows = np.array([frame[name] for _, frame in self._frames if name in frame])
            channels, is_invalid = channels_of(name), ~np.isfinite(rows)
            samples = [
                (column.astype(_TYPES[channel.kind]), np.ascontiguousarray(invalid))
                for channel, column, invalid in zip(
                    channels, np.where(is_invalid, 0.0, rows).T, is_invalid.T, strict=True
                )
            ]
            if name in self._groups:
                self._mdf.extend(self._groups[name], [(time_s, None), *samples])
                continue
            signals = [
                Signal(
                    values,
                    time_s,
                    unit=channel.unit,
                    name=channel.name,
                    conversion=_conversion(channel),
                    comment=comment_of(channel),
                    invalidation_bits=invalid,
                )
                for channel, (values, invalid) in zip(channels, samples, strict=True)
            ]
            self._groups[name] = len(self._groups)
            self._mdf.append(signals, acq_name=name, comment=name, common_timebase=True)
        self._frames = []

    def _describe(self, notes: Sequence[str]) -> None:
        """Write the start and the origin of the run to the header."""
        start_s = self._info.start_utc_s
        self._mdf.header.start_time = datetime.fromtimestamp(start_s or 0.0, UTC)
        unknown = ["The date and time of the recording are not known."] if start_s is None else []
        properties = "".join(
            f'<e name="{name}">{escape(value)}</e>'
            for name, value in self._info.provenance.metadata().items()
        )
        self._mdf.header.comment = (
            f"<HDcomment><TX>{escape(chr(10).join([*notes, *unknown]))}</TX>"
            f"<common_properties>{properties}</common_properties></HDcomment>"
        )


def _conversion(channel: ResultColumn) -> Any:
    """The names of the values of a channel; None = numbers."""
    from asammdf.blocks.conversion_utils import from_dict

    texts: dict[str, Any] = {f"text_{i}": name.encode() for i, name in enumerate(channel.names)}
    return from_dict({**texts, **{f"val_{i}": i for i in range(len(texts))}}) if texts else None


def _values(result: FrameResult, declared: Mapping[str, ResultColumn]) -> dict[str, FloatArray]:
    """(N,) values of the N tracks by channel; NaN = unknown, as flags of what did not run are."""
    values = {
        name: declared[column].read(result).astype(np.float64)
        for name, column in _OF_OBJECTS.items()
    }
    for flag, known in (
        ("warning", "contact_probability"),
        ("is_lead", "gap"),
        ("front_known", "yaw"),
    ):
        values[flag][np.isnan(values[known])] = np.nan
    return values


def _ego_values(result: FrameResult, mounting: Mounting) -> FloatArray:
    """The values of the channels of the ego vehicle. Its speed is that of the camera along its x axis;
    the errors of both parts of a given speed are one.
    """
    ego, pose = result.ego, result.ego_pose
    right, _, forward = mounting.vehicle_from_camera[0].tolist()
    speed_mps = forward * ego.speed_mps + right * ego.right_mps
    sigma_mps = abs(forward) * ego.speed_sigma_mps + abs(right) * ego.right_sigma_mps
    heading_rad = pose.heading_rad - math.radians(mounting.yaw_deg)
    return np.array([speed_mps, sigma_mps, -ego.yaw_rad_s, pose.x_m, pose.y_m, heading_rad])


def _lead_values(
    result: FrameResult, declared: Mapping[str, ResultColumn], index: int | None
) -> FloatArray:
    """The values of the channels of the lead, None = there is none. The sigmas of headway g / V, time
    to collision g / c and deceleration c^2 / 2 g are of the first order, with independent errors.
    """
    if index is None:
        return np.full(len(_OF_LEAD) + len(_COMPUTED["lead"]), np.nan)
    lead = {name: float(declared[of].read(result)[index]) for name, of in _OF_LEAD.items()}
    gap, closing, ego = (
        sigma / value if value else math.nan
        for sigma, value in (
            (lead["gap_sigma"], lead["gap"]),
            (lead["closing_speed_sigma"], lead["closing_speed"]),
            (result.ego.speed_sigma_mps, result.ego.speed_mps),
        )
    )
    return np.array(
        [
            *lead.values(),
            lead["headway"] * math.hypot(gap, ego),
            lead["ttc"] * math.hypot(gap, closing),
            lead["deceleration_required"] * math.hypot(gap, 2 * closing),
        ]
    )
