"""run.mf4: ASAM MDF 4.11 with the ego vehicle, the lead vehicle, and the tracks in object slots.

A group of channels for the ego vehicle, one for the lead vehicle, and one for each slot, with a
sample per frame. A track keeps its slot while it lives, and the slot is then empty for a frame.
What is not known has the channel's invalidation bit. Numbers are 32-bit floats.
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
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.atomic_files import atomic_path
from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.run_info import RunInfo
from track_range.results.formats.scene import check_extra
from track_range.results.rows.column import ColumnKind, ResultColumn
from track_range.results.rows.columns import declared_columns

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
_AGE = ResultColumn("age", "s", "", "time since the first frame of the track")
_LEAD_SIGMAS = (
    ResultColumn("headway_sigma", "s", "", ""),
    ResultColumn("ttc_sigma", "s", "", ""),
    ResultColumn("deceleration_required_sigma", "m/s2", "", ""),
)
EGO_CHANNELS = (
    ResultColumn(
        "ego_speed", "m/s", "ego.speed_mps", "speed of the camera along its axis, forwards"
    ),
    ResultColumn("ego_speed_sigma", "m/s", "ego.speed_sigma_mps", ""),
    ResultColumn("ego_yaw_rate", "rad/s", "ego.yaw_rad_s", "yaw rate, positive to the left"),
    ResultColumn("ego_x", "m", "ego_pose.x_m", "position in the frame map, along its first axis"),
    ResultColumn("ego_y", "m", "ego_pose.y_m", "position in the frame map, to the left"),
    ResultColumn(
        "ego_heading", "rad", "ego_pose.heading_rad", "heading in the frame map, counterclockwise"
    ),
)


def object_channels() -> tuple[ResultColumn, ...]:
    """The channels of a slot, whose names are without the slot."""
    return (*_renamed(_OF_OBJECTS), _AGE)


def lead_channels() -> tuple[ResultColumn, ...]:
    """The channels of the lead vehicle, by their names in the file."""
    channels = (*_renamed(_OF_LEAD), *_LEAD_SIGMAS)
    return tuple(replace(channel, name=f"lead_{channel.name}") for channel in channels)


def _renamed(columns: Mapping[str, str]) -> tuple[ResultColumn, ...]:
    declared = declared_columns()
    return tuple(replace(declared[column], name=name) for name, column in columns.items())


def slot_name(slot: int) -> str:
    """Start of the names of the channels of a slot, from 0."""
    return f"obj_{slot + 1:02d}"


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

        self._info, self._path = info, folder / MDF_FILE
        self._mdf = MDF(version=_VERSION)
        self._objects, self._lead = object_channels(), _renamed(_OF_LEAD)
        self._groups = [("ego", EGO_CHANNELS), ("lead", lead_channels())]
        self._times_s: list[float] = []  # of all frames
        self._frames: list[list[FloatArray]] = []  # buffered values of each group
        self._slots: list[tuple[int, float] | None] = []  # track and its first time
        self._slots_before = self._slots

    def write(self, result: FrameResult) -> None:
        """Add a frame."""
        if len(self._frames) == _N_BUFFERED:
            self._flush()
        self._slots_before, self._slots = self._slots, self._slots_of(result)
        values = _object_values(result, self._objects[:-1])
        track_ids = result.tracks.track_id.tolist()
        frame = [_ego_values(result), _lead_values(result, self._lead)]
        for slot in self._slots:
            row = np.full(len(self._objects), np.nan)
            if slot is not None:
                track_id, first_s = slot
                row[:-1], row[-1] = values[:, track_ids.index(track_id)], result.time_s - first_s
            frame.append(row)
        self._times_s.append(result.time_s)
        self._frames.append(frame)

    def discard_last(self) -> None:
        """Discard the last frame, which is always in memory."""
        if self._frames:
            self._slots = self._slots_before
            del self._frames[-1], self._times_s[-1]

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
        kept = {slot[0] for slot in self._slots if slot is not None}
        free = [index for index, slot in enumerate(self._slots) if slot is None]
        slots = [slot if slot is not None and slot[0] in present else None for slot in self._slots]
        for track_id in sorted(present - kept):
            if not free:
                free.append(len(slots))
                slots.append(None)
            slots[free.pop(0)] = (track_id, result.time_s)
        return slots

    def _flush(self) -> None:
        """Write the buffered frames to the temporary file, and groups of new slots from the first
        frame on.
        """
        n_written = len(self._mdf.groups)
        n_groups = max((len(frame) for frame in self._frames), default=2)
        for slot in range(len(self._groups) - 2, n_groups - 2):
            name = slot_name(slot)
            channels = tuple(replace(one, name=f"{name}_{one.name}") for one in self._objects)
            self._groups.append((name, channels))
        n_before = len(self._times_s) - len(self._frames)
        for index, (name, channels) in enumerate(self._groups):
            blank = np.full(len(channels), np.nan)
            rows = [frame[index] if index < len(frame) else blank for frame in self._frames]
            if index < n_written:
                if rows:
                    samples = _samples(channels, np.array(rows))
                    self._mdf.extend(index, [(np.array(self._times_s[n_before:]), None), *samples])
                continue
            values = np.array([blank] * n_before + rows).reshape(-1, len(channels))
            self._append(name, channels, values)
        self._frames = []

    def _append(self, name: str, channels: Sequence[ResultColumn], values: FloatArray) -> None:
        """Add a group with (N, K) values of its K channels in all frames so far."""
        from asammdf import Signal

        time_s = np.array(self._times_s)
        signals = [
            Signal(
                samples,
                time_s,
                unit=channel.unit,
                name=channel.name,
                conversion=_conversion(channel),
                comment=comment_of(channel),
                invalidation_bits=invalid,
            )
            for channel, (samples, invalid) in zip(
                channels, _samples(channels, values), strict=True
            )
        ]
        self._mdf.append(signals, acq_name=name, comment=name, common_timebase=True)

    def _describe(self, notes: Sequence[str]) -> None:
        """Write the start and the origin of the run to the header."""
        start_s = self._info.start_utc_s
        self._mdf.header.start_time = datetime.fromtimestamp(start_s or 0.0, UTC)
        texts = [*notes]
        if start_s is None:
            texts.append("The date and time of the recording are not known.")
        properties = "".join(
            f'<e name="{name}">{escape(value)}</e>'
            for name, value in self._info.provenance.metadata().items()
        )
        self._mdf.header.comment = (
            f"<HDcomment><TX>{escape(chr(10).join(texts))}</TX>"
            f"<common_properties>{properties}</common_properties></HDcomment>"
        )


def _samples(
    channels: Sequence[ResultColumn], values: FloatArray
) -> list[tuple[npt.NDArray[Any], npt.NDArray[np.bool_]]]:
    """Samples of each channel with the type in the file, and whether they are invalid, of (N, K)
    values.
    """
    is_invalid = ~np.isfinite(values)
    known = np.where(is_invalid, 0.0, values)
    return [
        (known[:, k].astype(_TYPES[channel.kind]), np.ascontiguousarray(is_invalid[:, k]))
        for k, channel in enumerate(channels)
    ]


def _conversion(channel: ResultColumn) -> Any:
    """The names of the values of a channel; None = numbers."""
    from asammdf.blocks.conversion_utils import from_dict

    if channel.kind != "name":
        return None
    texts: dict[str, Any] = {f"text_{i}": name.encode() for i, name in enumerate(channel.names)}
    return from_dict({**texts, **{f"val_{i}": i for i in range(len(texts))}})


def _object_values(result: FrameResult, channels: Sequence[ResultColumn]) -> FloatArray:
    """(K, N) values of the N tracks of a frame; NaN = unknown, as flags of what did not run are."""
    values = np.array([channel.read(result) for channel in channels], np.float64)
    for name, has_run in (
        ("warning", result.alarms.has_warnings),
        ("is_lead", result.alarms.has_safety),
    ):
        if not has_run:
            values[[channel.name for channel in channels].index(name)] = np.nan
    return values


def _ego_values(result: FrameResult) -> FloatArray:
    """The values of `EGO_CHANNELS`."""
    ego, pose = result.ego, result.ego_pose
    speeds = ego.speed_mps, ego.speed_sigma_mps, -ego.yaw_rad_s
    return np.array([*speeds, pose.x_m, pose.y_m, pose.heading_rad])


def _lead_values(result: FrameResult, columns: Sequence[ResultColumn]) -> FloatArray:
    """The values of `lead_channels`. The sigmas of headway g / V, time to collision g / c and
    deceleration c^2 / 2 g are of the first order, with independent errors of g, V and c.
    """
    leads = np.flatnonzero(result.safety.is_lead)
    if not len(leads):
        return np.full(len(columns) + len(_LEAD_SIGMAS), np.nan)
    values = [float(column.read(result)[leads[0]]) for column in columns]
    known = dict(zip(_OF_LEAD, values, strict=True))
    gap = _ratio(known["gap_sigma"], known["gap"])
    closing = _ratio(known["closing_speed_sigma"], known["closing_speed"])
    ego = _ratio(result.ego.speed_sigma_mps, result.ego.speed_mps)
    sigmas = (
        known["headway"] * math.hypot(gap, ego),
        known["ttc"] * math.hypot(gap, closing),
        known["deceleration_required"] * math.hypot(gap, 2 * closing),
    )
    return np.array([*values, *sigmas])


def _ratio(sigma: float, value: float) -> float:
    return sigma / value if value else math.nan
