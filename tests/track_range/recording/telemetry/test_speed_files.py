import math
import re

import numpy as np
import pytest

from track_range.recording.telemetry.speed_files import EgoSpeedError, open_ego_speed
from track_range.stereo.speed.ego_speed import EgoSpeed

OXTS = "49.0 8.4 114.1 0.03 0.02 1.8 5.5 -3.2 {speed} " + " ".join(["0.1"] * 21)


def csv_file(tmp_path, text):
    path = tmp_path / "speed.csv"
    path.write_text(text)
    return str(path)


def oxts_folder(tmp_path, *, inside="oxts", n=3, times=None):
    folder = tmp_path / inside
    folder.mkdir(parents=True)
    for i in range(n):
        (folder / f"{i:010d}.txt").write_text(OXTS.format(speed=10 + i))
    (folder / "dataformat.txt").write_text("vf: forward velocity")
    times = (
        [f"2011-09-26 13:10:51.{100 + 104 * i:03d}000000" for i in range(n)]
        if times is None
        else times
    )
    (tmp_path / "timestamps.txt").write_text("\n".join(times) + "\n")
    return folder


def test_number_is_a_constant_in_kmh():
    ego = open_ego_speed("50")
    assert ego.at(0.0) == ego.at(1e6) == pytest.approx(13.889, abs=1e-3)
    assert ego.note(100.0) is None


@pytest.mark.parametrize(
    ("unit", "factor"), [("speed_mps", 1.0), ("speed_kmh", 1 / 3.6), (" Speed_KMH ", 1 / 3.6)]
)
def test_header_gives_the_unit(tmp_path, unit, factor):
    ego = open_ego_speed(csv_file(tmp_path, f"brake,time_s,{unit}\n0,1.0,10\n1,2.0,20\n"))
    assert ego.at(1.5) == pytest.approx(15 * factor)
    assert ego.at(1.0) == pytest.approx(10 * factor)
    assert ego.at(2.2) == pytest.approx(20 * factor)


def test_speed_over_ground_is_that_of_the_vehicle(tmp_path):
    path = tmp_path / "speed.csv"
    path.write_text("time_s,speed_mps,speed_over_ground_mps\n0,5,10\n1,6,12\n")
    along = open_ego_speed(str(path))
    assert (along.at(0.5), along.of_vehicle().at(0.5)) == (5.5, 11.0)
    path.write_text("time_s,speed_mps\n0,5\n1,6\n")
    assert open_ego_speed(str(path)).of_vehicle().at(0.5) == 5.5


def test_unknown_outside_the_file_and_in_long_gaps(tmp_path):
    ego = open_ego_speed(csv_file(tmp_path, "time_s,speed_mps\n0,10\n1,10\n9,10\n10,12\n"))
    assert [math.isnan(ego.at(t)) for t in (-0.3, -0.2, 0.5, 5.0, 9.5, 10.2, 10.3)] == [
        1,
        0,
        0,
        1,
        0,
        0,
        1,
    ]
    assert ego.note(10.2) is None
    assert "speed.csv covers 0.0-10.0 s of the video" in ego.note(30.0)


def test_note_on_a_late_first_sample(tmp_path):
    assert "covers 2.0-3.0 s" in open_ego_speed(
        csv_file(tmp_path, "time_s,speed_mps\n2,10\n3,10\n")
    ).note(3.0)


@pytest.mark.parametrize("inside", ["oxts", "oxts/data"])
def test_oxts_timestamps_in_or_next_to_the_folder(tmp_path, inside):
    folder = oxts_folder(
        tmp_path / "oxts" if inside.endswith("data") else tmp_path, inside=inside.rpartition("/")[2]
    )
    ego = open_ego_speed(str(folder.parent if inside.endswith("data") else folder))
    assert ego.speed_mps.tolist() == [10.0, 11.0, 12.0]
    assert ego.time_s == pytest.approx([0.0, 0.104, 0.208])


