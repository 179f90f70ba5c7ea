"""Time of day of recordings: headers, names of files, and the column utc."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import cv2
import pytest

from track_range.foundation.errors import UsageError
from track_range.recording.recording import open_recording
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.utc import (
    Stamp,
    parsed_utc,
    stamp_in_header,
    stamp_in_name,
    start_of,
)
from track_range.run.options.precedence import settings_from


def seconds(text: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()


@pytest.mark.parametrize(
    ("name", "time", "is_local"),
    [
        ("20260131_142530.mp4", "2026-01-31T14:25:30", True),
        ("2026-01-31_14-25-30-front.mp4", "2026-01-31T14:25:30", True),
        ("2026_0131_142530_001A.MP4", "2026-01-31T14:25:30", True),
        ("20260131142530_000123.MP4", "2026-01-31T14:25:30", True),
        ("PXL_20260131_142530123.mp4", "2026-01-31T14:25:30.123", True),
        ("Screen 2026-01-31 at 14.25.30.mov", "2026-01-31T14:25:30", True),
        ("trip-20250101_20260131T142530Z.mkv", "2026-01-31T14:25:30", False),
        ("20260131T142530+0130.mkv", "2026-01-31T12:55:30", False),
        ("260131_142530_001_FH.MP4", "2026-01-31T14:25:30", True),
        ("FILE260131-142530F.MP4", "2026-01-31T14:25:30", True),
    ],
)
def test_time_in_name(name: str, time: str, is_local: bool) -> None:
    assert stamp_in_name(name) == Stamp(seconds(time), "file name", is_local=is_local)


@pytest.mark.parametrize(
    "name",
    [
        "drive.mp4",
        "GX010123.MP4",
        "20261331_142530.mp4",
        "20260230_142530.mp4",
        "20260131_256199.mp4",
        "1.mp4",
        "123456_123456.mp4",
    ],
)
def test_name_without_time(name: str) -> None:
    assert stamp_in_name(name) is None


@pytest.mark.parametrize(
    "text",
    ["", "1904-01-01T00:00:00.000000Z", "1970-01-01T00:00:00Z", "2026", "2026-13-01T00:00:00Z"],
)
def test_implausible_header(text: str) -> None:
    assert stamp_in_header({"creation_time": text}) is None


def test_header_of_a_phone_with_time_zone() -> None:
    stamp = stamp_in_header(
        {
            "creation_time": "2026-01-31T13:25:31Z",
            "com.apple.quicktime.creationdate": "2026-01-31T14:25:30+0100",
        }
    )
    assert stamp is not None
    assert stamp.time_s == seconds("2026-01-31T13:25:30")
    start = start_of(stamp, stamp_in_name("20260131_142530.mp4"), 60.0)
    assert start is not None
    assert (start.start_s, start.uncertainty_s, start.is_local) == (stamp.time_s, 1.0, False)


@pytest.mark.parametrize("later_s", [0.0, 60.0])
def test_header_that_may_be_local_time(later_s: float) -> None:
    name = stamp_in_name("20260131_142530_F.mp4")
    header = Stamp(
        seconds("2026-01-31T14:25:31") + later_s, "creation time of the video file", is_start=False
    )
    start = start_of(header, name, 60.0)
    assert start is not None
    assert start.is_local
    assert start.uncertainty_s == 14 * 3600
    assert start.start_s == seconds("2026-01-31T14:25:31")
    assert "--start-utc" in (start.note() or "")


def test_name_decides_whether_the_header_states_the_end() -> None:
    name = stamp_in_name("VID_20260131_142530.mp4")  # UTC+1
    for stated, expected, uncertainty_s in (
        ("2026-01-31T13:25:31Z", "2026-01-31T13:25:31", 1.0),  # the start
        ("2026-01-31T13:26:50Z", "2026-01-31T13:25:30", 1.0),  # the end, 80 s later
        ("2026-01-31T13:29:00Z", "2026-01-31T13:29:00", 81.0),  # neither
    ):
        start = start_of(stamp_in_header({"creation_time": stated}), name, 80.0)
        assert start is not None
        assert (start.start_s, start.uncertainty_s) == (seconds(expected), uncertainty_s)
    alone = start_of(stamp_in_header({"creation_time": "2026-01-31T13:26:50Z"}), None, 80.0)
    assert alone is not None
    assert alone.uncertainty_s == 81.0


def test_start_of_a_file_by_its_name(tmp_path: Path, film) -> None:  # type: ignore[no-untyped-def]
    utc = open_video(film(tmp_path / "20260131_142530.mp4", [0.0, 0.1])).utc
    assert utc is not None
    assert utc.summary() == {
        "start": "2026-01-31T14:25:30.000Z",
        "source": "file name",
        "uncertainty_s": 50400.0,
    }
    assert "--start-utc" in (utc.note() or "")
    assert open_video(film(tmp_path / "film.mp4", [0.0, 0.1])).utc is None


def test_time_of_a_run(tmp_path: Path, film) -> None:  # type: ignore[no-untyped-def]
    clip = film(
        tmp_path / "film.mp4", [0.5, 0.6, 0.7], metadata={"creation_time": "2026-01-31T14:25:30Z"}
    )
    for options, start in (
        ({}, "14:25:30"),
        ({"start_utc": "2026-01-31T15:00:00+01:00"}, "14:00:00"),
    ):
        recording = open_recording(clip, focal_px=70.0, start_s=0.1, **options)
        frames = list(recording.frames)
        assert [frame.utc_s - seconds(f"2026-01-31T{start}") for frame in frames] == pytest.approx(
            [0.1, 0.2], abs=1e-5
        )
    frames = list(open_recording(film(tmp_path / "other.mp4", [0.0, 0.1]), focal_px=70.0).frames)
    assert all(math.isnan(frame.utc_s) for frame in frames)


def test_time_of_an_image_folder(tmp_path: Path, level) -> None:  # type: ignore[no-untyped-def]
    for number in range(2):
        cv2.imwrite(str(tmp_path / f"{number:06}.png"), level(number))
    (tmp_path / "timestamps.txt").write_text("2011-09-26 13:02:25.5\n2011-09-26 13:02:25.6\n")
    utc = open_video(tmp_path).utc
    assert utc is not None
    assert (utc.start_s, utc.source, utc.is_local) == (
        seconds("2011-09-26T13:02:25.500"),
        "timestamps.txt",
        True,
    )


def test_start_utc_option() -> None:
    assert parsed_utc("2026-01-31T14:25:30.25+01:00").start_s == seconds("2026-01-31T13:25:30.25")
    assert parsed_utc("2026-01-31 13:25:30").summary()["start"] == "2026-01-31T13:25:30.000Z"
    for text in ("yesterday", "2026-01-31", "1969-12-31T00:00:00Z"):
        with pytest.raises(UsageError, match="start-utc"):
            settings_from({"mono": "a.mp4", "focal_px": 700.0, "start_utc": text})
