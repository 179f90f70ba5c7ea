import math

import numpy as np
import pytest

from tests.track_range.recording.telemetry.telemetry_files import LATITUDE, START_S, gpx_text, rmc
from track_range.recording.telemetry.checks import usable
from track_range.recording.telemetry.sidecars.reading import read_sidecar, sidecar_names
from track_range.recording.telemetry.tracks.track import TelemetryError


def read(tmp_path, name, text, *, video="drive.mp4", duration_s=20.0):
    path = tmp_path / name
    path.write_text(text)
    return read_sidecar(path, video, duration_s)


def test_gpx_speed_of_extensions(tmp_path):
    track = read(tmp_path, "a.gpx", gpx_text([5, 6, 7.5], field="speed"))
    assert track.speed_mps.tolist() == [5, 6, 7.5]
    assert track.time_s.tolist() == [START_S, START_S + 1, START_S + 2]
    assert track.clock == "utc"


def test_gpx_speed_from_positions(tmp_path):
    track = read(tmp_path, "a.gpx", gpx_text([10.0, 10.0, 20.0, 20.0]))
    assert track.speed_mps == pytest.approx([10, 10, 20], abs=0.01)
    assert track.course_rad == pytest.approx([0, 0, 0], abs=1e-6)
    assert not track.has_own_speed


@pytest.mark.parametrize(("unit", "factor"), [("km/h", 3.6), ("mph", 2.23694), ("kn", 1.94384)])
def test_gpx_in_another_unit(tmp_path, unit, factor):
    track = usable(read(tmp_path, "a.gpx", gpx_text([10.0] * 20, field="speed", factor=factor)))
    assert track.speed_mps == pytest.approx([10.0] * 20, rel=0.01)
    assert unit in track.notes[0]


def test_gpx_that_contradicts_itself(tmp_path):
    with pytest.raises(TelemetryError, match="contradict"):
        usable(read(tmp_path, "a.gpx", gpx_text([10.0] * 20, field="speed", factor=1.4)))


@pytest.mark.parametrize(
    ("speeds", "factor", "n_notes"),
    [([8.0] * 5, 3.6, 1), ([2.0] * 20, 3.6, 1), ([2.0] * 20, 1.0, 0)],
)
def test_gpx_with_an_unknown_unit(tmp_path, speeds, factor, n_notes):
    track = usable(read(tmp_path, "a.gpx", gpx_text(speeds, field="speed", factor=factor)))
    assert track.speed_mps == pytest.approx(np.array(speeds) * factor)
    assert len(track.notes) == n_notes
    assert all("no unit" in note for note in track.notes)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "XML"),
        ("<gpx", "XML"),
        ("\0\1", "UTF-8"),
        ("<gpx></gpx>", "points"),
        (gpx_text([1, 2]).replace("2026-05-03T10:00:00Z", "yesterday"), "times"),
        (gpx_text([1]), "two positions"),
        ('<!DOCTYPE gpx [<!ENTITY a "aaaa">]><gpx>&a;</gpx>', "document type"),
        ("<gpx>" + "<a>" * 40 + "</a>" * 40 + "</gpx>", "nested"),
        ("<gpx>" + " xmlns" * 200 + "</gpx>", "namespaces"),
    ],
)
def test_gpx_that_cannot_be_read(tmp_path, text, word):
    with pytest.raises(TelemetryError, match=word) as error:
        read(tmp_path, "a.gpx", text)
    assert "a.gpx" in str(error.value)
    assert str(LATITUDE) not in str(error.value)


def test_nmea(tmp_path):
    track = read(
        tmp_path,
        "a.nmea",
        "\n".join([rmc(0, 10), "$GPGGA,1,2", rmc(1, 20), rmc(2, "", status="V")]),
    )
    assert track.speed_mps[:2] == pytest.approx([5.144, 10.289], abs=1e-3)
    assert math.isnan(track.speed_mps[2])
    assert track.time_s.tolist() == [START_S, START_S + 1, START_S + 2]
    assert track.course_rad[0] == pytest.approx(math.pi / 2)


