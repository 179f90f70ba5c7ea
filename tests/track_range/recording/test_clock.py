"""Formats with and without times: what decides is the demuxer, for each raw or image format that FFmpeg
writes here."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from track_range.recording.recording import open_recording
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoError

N_FRAMES = 12
# suffix, FFmpeg's format, codec, its rate; and the rate of the reader, None = it is assumed
FORMATS = (
    ("mjpeg", "mjpeg", "mjpeg", 10, None),
    ("mjpeg", "image2pipe", "mjpeg", 10, None),
    ("png", "image2pipe", "png", 10, None),
    ("mjpg", "mpjpeg", "mjpeg", 10, None),
    ("h261", "h261", "h261", 10, None),
    ("h263", "h263", "h263", 10, None),
    ("h264", "h264", "libx264", 10, 10.0),
    ("hevc", "hevc", "libx265", 10, 10.0),
    ("m2v", "mpeg2video", "mpeg2video", 24, 24.0),
    ("m4v", "m4v", "mpeg4", 10, 10.0),
    ("y4m", "yuv4mpegpipe", "rawvideo", 10, 10.0),
    ("avi", "avi", "mjpeg", 10, 10.0),
    ("gif", "gif", "gif", 10, 10.0),
    ("flv", "flv", "flv", 10, 10.0),
    ("mkv", "matroska", "mjpeg", 10, 10.0),
    ("ts", "mpegts", "mpeg2video", 25, 25.0),
)
PIXELS = {"mjpeg": "yuvj420p", "png": "rgb24", "gif": "rgb8"}


def written(path: Path, name: str, codec: str, rate: int, *, first: int = 0) -> Path:
    """A file of grey images that become lighter."""
    with av.open(str(path), "w", format=name) as container:
        stream = container.add_stream(codec, rate=rate)
        stream.width, stream.height = 352, 288
        stream.pix_fmt = PIXELS.get(codec, "yuv420p")
        for number in range(N_FRAMES):
            image = np.full((288, 352, 3), 20 + 10 * number, np.uint8)
            frame = av.VideoFrame.from_ndarray(image).reformat(format=stream.pix_fmt)
            frame.pts, frame.time_base = first + number, Fraction(1, rate)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(("suffix", "name", "codec", "rate", "read"), FORMATS)
def test_rate_of_a_format(
    tmp_path: Path, suffix: str, name: str, codec: str, rate: int, read: float | None
) -> None:
    path = written(tmp_path / f"film.{suffix}", name, codec, rate)
    video = open_video(path)
    times_s = [frame.time_s for frame in video]
    assert len(times_s) >= N_FRAMES - 1  # the last part of a multipart file has no end
    assert np.diff(times_s) == pytest.approx(1 / (read or 25.0), abs=0.0011)
    is_assumed = any("the images have no times; 25 frames/s" in note for note in video.notes)
    assert is_assumed == (read is None)


@pytest.mark.parametrize(
    ("suffix", "name", "codec"),
    [("mjpeg", "mjpeg", "mjpeg"), ("h264", "h264", "libx264"), ("avi", "avi", "mjpeg")],
)
@pytest.mark.parametrize("keyword", ["fps", "folder_fps"])
def test_given_rate(tmp_path: Path, suffix: str, name: str, codec: str, keyword: str) -> None:
    path = written(tmp_path / f"film.{suffix}", name, codec, 10)
    video = open_video(path, **{keyword: 5.0})
    assert np.diff([frame.time_s for frame in video]) == pytest.approx(0.2)
    assert (video.fps, video.notes) == (5.0, ())


def test_given_rate_of_a_file_with_times(tmp_path: Path) -> None:
    video = open_video(written(tmp_path / "film.mkv", "matroska", "mjpeg", 10), fps=5.0)
    assert np.diff([frame.time_s for frame in video]) == pytest.approx(0.1)
    assert "--fps is left out" in video.notes[0]


def test_rate_that_is_a_clock(tmp_path: Path) -> None:
    video = open_video(written(tmp_path / "film.h264", "h264", "libx264", 1000))
    assert video.fps == 25.0
    assert "25 frames/s are assumed" in video.notes[0]


def test_clock_set_back_far(tmp_path: Path) -> None:
    later, first = tmp_path / "later.ts", tmp_path / "first.ts"
    written(first, "mpegts", "mpeg2video", 25)
    written(later, "mpegts", "mpeg2video", 25, first=2500)
    (tmp_path / "joined.ts").write_bytes(later.read_bytes() + first.read_bytes())
    video = open_video(tmp_path / "joined.ts")
    assert np.diff([frame.time_s for frame in video]).max() < 0.2
    assert any("the clock was set back 1 time" in note for note in video.notes)


def test_several_streams_without_times(tmp_path: Path) -> None:
    for number in (1, 2):
        written(tmp_path / f"{number}.mjpeg", "mjpeg", "mjpeg", 10)
    # equal files count once
    (tmp_path / "2.mjpeg").write_bytes((tmp_path / "2.mjpeg").read_bytes()[:-1] + b"\0")
    video = open_video(tmp_path, fps=10.0)
    assert np.diff([frame.time_s for frame in video]) == pytest.approx(0.1)
    assert [part.start_s for part in video.parts] == pytest.approx([0.0, 1.2])


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("live.m3u8", b"#EXTM3U\n#EXT-X-VERSION:3\na.ts\n", "playlist.*folder that contains them"),
        ("0001.m4s", b"\0\0\0\x18stypmsdh\0\0\0\0", "fragment.*cat init.mp4"),
        ("live.mpd", b'<?xml version="1.0"?>\n<MPD>', "playlist"),
        ("camera.sdp", b"v=0\r\no=- 0 0 IN IP4 1.2.3.4\r\n", "SDP.*address of the stream"),
        ("drive.yuv", bytes(2000), "pixels without a header.*-framerate RATE"),
    ],
)
def test_files_that_are_no_videos(tmp_path: Path, name: str, text: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(text)
    with pytest.raises(VideoError, match=f"{name}: expected a video, found .*{words}"):
        open_video(tmp_path / name)


def test_one_image_is_no_video(tmp_path: Path) -> None:
    path = written(tmp_path / "film.mjpeg", "image2pipe", "mjpeg", 10)
    first = path.read_bytes().split(b"\xff\xd9")[0] + b"\xff\xd9"
    (tmp_path / "one.jpg").write_bytes(first)
    with pytest.raises(VideoError, match=r"one\.jpg: .*a single image"):
        open_video(tmp_path / "one.jpg")


@pytest.mark.parametrize(
    ("depth", "title"),
    [("gray16le", ""), ("gray10le", ""), ("gray", "DEPTH"), ("bgr0", "Thermal 1")],
)
def test_depth_beside_colour(tmp_path: Path, depth: str, title: str) -> None:
    path = tmp_path / "depth.mkv"
    with av.open(str(path), "w") as container:
        colour, other = (container.add_stream(codec, rate=10) for codec in ("mjpeg", "ffv1"))
        for stream, side_px, pixels in ((colour, 64, "yuvj420p"), (other, 128, depth)):
            stream.width, stream.height, stream.pix_fmt = side_px, side_px, pixels
        other.metadata["title"] = title
        for number in range(3):
            for stream in (colour, other):
                frame = av.VideoFrame(stream.width, stream.height, stream.pix_fmt)
                frame.pts, frame.time_base = number, Fraction(1, 10)
                container.mux(stream.encode(frame))
        for stream in (colour, other):
            container.mux(stream.encode(None))
    video = open_video(path)
    assert (video.width_px, video.height_px) == (64, 64)
    assert (
        "video track 1 (128x128 px, depth or infrared by its name or grey values" in video.notes[0]
    )
    assert open_video(path, track=1).width_px == 128
    with pytest.raises(VideoError):  # no pair of tracks
        open_recording(path, stereo_layout="tracks", focal_px=50.0)
