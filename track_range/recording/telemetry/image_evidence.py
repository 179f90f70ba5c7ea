"""Motion in the first seconds of a video, and whether telemetry contradicts it."""

from __future__ import annotations

import itertools
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.packet import Packet
from av.video.stream import VideoStream

from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.errors import UserError
from track_range.recording.sources.names import VideoName
from track_range.recording.sources.open_video import open_video
from track_range.recording.telemetry.time_offset import MAX_OFFSET_S, MotionSeries
from track_range.recording.video.frame import TIME_EPSILON_S
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.image_motion import ImageMotionEstimator
from track_range.stereo.speed.ego_speed import EgoSpeed

# length of the video measured before a run: three times the largest offset on both sides
SPAN_S = 30.0
_STEP_S = 0.095  # shortest time between two images that are compared, s: 10 Hz

_N_PAIRS = 30
"""Number of pairs of images in the part that is read. With one pair per second, offsets of
simulated drives (city, seeds 1 and 2, and queue, seed 2) have the same errors as with ten, and at
most 1.5 times their sigma."""

_MIN_PAIRS = 20  # for an estimate of the time offset; with fewer key frames, all frames are decoded
_MAX_GROUP_S = 1.5  # longest time between two key frames with which only pairs are decoded, s
# pixels to decode before a run, about 1.5 s; frames that are decoded anyway
_MAX_DECODED_PX, _MIN_DECODED = 250e6, 60
# speed that a camera at rest cannot have; largest stated of a car at rest
_CLAIMED_MPS, _STANDING_MPS = 3.0, 0.3
# images at rest (1 s) that can contradict; fraction with a stated motion
_MIN_STILL, _MAX_CONTRADICTED = 10, 0.5
# expansion of images that only a moving camera has, 1/s: 2 m/s at a typical depth of 10 m
_MOVING_HZ = 0.2


def motion_of(
    video: VideoName,
    camera: PinholeCamera,
    *,
    start_s: float,
    fps: float | None = None,
    span_s: float = SPAN_S,
    max_images: int | None = None,
    travel_from_camera: FloatArray | None = None,
) -> MotionSeries:
    """Motion of the images of a video from `start_s` after the first frame on; empty if they cannot
    be read.

    In a file with frequent key frames, only key frames and the frames 0.1 s later are decoded;
    otherwise all frames are. `camera` is its approximate camera, with the axes of travel of
    `ImageMotionEstimator`. Of large images, less than
    `span_s` is read: `max_images`, by default so many that they have `_MAX_DECODED_PX`.
    """
    rows: list[tuple[float, float, float, float]] = []
    with suppress(UserError, av.FFmpegError):  # the run reports what it cannot read
        reader = open_video(video, fps=fps, start_s=start_s, duration_s=span_s)
        size_px = reader.width_px, reader.height_px
        if reader.shown_size_px == camera.size_px:
            camera = camera.resized(size_px)
        else:  # of another size, which the rectification or a crop of the pair changes
            centre_px = (size_px[0] - 1) / 2, (size_px[1] - 1) / 2
            camera = PinholeCamera(camera.fx_px, camera.fy_px, *centre_px, *size_px)
        estimator = ImageMotionEstimator(camera, travel_from_camera=travel_from_camera)
        with closing(reader), closing(_images(reader, start_s, span_s, max_images)) as images:
            for time_s, image in images:
                motion = estimator.update(image, time_s)
                if motion.is_known:
                    middle_s = time_s - motion.dt_s / 2
                    rows.append(
                        (middle_s, motion.yaw_rad_s, motion.expansion_hz, float(motion.is_still))
                    )
    values = np.array(rows).reshape(-1, 4)
    return MotionSeries(
        time_s=values[:, 0],
        yaw_rad_s=values[:, 1],
        expansion_hz=values[:, 2],
        is_still=values[:, 3] > 0,
    )


def _images(
    reader: RecordedVideo, start_s: float, span_s: float, max_images: int | None
) -> Generator[tuple[float, Image], None, None]:
    """Times in seconds from the first frame, and images."""
    usual = max(round(_MAX_DECODED_PX / (reader.width_px * reader.height_px)), _MIN_DECODED)
    n_left = usual if max_images is None else max_images
    path, from_s = Path(str(reader.path)), reader.first_time_s + start_s
    length_s = min(span_s, reader.n_frames / reader.fps if reader.n_frames else span_s)
    if reader.is_upright_file and _key_interval_s(path, from_s) <= length_s / _MIN_PAIRS:
        for time_s, image in _pairs(path, from_s, from_s + span_s, length_s / _N_PAIRS, n_left):
            if image.shape != (reader.height_px, reader.width_px):
                return
            yield time_s - reader.first_time_s, image
        return
    due_s = -np.inf
    with closing(iter(reader)) as frames:
        for frame in itertools.islice(frames, n_left):
            time_s = frame.time_s - reader.first_time_s
            if time_s >= due_s:
                due_s = time_s + _STEP_S
                yield time_s, frame.image