def test_nmea_with_wrong_checksums(tmp_path):
    wrong = rmc(1, 99).replace("*", "*0")[:-1]
    assert len(read(tmp_path, "a.nmea", "\n".join([rmc(0, 10), wrong, rmc(2, 10)]))) == 2
    all_wrong = "\n".join(rmc(i, 10).partition("*")[0] + "*00" for i in range(3))
    assert len(read(tmp_path, "b.nmea", all_wrong)) == 3


def test_files_without_telemetry(tmp_path):
    assert read(tmp_path, "a.nmea", "$GPGSV,1,1\nhello\n") is None
    assert read(tmp_path, "a.txt", "notes about the drive\n") is None
    assert read(tmp_path, "a.csv", "frame,id,x1\n0,1,2\n") is None
    assert (
        read(
            tmp_path,
            "a.srt",
            "1\n00:00:01,000 --> 00:00:02,000\nHe drove at 100 km/h.\n\n2\n00:00:03,000 --> "
            "00:00:04,000\nAnd then?\n\n3\n00:00:05,000 --> 00:00:06,000\nHe slept.\n",
        )
        is None
    )


def srt(*texts):
    return "\n\n".join(
        f"{i + 1}\n00:00:{i:02d},000 --> 00:00:{i + 1:02d},000\n{text}"
        for i, text in enumerate(texts)
    )


@pytest.mark.parametrize(
    ("text", "expected_mps"),
    [
        (
            "F/2.8, SS 206, ISO 150, GPS (-122.3699, 37.5929, 14), D 2.75m, H 2.5m, H.S 5.00m/s, "
            "V.S 9.00m/s",
            5.0,
        ),
        ("2026-05-03 10:00:00 N48.1 E9.6 36 km/h", 10.0),
        ("Speed: 10 MPH", 4.4704),
        ("43,2 km/h", 12.0),
        ("Limit 50 km/h Speed 36 km/h", 10.0),
        ("Wind: 5.0 m/s, max 120 km/h, accel 9.8 m/s2, 36 km/h", 10.0),
        ('<font size="28">speed 7.5 m/s</font>', 7.5),
        (rmc(0, 10), 5.1444),
    ],
)
def test_srt_speeds(tmp_path, text, expected_mps):
    track = read(tmp_path, "a.srt", srt(text, text, text))
    assert track.speed_mps == pytest.approx([expected_mps] * 3, abs=1e-3)
    assert track.time_s.tolist() == [0.0, 1.0, 2.0]
    assert track.clock == "video"


def test_srt_with_positions_only(tmp_path):
    texts = [
        f"[latitude: {LATITUDE + i * 10 / 111_195.08:.8f}] [longitude: 9.654321] [rel_alt: 1.0]"
        for i in range(5)
    ]
    assert read(tmp_path, "a.srt", srt(*texts)).speed_mps == pytest.approx([10.0] * 4, abs=0.01)


def test_srt_without_unit(tmp_path):
    with pytest.raises(TelemetryError, match="unit"):
        read(tmp_path, "a.srt", srt("speed: 50", "speed: 51", "speed: 52"))


