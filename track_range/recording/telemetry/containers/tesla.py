"""Tesla: vehicle speed in user-data SEI messages of the video, one per frame (H.264 and H.265).

Format: github.com/teslamotors/dashcam. The payload of an SEI message of type 5 starts with bytes
0x42 and one 0x69; a message in protobuf follows: field 2 gear (2 = reverse), 4 vehicle_speed_mps
(float), 11 latitude_deg, 12 longitude_deg, 13 heading_deg (double). Fields that are 0 are not
written. The sign of the speed is dropped.
"""

import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from track_range.recording.telemetry.containers.mp4_boxes import Movie, Track, read_samples
from track_range.recording.telemetry.tracks.samples import MAX_SAMPLES, Sample, track
from track_range.recording.telemetry.tracks.track import TelemetryTrack

# standard deviation, assumed: wheel speeds change with the wear of the tyres
_SPEED_SIGMA_MPS = 0.1
# bytes read at the start of a frame; parameter sets and SEI messages come before the picture
_SEI_BYTES = 4096
# frames, spread over the video, that are read to find out whether there are messages
_PROBED_FRAMES = 120
_USER_DATA = 5  # type of SEI messages with unregistered user data
_SEI_TYPES = {b"avc1": (6,), b"avc3": (6,), b"hvc1": (39, 40), b"hev1": (39, 40)}  # of NAL units


def read_tesla(file: BinaryIO, movie: Movie, _path: Path) -> TelemetryTrack | None:
    """Telemetry of the first video track of a movie; None = it has no such messages."""
    video = movie.video
    if video is None or video.format not in _SEI_TYPES:
        return None
    n = min(len(video), MAX_SAMPLES)
    probed = np.unique(np.linspace(0, n - 1, min(n, _PROBED_FRAMES)).astype(int))
    if not any(
        _message(content, video) for _, content in read_samples(file, video, probed, _SEI_BYTES)
    ):
        return None
    samples = [
        sample.at(float(video.time_s[index]) - movie.start_s)
        for index, content in read_samples(file, video, range(n), _SEI_BYTES)
        if (sample := _message(content, video))
    ]
    samples.sort(key=lambda sample: sample.time_s)  # frames are stored in the order of decoding
    return track(samples, "Tesla dashcam", speed_sigma_mps=_SPEED_SIGMA_MPS)


def _message(content: bytes, video: Track) -> Sample | None:
    is_hevc = video.format in (b"hvc1", b"hev1")
    n_size, start = _size_bytes(video.description), 0
    while start + n_size + 3 <= len(content):
        n_bytes = int.from_bytes(content[start : start + n_size], "big")
        unit = content[start + n_size : start + n_size + n_bytes]
        start += n_size + n_bytes
        if (
            len(unit) >= 3
            and ((unit[0] >> 1) & 0x3F if is_hevc else unit[0] & 0x1F) in _SEI_TYPES[video.format]
        ):
            for payload in _user_data(unit[2 if is_hevc else 1 :]):
                if (sample := parse_message(payload)) is not None:
                    return sample
    return None


def _size_bytes(description: bytes) -> int:
    """Bytes of the size before each NAL unit, from the box `avcC` or `hvcC`; usually 4."""
    for name, offset in ((b"avcC", 8), (b"hvcC", 25)):  # from the start of the name
        start = description.find(name)
        if start >= 0 and start + offset < len(description):
            return (description[start + offset] & 3) + 1
    return 4


def _user_data(messages: bytes) -> Iterator[bytes]:
    """Payloads of the user-data messages of an SEI unit without its header."""
    content = messages.replace(b"\0\0\x03", b"\0\0")  # emulation prevention
    start = 0
    while start + 2 < len(content):
        type_number, start = _extended(content, start)
        n_bytes, start = _extended(content, start)
        if type_number == _USER_DATA:
            yield content[start : start + n_bytes]
        start += n_bytes


def _extended(content: bytes, start: int) -> tuple[int, int]:
    """A number of an SEI header, which bytes 0xFF extend, and the offset after it."""
    value = 0
    while start < len(content) and content[start] == 0xFF:
        value, start = value + 255, start + 1
    return value + (content[start] if start < len(content) else 0), start + 1


def parse_message(payload: bytes) -> Sample | None:
    """The sample in the payload of a user-data message; None = it is another message."""
    content = payload.lstrip(b"\x42")
    fields = (
        _fields(content[1:]) if len(content) < len(payload) and content[:1] == b"\x69" else None
    )
    if fields is None:
        return None
    speed_mps, latitude_deg, longitude_deg = (fields.get(number, 0.0) for number in (4, 11, 12))
    if latitude_deg == 0 and longitude_deg == 0:
        return Sample(speed_mps=abs(speed_mps))
    return Sample(
        math.nan, math.nan, abs(speed_mps), fields.get(13, 0.0), latitude_deg, longitude_deg
    )


def _fields(content: bytes) -> dict[int, float] | None:
    """Numbers of a protobuf message by field; None = it is no such message."""
    fields: dict[int, float] = {}
    start = 0
    while start < len(content):
        key, start = _varint(content, start)
        number, wire = key >> 3, key & 7
        form = {1: "<d", 5: "<f"}.get(wire)
        if not 0 < number <= 1000 or (form and start + struct.calcsize(form) > len(content)):
            return None
        if form:
            fields[number] = struct.unpack_from(form, content, start)[0]
            start += struct.calcsize(form)
        elif wire == 0:
            fields[number], start = _varint(content, start)
        elif wire == 2:
            n_bytes, start = _varint(content, start)
            start += n_bytes
        else:
            return None
    return fields


def _varint(content: bytes, start: int) -> tuple[int, int]:
    """A protobuf integer of variable length, and the offset after it."""
    value = 0
    for shift in range(0, 70, 7):
        byte = content[start] if start < len(content) else 0
        value, start = value | (byte & 0x7F) << shift, start + 1
        if not byte & 0x80:
            break
    return value, start
