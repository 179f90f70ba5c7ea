"""Telemetry inside real recordings, against the points and speeds that their sources state."""

from __future__ import annotations

import csv
from datetime import UTC, datetime
from pathlib import Path

import av
import numpy as np
import pytest

from track_range.recording.telemetry.checks import usable
from track_range.recording.telemetry.containers.gpmf import gps_rows
from track_range.recording.telemetry.containers.mp4_boxes import read_movie
from track_range.recording.telemetry.found import embedded
from track_range.recording.telemetry.tracks.track import TelemetryError, TelemetryTrack

KNOT = 1852 / 3600


def read(shared_data: Path, name: str) -> TelemetryTrack:
    content = embedded(shared_data / "telemetry" / name)
    assert content is not None
    return content


def points(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.mark.parametrize(
    ("name", "n"),
    [("fusion", 275), ("hero05", 618), ("hero06", 417), ("hero06+ble", 199), ("hero11", 1358)],
)
def test_gopro_points(shared_data: Path, name: str, n: int) -> None:
    folder = shared_data / "telemetry" / "gopro"
    rows = points(folder / f"{name}.csv")
    read_rows = list(gps_rows((folder / f"{name}.bin").read_bytes()))
    values = np.concatenate([part.values for part in read_rows])
    expected = np.array(
        [
            [float(row[key]) for key in ("latitude", "longitude", "elevation", "speed")]
            for row in rows
        ]
    )
    assert len(values) == len(expected) == n
    assert np.abs(values[:, :4] - expected).max() < 1e-6
    keys = [part.key for part in read_rows for _ in part.values]
    assert keys == [row["name"] for row in rows]


@pytest.mark.parametrize("name", ["fusion", "hero05", "hero06", "hero11"])
def test_gopro_dates(shared_data: Path, name: str) -> None:
    rows = points(shared_data / "telemetry" / "gopro" / f"{name}.csv")
    track = read(shared_data, f"gopro/{name}.bin")
    key = "GPS9" if name == "hero11" else "GPS5"
    expected = [
        datetime.fromisoformat(row["time"]).timestamp() for row in rows if row["name"] == key
    ]
    assert track.clock == "utc"
    # the rows of a payload are spread over its true duration here, and at 18 Hz there
    assert np.abs(track.time_s - expected).max() < 0.06


def test_gopro_without_fix(shared_data: Path) -> None:
    for name in ("gopro/hero06+ble.bin", "gopro/hero8-trimmed.mp4"):
        track = read(shared_data, name)
        assert np.isnan(track.speed_mps).all()
        assert np.isnan(track.latitude_deg).all()
    partly = read(shared_data, "gopro/hero06.bin")
    assert 0 < np.isnan(partly.speed_mps).sum() < len(partly)


@pytest.mark.parametrize(
    ("name", "n", "first_mps", "last_s"),
    [("hero5-trimmed", 36, 0.167, 2), ("max-heromode", 191, 1.046, 10.5)],
)
def test_gopro_videos(
    shared_data: Path, name: str, n: int, first_mps: float, last_s: float
) -> None:
    track = read(shared_data, f"gopro/{name}.mp4")
    assert (len(track), track.clock) == (n, "video")
    assert track.speed_mps[0] == pytest.approx(first_mps)
    assert track.time_s[0] == 0
    assert last_s - 0.1 < track.time_s[-1] < last_s


@pytest.mark.parametrize(
    ("name", "speeds_kn"),
    [
        ("novatek-2e.mp4", [48.59, 48.96, 49.19]),
        ("viofo-coldstart.mp4", [np.nan] * 4 + [3.39, 10.38, 10.38, 10.38]),
        ("vantrue-n2x.mp4", [10.0] * 3),
    ],
)
def test_dashcam_speeds(shared_data: Path, name: str, speeds_kn: list[float]) -> None:
    track = read(shared_data, f"dashcams/{name}")
    assert track.speed_mps / KNOT == pytest.approx(speeds_kn, abs=0.006, nan_ok=True)
    assert track.clock == "video"


def test_dashcam_dates(shared_data: Path) -> None:
    novatek = read(shared_data, "dashcams/novatek-2e.mp4")
    assert novatek.utc_s[0] == datetime(2021, 10, 13, 15, 37, 57, tzinfo=UTC).timestamp()
    jump = read(shared_data, "dashcams/viofo-coldstart.mp4")
    assert np.diff(jump.utc_s).max() == 3 * 3600 + 1


@pytest.mark.parametrize(
    ("name", "n", "first_mps"),
    [
        ("viofo-a119v3.TS", 10, 0.01 * KNOT),
        ("70mai-a810.mp4", 12, 45 / 3.6),
        ("thinkware.mp4", 10, 14.101 * KNOT),
        ("ligogps.mp4", 180, 19 / 3.6),
    ],
)
def test_dashcam_records(shared_data: Path, name: str, n: int, first_mps: float) -> None:
    track = read(shared_data, f"dashcams/{name}")
    assert len(track) == n
    assert track.speed_mps[0] == pytest.approx(first_mps, rel=1e-3)
    assert np.diff(track.time_s).mean() == pytest.approx(1, abs=0.15)


def test_neoline_states_its_false_speed(shared_data: Path) -> None:
    track = read(shared_data, "dashcams/neoline-parked-false-speed.mp4")
    kmh = track.speed_mps * 3.6
    assert len(track) == 192
    assert 113 < np.nanmedian(kmh) < 137
    assert np.mean((kmh > 112) & (kmh < 138)) * 192 >= 55
    assert np.isnan(kmh).sum() == 120


def test_tables_agree_with_pyav(shared_data: Path) -> None:
    path = shared_data / "telemetry" / "gopro" / "max-heromode.mp4"
    with path.open("rb") as file:
        movie = read_movie(file)
    assert movie is not None
    with av.open(str(path)) as container:
        packets = {index: [] for index in range(len(container.streams))}
        for packet in container.demux():
            if packet.size:
                packets[packet.stream.index].append(
                    (float(packet.pts * packet.time_base), packet.size, packet.pos)
                )
    compared = [
        (track, content)
        for track, content in zip(movie.tracks, packets.values(), strict=True)
        if content
    ]
    assert len(compared) >= 3
    for track, content in compared:
        time_s, sizes, offsets = np.array(content).T
        assert track.sizes.tolist() == sizes.tolist()
        assert track.offsets.tolist() == offsets.tolist()
        assert track.time_s == pytest.approx(time_s, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("gopro/hero06+ble.bin", "fix"),
        ("gopro/hero8-trimmed.mp4", "fix"),
        ("dashcams/viofo-coldstart.mp4", "clock"),
        ("dashcams/neoline-parked-false-speed.mp4", "loses"),
    ],
)
def test_refused_recordings(shared_data: Path, name: str, reason: str) -> None:
    with pytest.raises(TelemetryError, match=reason):
        usable(read(shared_data, name))


@pytest.mark.parametrize(
    "name",
    [
        *(
            "gopro/fusion.bin",
            "gopro/hero05.bin",
            "gopro/hero06.bin",
            "gopro/hero11.bin",
            "gopro/hero5-trimmed.mp4",
        ),
        *(
            "gopro/max-heromode.mp4",
            "dashcams/70mai-a810.mp4",
            "dashcams/ligogps.mp4",
            "dashcams/novatek-2e.mp4",
        ),
        *("dashcams/thinkware.mp4", "dashcams/vantrue-n2x.mp4", "dashcams/viofo-a119v3.TS"),
    ],
)
def test_accepted_recordings(shared_data: Path, name: str) -> None:
    track = read(shared_data, name)
    assert len(usable(track)) >= len(track) - 1  # one second of ligogps is twice in the file