@pytest.mark.parametrize(
    ("header", "rows", "clock"),
    [
        ("time_s,Speed (km/h)", ["0,36", "1,36"], "video"),
        ("time_s,max_speed_kmh,lead_speed_mps,speed_kmh", ["0,90,9,36", "1,90,9,36"], "video"),
        (
            "timestamp,speed_mps,lat,lon",
            [f"{START_S:.0f},10,1,1", f"{START_S + 1:.0f},10,1,1"],
            "utc",
        ),
        (
            "utc,GPS speed [kn]",
            ["2026-05-03T10:00:00Z,19.4384", "2026-05-03T10:00:01Z,19.4384"],
            "utc",
        ),
        ("date,speed_mph", ["2026/05/03 10:00:00,22.3694", "2026/05/03 10:00:01,22.3694"], "local"),
        (
            "cts,date,GPS (2D speed) [m/s]",
            ["0,2026-05-03T10:00:00Z,10", "1000,2026-05-03T10:00:01Z,10"],
            "utc",
        ),
    ],
)
def test_csv_headings(tmp_path, header, rows, clock):
    track = read(tmp_path, "a.csv", "\n".join([header, *rows]))
    assert track.speed_mps == pytest.approx([10, 10], abs=1e-3)
    assert track.clock == clock
    assert track.time_s[0] == (0.0 if clock == "video" else START_S)


def test_csv_without_unit(tmp_path):
    with pytest.raises(TelemetryError, match="unit"):
        read(tmp_path, "a.csv", "time_s,speed\n0,10\n1,10\n")
    rows = [f"{i},36,{LATITUDE + i * 10 / 111_195.08:.8f},9.6" for i in range(20)]
    track = read(tmp_path, "b.csv", "\n".join(["time_s,speed,latitude,longitude", *rows]))
    assert track.speed_mps == pytest.approx([10.0] * 20)
    assert "km/h" in track.notes[0]


def test_seventymai_rows_of_one_video(tmp_path):
    first, second = "NO20260503-100000-000001F.MP4", "NO20260503-100100-000002F.MP4"
    rows = [
        f"{1777802400 + i},A,48.1,9.6,9000,{1000 + i},0,0,0,{first if i < 3 else second},0,0,0"
        for i in range(6)
    ]
    text = "\n".join(["$V02", *rows])
    track = read(tmp_path, "GPSData000001.txt", text, video=second, duration_s=3.0)
    assert track.speed_mps == pytest.approx([10.03, 10.04, 10.05])
    assert track.time_s.tolist() == [0.0, 1.0, 2.0]
    assert track.course_rad == pytest.approx([math.pi / 2] * 3)
    before = read(tmp_path, "b.txt", text, video=first, duration_s=60.0)
    assert before.time_s.tolist() == [57.0, 58.0, 59.0]


def test_names_of_sidecars():
    names = sidecar_names("20260718_060329_NF.mp4")
    assert {"20260718_060329_NF.gpx", "20260718_060329_N.gps", "20260718_060329_NF.NMEA"} <= set(
        names
    )
    assert names.index("20260718_060329_NF.gpx") < names.index("20260718_060329_NF.srt")


@pytest.mark.real
def test_real_sidecars(shared_data):
    folder = shared_data / "telemetry/sidecars"
    blackvue = read_sidecar(folder / "blackvue.gps", "a.mp4", 60.0)
    assert blackvue.speed_mps[0] == pytest.approx(48.0 * 0.514444, abs=1e-3)
    assert math.degrees(blackvue.course_rad[0]) == pytest.approx(145.2)
    assert len(read_sidecar(folder / "mivue.NMEA", "a.mp4", 60.0)) == 7
    drawn = read_sidecar(folder / "sf_30km_h.gpx", "a.mp4", 60.0)
    assert np.median(drawn.speed_mps) == pytest.approx(8.33, abs=0.02)
    assert usable(drawn).speed_mps.max() < 10
    mai = read_sidecar(folder / "70mai-a810.txt", "NO20260712-195604-000001F.MP4", 60.0)
    assert len(mai) == 41
    assert mai.speed_mps.max() < 1


@pytest.mark.real
@pytest.mark.parametrize(("name", "n"), [("fusion", 275), ("hero05", 618), ("hero06", 417)])
def test_real_gpx(shared_data, name, n):
    track = usable(read_sidecar(shared_data / f"telemetry/gopro/{name}.gpx", "a.mp4", 60.0))
    assert len(track) == n
