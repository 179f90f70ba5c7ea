"""Fragmented MP4 files: made ones with telemetry, and one that FFmpeg writes, against its own
reader."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from tests.track_range.recording.telemetry.mp4_files import (
    VIDEO,
    MadeTrack,
    camm_gps,
    fragmented_mp4,
    gps5_payload,
    rmc,
)
from track_range.recording.telemetry.containers.mp4_boxes import read_movie
from track_range.recording.telemetry.found import embedded

TRACKS = {
    "GoPro GPMF": MadeTrack(b"meta", b"gpmd", [gps5_payload([speed]) for speed in (1.0, 2.0, 3.0)]),
    "CAMM": MadeTrack(b"camm", b"camm", [camm_gps(speed, 0) for speed in (1.0, 2.0, 3.0)]),
    "subtitles": MadeTrack(
        b"text", b"tx3g", [rmc(speed / 0.514444, i) for i, speed in enumerate((1.0, 2.0, 3.0))]
    ),
}


@pytest.mark.parametrize("name", TRACKS)
@pytest.mark.parametrize("per_fragment", [1, 2, 20])
def test_telemetry_in_fragments(tmp_path: Path, name: str, per_fragment: int) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(fragmented_mp4([VIDEO, TRACKS[name]], per_fragment=per_fragment))
    track = embedded(path)
    assert track is not None
    assert track.time_s == pytest.approx([0.0, 1.0, 2.0])
    assert track.speed_mps == pytest.approx([1.0, 2.0, 3.0], abs=1e-3)


@pytest.mark.parametrize(
    "flags",
    ["frag_keyframe+empty_moov", "frag_keyframe+empty_moov+default_base_moof", "frag_keyframe"],
)
def test_samples_of_ffmpeg(tmp_path: Path, flags: str) -> None:
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w", options={"movflags": flags}) as container:
        streams = [container.add_stream("mpeg4", rate=rate) for rate in (10, 5)]
        for stream in streams:
            stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
            stream.time_base = Fraction(1, 90_000)
            stream.gop_size = 4
        for i in range(20):
            for stream in streams:
                frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 9 * i, np.uint8))
                container.mux(stream.encode(frame))
        for stream in streams:
            container.mux(stream.encode())
    with path.open("rb") as file:
        movie = read_movie(file)
        assert movie is not None
        tracks = movie.tracks
    with av.open(str(path)) as container:
        rows = [
            (packet.stream.index, packet.pos, packet.size, float(packet.pts * packet.time_base))
            for packet in container.demux()
            if packet.size
        ]
    assert len(tracks) == 2
    for index, track in enumerate(tracks):
        _, offsets, sizes, times_s = zip(*(row for row in rows if row[0] == index), strict=True)
        assert len(track) == 20
        assert track.offsets.tolist() == list(offsets)
        assert track.sizes.tolist() == list(sizes)
        assert track.time_s == pytest.approx(list(times_s), abs=1e-3)