def test_oxts_of_part_of_a_drive(tmp_path):
    folder = oxts_folder(tmp_path)
    (folder / f"{0:010d}.txt").unlink()
    assert open_ego_speed(str(folder)).time_s == pytest.approx([0.104, 0.208])


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "header"),
        ("time_s,speed_mps\n", "row"),
        ("time_s,speed\n0,10\n", "time_s,speed"),
        ("time_s,speed_mps,speed_kmh\n0,10,36\n", "either"),
        ("frame,speed_mps\n0,10\n", "time_s"),
        ("0.0,10.0\n0.1,10.1\n", "0.0,10.0"),
        ("time_s,speed_mps\n0,fast\n", "'fast'"),
        ("time_s,speed_mps\n0,9,66\n", "decimals with a point"),
        ("time_s,speed_mps,\n0,9,66\n", "name in the header"),
        ('time_s,speed_mps\n0,"9,66"\n', "'9,66'; write decimals with a point"),
        ("time_s,speed_mps\n0,1,,\n", "2 cells"),
        ("time_s,speed_mps\n0,1_0\n", "'1_0'"),
        ("time_s,speed_mps\n0,\u0663\n", "finite"),
        ("time_s,speed_mps\n0,1e308\n", "432 km/h"),
        ("time_s,speed_mps\n1e11,1\n", "time_s"),
        ('time_s,speed_mps\n0,"1\n', "quotation"),
        ("time_s,speed_mps\n0,10\n1\n", "line 3: "),
        ("time_s,speed_mps\n0,nan\n", "line 2: "),
        ("time_s,speed_mps\n0,10\n0,10\n", "increase"),
        ("time_s,speed_mps\n0,130\n", "468 km/h"),
    ],
)
def test_invalid_csv_files(tmp_path, text, word):
    path = csv_file(tmp_path, text)
    with pytest.raises(EgoSpeedError, match=re.escape(word)) as error:
        open_ego_speed(path)
    assert "speed.csv" in str(error.value)


def test_invalid_arguments(tmp_path):
    for argument, word in (
        ("fifty", "fifty: .*km/h"),
        ("500", "500 km/h"),
        ("nan", "nan km/h"),
        ("9,66", "decimals with a point"),
        ("1_0", "1_0: no such file"),
        ("x" * 300, "no such file"),
        (str(tmp_path), "0000000000.txt"),
    ):
        with pytest.raises(EgoSpeedError, match=word):
            open_ego_speed(argument)
    (tmp_path / "picture.csv").write_bytes(b"\x89PNG\xff\xfe\x00")
    with pytest.raises(EgoSpeedError, match="CSV"):
        open_ego_speed(str(tmp_path / "picture.csv"))


def test_file_without_read_permission(tmp_path, monkeypatch):
    path = csv_file(tmp_path, "time_s,speed_mps\n0,1\n")

    def deny(*_args, **_kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("os.open", deny)  # file modes do not stop a test run by root
    with pytest.raises(EgoSpeedError, match="Permission denied"):
        open_ego_speed(path)


def test_invalid_oxts(tmp_path):
    for name, damage, word in (
        ("a", lambda f: (f.parent / "timestamps.txt").unlink(), "timestamps.txt"),
        ("b", lambda f: (f.parent / "timestamps.txt").write_text("noon\n"), "noon"),
        (
            "c",
            lambda f: (f.parent / "timestamps.txt").write_text("2011-09-26 13:10:51.1\n"),
            "1 lines",
        ),
        (
            "d",
            lambda f: (f.parent / "timestamps.txt").write_text("2011-09-26 13:10:51.1\n" * 3),
            "increase",
        ),
        ("e", lambda f: (f / "0000000001.txt").write_text("1 2 3"), "0000000001.txt: .* 3 numbers"),
        ("f", lambda f: (f / "0000000001.txt").write_text("a " * 30), "0000000001.txt: .*'a'"),
    ):
        folder = oxts_folder(tmp_path / name)
        damage(folder)
        with pytest.raises(EgoSpeedError, match=word):
            open_ego_speed(str(folder))


def test_kitti_oxts(shared_data):
    folder = shared_data / "kitti_stereo" / "0003" / "oxts"
    if not folder.is_dir():
        pytest.skip(f"real data not here: no folder {folder}")
    ego = open_ego_speed(str(folder))
    assert ego.time_s[-1] == pytest.approx(1.5531, abs=1e-3)  # 16 frames, 0.1035 s apart
    assert ego.at(0.0) == pytest.approx(11.842, abs=1e-3)
    assert ego.at(0.7) == pytest.approx(11.60, abs=0.01)
    assert (np.diff(ego.speed_mps) < 0).all()


def test_speed_from_poses(shared_data):
    """Speed from the forward steps between the poses of a drive."""
    path = shared_data / "kitti_odometry" / "gray51" / "poses.txt"
    if not path.is_file():
        pytest.skip(f"real data not here: no file {path}")
    z_m = np.loadtxt(path)[:, 11]
    ego = EgoSpeed(0.1036 * np.arange(len(z_m)), np.gradient(z_m, 0.1036), "poses")
    assert ego.at(0.2) == pytest.approx((z_m[3] - z_m[1]) / 0.2072, rel=0.05)
