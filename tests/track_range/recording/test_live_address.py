"""Tests of the recognition of cameras and streams by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from track_range.recording.sources.live.address import LiveAddress, live_address


@pytest.mark.parametrize(
    ("name", "url"),
    [
        ("0", "/dev/video0"),
        ("12", "/dev/video12"),
        ("rtsp://10.0.0.7/stream1", "rtsp://10.0.0.7/stream1"),
        ("RTSP://10.0.0.7:554//h264_main?x=1", "RTSP://10.0.0.7:554//h264_main?x=1"),
        ("http://localhost:8080/video", "http://localhost:8080/video"),
        ("/dev/null", "/dev/null"),
    ],
)
def test_cameras_and_streams(name: str, url: str) -> None:
    address = live_address(name)
    assert address is not None
    assert address.url == url


@pytest.mark.parametrize(
    "name",
    ["left.mp4", "drive/left", "1234", "-1", "1a", "file:///x.mp4", "C://left.mp4", "a" * 5000],
)
def test_files_and_folders(name: str) -> None:
    assert live_address(name) is None


def test_folder_with_a_number_as_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "0").mkdir()
    assert live_address("0") is None
    assert live_address("1") is not None


def test_credentials_are_hidden() -> None:
    address = LiveAddress("rtsp://me:secret@10.0.0.7:554/a/b?c=d")
    assert str(address) == "rtsp://10.0.0.7:554/a/b?c=d"
    assert "secret" not in address.stem
    assert address.url == "rtsp://me:secret@10.0.0.7:554/a/b?c=d"


@pytest.mark.parametrize(
    ("url", "stem"),
    [
        ("/dev/video0", "video0"),
        ("rtsp://u:p@10.0.0.7/stream1", "10-0-0-7-stream1"),
        ("tcp://", "live"),
    ],
)
def test_stem(url: str, stem: str) -> None:
    assert LiveAddress(url).stem == stem


def test_invalid_addresses_hide_credentials() -> None:
    for url in ("http://[::1/x", "rtsp://me:secret@[", "tcp://@"):
        assert "secret" not in str(LiveAddress(url))
        assert LiveAddress(url).stem


def test_cameras_and_options_of_ffmpeg() -> None:
    assert (LiveAddress("/dev/video0").is_camera, LiveAddress("/dev/video0").options) == (True, {})
    assert LiveAddress("rtsps://h/s").options["rtsp_transport"] == "tcp"
    assert "rtsp_transport" not in LiveAddress("http://h/s").options
    assert not LiveAddress("http://h/s").is_camera


@pytest.mark.parametrize(
    "url",
    [
        "rtsp://me:p#secret@host/s",
        "rtsp://me:p/secret@host/s",
        "rtsp://me:p?secret@host/s",
        "rtsp://h/s?a=b&password=secret",
    ],
)
def test_credentials_with_special_characters_are_hidden(url):
    assert "secret" not in str(LiveAddress(url))
    assert str(LiveAddress(url)).startswith("rtsp://h")
