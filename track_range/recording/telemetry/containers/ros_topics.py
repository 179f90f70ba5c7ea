"""Positions and speeds in MCAP files and ROS bags: NavSatFix, TwistStamped, Odometry and their
relatives.
"""

import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import shortened
from track_range.recording.sources.bags.bag import is_bag, open_bag
from track_range.recording.sources.bags.container import Bag, DamagedError, Topic
from track_range.recording.sources.bags.decoding import is_readable, message_reader, stamp_s
from track_range.recording.telemetry.tracks.positions import speed_from_positions
from track_range.recording.telemetry.tracks.samples import MAX_SAMPLES, plain_track
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack

# names of frames that do not move with a vehicle, where the velocity has no forward component
_FIXED_FRAME = re.compile(r"map|odom|world|earth|enu|ned|utm|ecef|gps|gnss|nav|^$", re.IGNORECASE)


def _speed(twist: Any, frame: str) -> tuple[float, ...]:
    """The length of a velocity, with the sign of x, forward in frames of vehicles (ROS REP 103), if
    that is the direction of the drive.
    """
    x_mps, y_mps, z_mps = (float(getattr(twist.linear, axis)) for axis in "xyz")
    speed_mps = math.hypot(x_mps, y_mps, z_mps)
    is_forward = abs(x_mps) >= math.hypot(y_mps, z_mps) and not _FIXED_FRAME.search(frame)
    return (math.copysign(speed_mps, x_mps) if is_forward else speed_mps,)


_SPEEDS: dict[
    str, Callable[[Any], tuple[float, ...]]
] = {  # (1,) m/s from a message, by type, in the order of preference
    "geometry_msgs/msg/TwistStamped": lambda message: _speed(
        message.twist, message.header.frame_id
    ),
    "geometry_msgs/msg/TwistWithCovarianceStamped": lambda message: _speed(
        message.twist.twist, message.header.frame_id
    ),
    "nav_msgs/msg/Odometry": lambda message: _speed(message.twist.twist, message.child_frame_id),
}
_POSITIONS = ("sensor_msgs/msg/NavSatFix", "foxglove.LocationFix", "foxglove_msgs/msg/LocationFix")
_COMMAND = "cmd"  # in the names of topics with commanded speeds


def read_ros_topics(path: Path) -> TelemetryTrack | None:
    """Telemetry of a bag, None = no bag or no such topics; raises TelemetryError if it cannot be
    read.
    """
    if not is_bag(path):
        return None
    try:
        bag = open_bag(path)
        time_s, speed_mps, speed_topic = np.empty(0), np.empty(0), ""
        topics = [
            topic
            for topic in bag.topics.values()
            if topic.type in _SPEEDS and _COMMAND not in topic.name
        ]
        for topic in sorted(topics, key=lambda topic: list(_SPEEDS).index(topic.type)):
            time_s, speeds = _values(bag, topic, _SPEEDS[topic.type])
            speed_mps, speed_topic = speeds[:, 0], topic.name
            if len(time_s):
                break
        fixes = next((topic for topic in bag.topics.values() if topic.type in _POSITIONS), None)
        fix_s, positions = (
            (np.empty(0), np.empty((0, 2))) if fixes is None else _values(bag, fixes, _position)
        )
    except UserError as error:
        raise TelemetryError(str(error)) from error
    known = np.isfinite(positions).all(axis=1)
    fix_s, latitude_deg, longitude_deg = fix_s[known], *positions[known].T
    if len(time_s):
        at_s = [
            np.interp(time_s, fix_s, values, left=np.nan, right=np.nan)
            if len(fix_s)
            else np.full(len(time_s), np.nan)
            for values in (latitude_deg, longitude_deg)
        ]
        rows = np.column_stack([time_s, time_s, speed_mps, np.full(len(time_s), np.nan), *at_s])
        notes = _unused([topic.name for topic in topics], speed_topic)
        return plain_track(rows, f"topic {speed_topic}", "utc", notes=notes)
    source = f"topic {fixes.name}" if fixes is not None else ""
    return speed_from_positions(
        fix_s, latitude_deg, longitude_deg, fix_s, source=source, clock="utc"
    )


def _unused(names: Sequence[str], used: str) -> tuple[str, ...]:
    """A note on topics of speeds that are not used, if any."""
    others = shortened(", ".join(name for name in names if name != used), 100)
    return (f"the speeds are those of {used}, not of {others}.",) if others else ()


def _position(message: Any) -> tuple[float, float]:
    status = getattr(getattr(message, "status", None), "status", 0)
    return (float(message.latitude), float(message.longitude)) if status >= 0 else (np.nan, np.nan)


def _values(
    bag: Bag, topic: Topic, read: Callable[[Any], tuple[float, ...]]
) -> tuple[FloatArray, FloatArray]:
    """(N,) times in s since 1970, and (N, K) values of the readable messages of a topic."""
    rows: list[tuple[float, ...]] = []
    with suppress(DamagedError):  # the schema: no message can be read
        parse = message_reader(topic)
        messages = bag.messages(topic.name, 0.0) if is_readable(topic) else ()
        for _, recorded_s, data in islice(messages, MAX_SAMPLES):
            with suppress(Exception):  # protobuf's and rosbags' errors derive from Exception
                message = parse(data)
                rows.append((stamp_s(message), recorded_s, *read(message)))
    values = np.array(rows) if rows else np.empty((0, 4))
    time_s = values[:, 0]
    is_stamped = (time_s > 0) & ~np.isnan(time_s).any()  # beside wrong ones, right by chance
    return np.where(is_stamped, time_s, values[:, 1]), values[:, 2:]