def _packets(
    container: InputContainer, from_s: float
) -> Generator[tuple[float, Packet[VideoStream]], None, None]:
    """Times and packets of the first video track from the key frame before `from_s` on, to the
    first without a time.
    """
    stream = container.streams.video[0]
    base_s = float(stream.time_base or 1)
    if from_s > _MAX_GROUP_S:
        container.seek(int(from_s / base_s), stream=stream)
    for packet in container.demux(stream):
        if packet.pts is None:
            return
        yield packet.pts * base_s, packet


def _key_interval_s(path: Path, from_s: float) -> float:
    """Time between the first two key frames; infinite if it is longer than `_MAX_GROUP_S`."""
    with av.open(str(path)) as container:
        first_s: float | None = None
        for time_s, packet in _packets(container, from_s):
            if first_s is not None and time_s > first_s + _MAX_GROUP_S:
                break
            if packet.is_keyframe and first_s is not None:
                return time_s - first_s
            if packet.is_keyframe:
                first_s = time_s
    return np.inf


def _pairs(
    path: Path, from_s: float, until_s: float, spacing_s: float, n_left: int
) -> Generator[tuple[float, Image], None, None]:
    """Times and grey images of pairs, `spacing_s` or more apart: a key frame, and the first frame
    `_STEP_S` later.
    """
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        decoder, base_s = stream.codec_context, float(stream.time_base or 1)
        decoder.thread_type = "SLICE"  # threads by frame delay the images
        decoder.skip_frame = "NONREF"  # frames that no other one needs
        for key_s, group in _groups(_packets(container, from_s), from_s, until_s, spacing_s):
            if n_left <= 0:
                return
            frames = [frame for packet in (*group, None) for frame in decoder.decode(packet)]
            decoder.flush_buffers()
            n_left -= len(frames)
            times_s = [np.nan if frame.pts is None else frame.pts * base_s for frame in frames]
            for i in _key_and_later(times_s, key_s):
                yield times_s[i], np.asarray(frames[i].to_ndarray(format="gray"), np.uint8)


def _groups(
    packets: Iterable[tuple[float, Packet[VideoStream]]],
    from_s: float,
    until_s: float,
    spacing_s: float,
) -> Iterator[tuple[float, list[Packet[VideoStream]]]]:
    """Time of a key frame, and its packets up to the first one `_STEP_S` later, `spacing_s` or more
    apart.
    """
    due_s, key_s = from_s, -np.inf
    group: list[Packet[VideoStream]] = []
    for packet_s, packet in packets:
        if packet_s >= until_s:
            return
        if packet.is_keyframe and packet_s >= due_s - TIME_EPSILON_S:
            group, key_s, due_s = [packet], packet_s, packet_s + spacing_s
        elif group:
            group.append(packet)
            if packet_s >= key_s + _STEP_S:
                yield key_s, group
                group = []


def _key_and_later(times_s: Sequence[float], key_s: float) -> tuple[int, ...]:
    """Places of the key frame and of the first frame `_STEP_S` later; empty if one was not
    decoded.
    """
    is_key = [abs(time_s - key_s) <= TIME_EPSILON_S for time_s in times_s]
    is_later = [time_s >= key_s + _STEP_S for time_s in times_s]
    if not (any(is_key) and any(is_later)):
        return ()
    return is_key.index(True), is_later.index(True)


def contradiction(motion: MotionSeries, ego: EgoSpeed) -> str | None:
    """The contradiction of images and speed at all offsets up to `MAX_OFFSET_S`, as the end of a
    sentence, if any.
    """
    claims = np.array([_extremes_mps(ego, time_s) for time_s in motion.time_s.tolist()]).reshape(
        -1, 2
    )
    known = np.isfinite(claims[:, 0])
    still = motion.is_still & known
    if still.sum() >= _MIN_STILL:
        is_false = claims[still, 0] > _CLAIMED_MPS
        if is_false.mean() > _MAX_CONTRADICTED:
            claimed_kmh = 3.6 * float(np.median(claims[still, 0][is_false]))
            return f"it states {claimed_kmh:.0f} km/h while the camera is at rest"
    moving = (motion.expansion_hz > _MOVING_HZ) & ~motion.is_still & known
    if (
        moving.sum() >= _MIN_STILL
        and (claims[moving, 1] < _STANDING_MPS).mean() > _MAX_CONTRADICTED
    ):
        return "it states that the car is at rest while the camera moves"
    return None


def _extremes_mps(ego: EgoSpeed, time_s: float) -> tuple[float, float]:
    """Smallest and largest speed within the largest offset of a time; NaN = unknown."""
    speeds = [
        abs(ego.at(time_s + offset_s))
        for offset_s in np.linspace(-MAX_OFFSET_S, MAX_OFFSET_S, 13).tolist()
    ]
    known = [speed for speed in speeds if np.isfinite(speed)]
    return (min(known), max(known)) if known else (np.nan, np.nan)
