"""Videos that are no files, playlists that name other files or addresses, and impossible sizes and
rates."""

from __future__ import annotations

import os
import socket
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.recording.sources.live.address import live_address
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoError

Film = Callable[..., Path]

PLAYLISTS = {
    "hls.mp4": "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{target}\n#EXT-X-ENDLIST\n",
    "hls.m3u8": "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{target}\n#EXT-X-ENDLIST\n",
    "concat.ffconcat": "ffconcat version 1.0\nfile '{target}'\n",
    "concat.mp4": "ffconcat version 1.0\nfile '{target}'\n",
    "session.sdp": "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 "
    "RTP/AVP 32\n",
    "list.xspf": "<playlist><trackList><track><location>{target}</location></track></trackList></playlist>",
    "list.mpd": '<?xml version="1.0"?><MPD><Period><AdaptationSet><Representation id="1"><BaseURL>{target}</BaseURL>'
    "</Representation></AdaptationSet></Period></MPD>",
    "redirect.mov": "rtsptext\n{target}\n",
}


@pytest.fixture
def server() -> Iterator[tuple[str, list[socket.socket]]]:
    """An address that accepts connections, and the connections."""
    connections: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def accept() -> None:
            try:
                while True:
                    connections.append(listener.accept()[0])
            except OSError:
                return

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{listener.getsockname()[1]}/film.ts", connections
        listener.shutdown(socket.SHUT_RDWR)
        thread.join()
    for connection in connections:
        connection.close()


@pytest.mark.parametrize("name", PLAYLISTS)
def test_playlists_open_no_address_and_no_other_file(
    tmp_path: Path, film: Film, server: tuple[str, list[socket.socket]], name: str
) -> None:
    address, connections = server
    segment = film(tmp_path / "segment.ts", [0.0, 0.1])
    os.utime(segment, ns=(1, 1))  # a reading would be seen in the time of access, or succeed
    for target in (address, "segment.ts", f"file://{segment}", str(segment), "file:///etc/passwd"):
        playlist = tmp_path / name
        playlist.write_text(PLAYLISTS[name].format(target=target), encoding="ascii")
        with pytest.raises(VideoError, match="video"):
            open_video(playlist)
    assert not connections
    assert segment.stat().st_atime_ns == 1


def test_pipes_devices_and_folders_without_images(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mp4")
    (tmp_path / "zero.mp4").symlink_to("/dev/zero")
    (tmp_path / "loop").symlink_to("loop")
    for name, words in (
        ("pipe.mp4", "pipe.*udp:"),
        ("zero.mp4", "device"),
        ("loop", "loop"),
        ("no.mp4", "no such"),
    ):
        with pytest.raises(VideoError, match=f"{name}: .*{words}") as error:
            open_video(tmp_path / name)
        assert len(str(error.value)) < 300 + len(str(tmp_path))


def test_odd_entries_of_image_folders(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((48, 64, 3), np.uint8))
    entry = tmp_path / "1.png"
    makers: dict[str, Callable[[], object]] = {
        "pipe": lambda: os.mkfifo(entry),
        "folder": entry.mkdir,
        "loop": lambda: entry.symlink_to("1.png"),
        "no such": lambda: entry.symlink_to("nowhere.png"),
        "device": lambda: entry.symlink_to("/dev/zero"),
    }
    for word, make in makers.items():
        make()
        with pytest.raises(VideoError, match=rf"1\.png: .*{word}"):
            open_video(tmp_path)
        entry.rmdir() if entry.is_dir() else entry.unlink()
    (tmp_path / f"{10**20}.png").write_bytes((tmp_path / "0.png").read_bytes())
    video = open_video(tmp_path)
    assert [(frame.index, frame.time_s) for frame in video] == [(0, 0.0), (1, 0.1)]
    assert "are no frame numbers" in video.notes[0]
    video.close()


@pytest.mark.parametrize(("width_px", "height_px"), [(4, 4), (2, 64)])
def test_tiny_images(tmp_path: Path, width_px: int, height_px: int) -> None:
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((height_px, width_px, 3), np.uint8))
    with pytest.raises(VideoError, match=f"{width_px}x{height_px}"):
        open_video(tmp_path)


def test_huge_announced_frames(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.avi", [0.0, 0.1], codec="mjpeg")
    stored = bytearray(path.read_bytes())
    at = -1
    while (at := stored.find(b"\xff\xc0", at + 1)) > 0:
        stored[at + 5 : at + 9] = struct.pack(">HH", 65_500, 65_500)
    path.write_bytes(stored)
    with pytest.raises(VideoError, match="megapixels"):
        open_video(path)


@pytest.mark.parametrize("rate", [(0, 0), (1, 2**32 - 1), (2**31 - 1, 1), (0, 10)])
def test_impossible_frame_rates(tmp_path: Path, film: Film, rate: tuple[int, int]) -> None:
    path = film(tmp_path / "film.avi", [0.0, 0.1, 0.2], codec="mjpeg")
    stored = bytearray(path.read_bytes())
    at = stored.index(b"strh") + 28  # dwScale, dwRate
    stored[at : at + 8] = struct.pack("<II", *rate)
    path.write_bytes(stored)
    reader = open_video(path)
    frames = list(reader)
    assert len(frames) >= 2
    assert 0 < reader.fps <= 1e5
    assert np.all(np.diff([frame.time_s for frame in frames]) > 0)


@pytest.mark.skipif(sys.platform != "linux", reason="devices of Linux")
def test_devices_are_cameras_only_if_they_are() -> None:
    address = live_address("/dev/zero")
    assert address is not None
    assert address.is_camera  # its opening fails at once, since /dev/zero is no camera
