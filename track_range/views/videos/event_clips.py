"""Clips of events: short parts of overlay.mp4, copied without recoding.

    overlay     K...........K...........K...........K...        K = keyframe, one per second
    clip              |-----------------------|
                      recoded  copied

A clip starts 3 s before its event and ends 2 s after it (`clip_interval_s`). Players can only start at a
keyframe, so the frames before the first keyframe of the clip, at most one second, are encoded again
with the overlay's settings; all others are copied. If the encoder of another version gives other
parameter sets, the whole clip is encoded again.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import TypeAlias

import av
from av.container import InputContainer
from av.video.stream import VideoStream

from track_range.foundation.arrays import Image
from track_range.foundation.files.atomic_files import atomic_folder, describe
from track_range.foundation.files.input_files import check_regular
from track_range.foundation.files.output_files import OutputError, make_folder
from track_range.recording.video.frame import VideoError, bgr_image
from track_range.results.events.event import Event, clip_interval_s, clip_name, is_clip_name
from track_range.views.videos.result_video import QUANTIZER
from track_range.views.videos.video_writer import VideoWriter

_TIME_TOLERANCE_S = 1e-3  # of the time of a frame


def write_clips(
    overlay: Path, events: Sequence[Event], folder: Path, *, starts_s: float
) -> tuple[Path, ...]:
    """Write a clip of each event of which the overlay shows a frame, and return their paths.

    Clips of an earlier run in the folder are removed. VideoError if the overlay cannot be read,
    OutputError if a clip cannot be written. `events` are all events of the run, in the order of
    events.csv; `starts_s` is the time of the overlay's first frame in seconds from the start of the
    video.
    """
    if not overlay.exists():
        raise VideoError(
            f"{overlay}: no such file; clips are cut from the overlay, so repeat the run without "
            "--no-overlay."
        )
    check_regular(overlay, VideoError, "the overlay of a run")
    remove_clips(folder)
    if not events:
        return ()
    make_folder(folder)
    written = []
    for number, event in enumerate(events, 1):
        path = folder / clip_name(number, event.kind, event.track_id)
        start_s, end_s = clip_interval_s(event)
        if cut_clip(overlay, path, start_s - starts_s, end_s - starts_s):
            written.append(path)
    return tuple(written)


def remove_clips(folder: Path) -> None:
    """Remove the clips of an earlier run, and their folder if it is then empty; OutputError if this
    fails.
    """
    try:
        for path in list(folder.iterdir()) if folder.is_dir() else ():
            if is_clip_name(path.name):
                path.unlink(missing_ok=True)
            # temporary folder of a run that was killed
            elif is_clip_name(path.name[1:].rpartition(".")[0]):
                shutil.rmtree(path, ignore_errors=True)
    except OSError as error:
        raise OutputError(
            f"{folder}: clips of an earlier run cannot be removed ({describe(error)})."
        ) from error
    with suppress(OSError):  # other files in it remain
        folder.rmdir()


def cut_clip(video: Path, path: Path, start_s: float, end_s: float) -> bool:
    """Write the frames of a `VideoWriter`'s video between two times, relative to its first frame,
    atomically.

    False if there are none; then nothing is written. VideoError if the video cannot be read,
    OutputError if the clip cannot be written.
    """
    with ExitStack() as opened:
        container, stream = opened.enter_context(_opened(video))
        before, packets = _packets_between(container, stream, start_s, end_s)
        if not (before or packets):
            return False
        first_tick = int((before or packets)[0].pts or 0)
        n_frames = len(before) + len(packets)
        for packet in packets:
            packet.pts = packet.dts = int(packet.pts or 0) - first_tick
        try:
            with atomic_folder(path) as folder:
                if before:
                    head = folder / "head.mp4"
                    _encode(container, stream, first_tick, len(before), head)
                    encoded = opened.enter_context(_opened(head))
                    if encoded[1].codec_context.extradata != stream.codec_context.extradata:
                        _encode(container, stream, first_tick, n_frames, head)
                        encoded, packets = opened.enter_context(_opened(head)), []
                    packets = [*_packets(*encoded), *packets]
                _mux(packets, folder / path.name)
        except (av.FFmpegError, OSError) as error:
            raise OutputError(
                f"{path}: the clip cannot be written ({error.strerror or error})."
            ) from error
    return True


def frame_at(video: Path, time_s: float) -> Image | None:
    """The frame at a time of a `VideoWriter`'s video, from its first frame; None = the frame cannot
    be read.
    """
    with suppress(VideoError, av.FFmpegError), _opened(video) as (container, stream):
        tick = max(round((time_s - _TIME_TOLERANCE_S) / (stream.time_base or Fraction(1))), 0)
        container.seek(tick, stream=stream)
        for frame in container.decode(stream):
            if (frame.pts or 0) >= tick:
                return bgr_image(frame)
    return None


_Packet: TypeAlias = "av.Packet[VideoStream]"


def _packets_between(
    container: InputContainer, stream: VideoStream, start_s: float, end_s: float
) -> tuple[list[_Packet], list[_Packet]]:
    """Packets between two times: before the first keyframe, and from there on; valid while the
    video is open.
    """
    ticks_per_s = 1 / (stream.time_base or Fraction(1))
    first_tick, last_tick = round(start_s * ticks_per_s), round(end_s * ticks_per_s)
    before: list[_Packet] = []
    packets: list[_Packet] = []
    if last_tick < 0:
        return before, packets
    container.seek(max(first_tick, 0), stream=stream)
    for packet in _packets(container, stream):
        if (packet.pts or 0) > last_tick:
            break
        if (packet.pts or 0) >= first_tick:
            (packets if packets or packet.is_keyframe else before).append(packet)
    return before, packets


def _packets(container: InputContainer, stream: VideoStream) -> Iterator[_Packet]:
    """Packets of a video, without the end marker and without a cut-off last packet."""
    return (
        packet
        for packet in container.demux(stream)
        if packet.pts is not None and not packet.is_corrupt
    )


def _encode(
    container: InputContainer, stream: VideoStream, first_tick: int, n_frames: int, path: Path
) -> None:
    """Write frames from a time on to a file, with the settings of the overlay."""
    codec = stream.codec_context
    fps = float(codec.framerate or stream.average_rate or 1)
    container.seek(first_tick, stream=stream)
    frames = (frame for frame in container.decode(stream) if (frame.pts or 0) >= first_tick)
    with VideoWriter(
        path, width_px=codec.width, height_px=codec.height, fps=fps, quantizer=QUANTIZER
    ) as writer:
        for frame in islice(frames, n_frames):
            time_s = ((frame.pts or 0) - first_tick) * (frame.time_base or Fraction(1))
            writer.write(bgr_image(frame), float(time_s))


def _mux(packets: Sequence[_Packet], path: Path) -> None:
    """Write packets to an MP4 file whose index comes first, so that browsers play the clip while it
    loads.
    """
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream = container.add_stream_from_template(packets[0].stream)
        for packet in packets:
            packet.stream = stream
            container.mux(packet)


@contextmanager
def _opened(video: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    try:
        with av.open(str(video)) as container:
            if not container.streams.video:
                raise VideoError(
                    f"{video}: expected the overlay of a run, found a file without video."
                )
            yield container, container.streams.video[0]
    except av.FFmpegError as error:
        raise VideoError(
            f"{video}: expected the overlay of a run, found a file that cannot be read "
            f"({error.strerror or error})."
        ) from error
