import math
import re

import numpy as np
import pytest

from track_range.ranging.ego_speed import EgoSpeed, EgoSpeedError, open_ego_speed

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
    times = [f"2011-09-26 13:10:51.{100 + 104 * i:03d}000000" for i in range(n)] if times is None else times
    (tmp_path / "timestamps.txt").write_text("\n".join(times) + "\n")
    return folder


def test_a_number_is_km_per_h_for_ever():
    ego = open_ego_speed("50")
    assert ego.at(0.0) == ego.at(1e6) == pytest.approx(13.889, abs=1e-3)
    assert ego.note(100.0) is None


@pytest.mark.parametrize(("unit", "factor"), [("speed_mps", 1.0), ("speed_kmh", 1 / 3.6), (" Speed_KMH ", 1 / 3.6)])
def test_the_header_tells_the_unit(tmp_path, unit, factor):
    ego = open_ego_speed(csv_file(tmp_path, f"brake,time_s,{unit}\n0,1.0,10\n1,2.0,20\n"))
    assert ego.at(1.5) == pytest.approx(15 * factor)
    assert ego.at(1.0) == pytest.approx(10 * factor)
    assert ego.at(2.2) == pytest.approx(20 * factor)


def test_outside_of_the_file_and_in_long_holes_nothing_is_known(tmp_path):
    ego = open_ego_speed(csv_file(tmp_path, "time_s,speed_mps\n0,10\n1,10\n9,10\n10,12\n"))
    assert [math.isnan(ego.at(t)) for t in (-0.3, -0.2, 0.5, 5.0, 9.5, 10.2, 10.3)] == [1, 0, 0, 1, 0, 0, 1]
    assert ego.note(10.2) is None
    assert ego.note(30.0) == (
        "The ego speed of speed.csv covers 0.0-10.0 s of the video's 0.0-30.0 s; for the rest closing speeds come from "
        "the distances alone."
    )


def test_a_file_that_begins_late_is_told_too(tmp_path):
    assert "covers 2.0-3.0 s" in open_ego_speed(csv_file(tmp_path, "time_s,speed_mps\n2,10\n3,10\n")).note(3.0)


@pytest.mark.parametrize("inside", ["oxts", "oxts/data"])
def test_oxts_with_timestamps_beside_or_above(tmp_path, inside):
    folder = oxts_folder(tmp_path / "oxts" if inside.endswith("data") else tmp_path, inside=inside.rpartition("/")[2])
    ego = open_ego_speed(str(folder.parent if inside.endswith("data") else folder))
    assert ego.speed_mps.tolist() == [10.0, 11.0, 12.0]
    assert ego.time_s == pytest.approx([0.0, 0.104, 0.208])


def test_oxts_of_a_part_of_the_drive_keeps_its_times(tmp_path):
    folder = oxts_folder(tmp_path)
    (folder / f"{0:010d}.txt").unlink()
    assert open_ego_speed(str(folder)).time_s == pytest.approx([0.104, 0.208])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "a header such as"),
        ("time_s,speed_mps\n", "at least one row"),
        ("time_s,speed\n0,10\n", "its header is 'time_s,speed'"),
        ("time_s,speed_mps,speed_kmh\n0,10,36\n", "unit"),
        ("frame,speed_mps\n0,10\n", "the columns time_s and either"),
        ("0.0,10.0\n0.1,10.1\n", "its header is '0.0,10.0'"),
        ("time_s,speed_mps\n0,fast\n", "'fast'"),
        ("time_s,speed_mps\n0,10\n1\n", "line 3: "),
        ("time_s,speed_mps\n0,nan\n", "line 2: expected a finite number"),
        ("time_s,speed_mps\n0,10\n0,10\n", "the times must rise"),
        ("time_s,speed_mps\n0,130\n", "468 km/h is no speed of a car; is the unit right?"),
    ],
)
def test_a_file_that_cannot_be_used(tmp_path, text, told):
    with pytest.raises(EgoSpeedError, match=re.escape(told)):
        open_ego_speed(csv_file(tmp_path, text))


def test_what_is_no_speed_file_or_folder(tmp_path):
    for word, told in (
        ("fifty", "no such file; a speed in km/h"),
        ("500", "500 km/h is no speed"),
        ("nan", "nan km/h is no speed"),
        (str(tmp_path), "no files such as 0000000000.txt"),
    ):
        with pytest.raises(EgoSpeedError, match=told):
            open_ego_speed(word)
    (tmp_path / "picture.csv").write_bytes(b"\x89PNG\xff\xfe\x00")
    with pytest.raises(EgoSpeedError, match="CSV"):
        open_ego_speed(str(tmp_path / "picture.csv"))


def test_a_file_that_may_not_be_read(tmp_path, monkeypatch):
    path = csv_file(tmp_path, "time_s,speed_mps\n0,1\n")

    def refuses(*_args, **_kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.open", refuses)  # whoever runs the tests may be allowed everything
    with pytest.raises(EgoSpeedError, match=r"cannot be read .Permission denied"):
        open_ego_speed(path)


def test_oxts_that_cannot_be_used(tmp_path):
    for name, break_it, told in (
        ("a", lambda f: (f.parent / "timestamps.txt").unlink(), "no timestamps.txt in it or beside it"),
        ("b", lambda f: (f.parent / "timestamps.txt").write_text("noon\n"), "lines such as '2011-09-26"),
        ("c", lambda f: (f.parent / "timestamps.txt").write_text("2011-09-26 13:10:51.1\n"), "has 1 lines only"),
        ("d", lambda f: (f.parent / "timestamps.txt").write_text("2011-09-26 13:10:51.1\n" * 3), "must rise"),
        ("e", lambda f: (f / "0000000001.txt").write_text("1 2 3"), "0000000001.txt: 30 finite numbers .* 3 found"),
        ("f", lambda f: (f / "0000000001.txt").write_text("a b"), "30 numbers of KITTI's oxts wanted"),
    ):
        folder = oxts_folder(tmp_path / name)
        break_it(folder)
        with pytest.raises(EgoSpeedError, match=told):
            open_ego_speed(str(folder))


def test_kittis_own_oxts(shared_data):
    folder = shared_data / "kitti_stereo" / "0003" / "oxts"
    if not folder.is_dir():
        pytest.skip(f"real data not here: no folder {folder}")
    ego = open_ego_speed(str(folder))
    assert ego.time_s[-1] == pytest.approx(1.5531, abs=1e-3)  # 16 frames, 0.1035 s apart
    assert ego.at(0.0) == pytest.approx(11.842, abs=1e-3)
    assert ego.at(0.7) == pytest.approx(11.60, abs=0.01)
    assert (np.diff(ego.speed_mps) < 0).all()


def test_poses_as_samples_of_a_curve_driven(shared_data):
    """A drive's poses give its speed: forward steps over time, here by hand, since no command reads poses."""
    path = shared_data / "kitti_odometry" / "gray51" / "poses.txt"
    if not path.is_file():
        pytest.skip(f"real data not here: no file {path}")
    z_m = np.loadtxt(path)[:, 11]
    ego = EgoSpeed(0.1036 * np.arange(len(z_m)), np.gradient(z_m, 0.1036), "poses")
    assert ego.at(0.2) == pytest.approx((z_m[3] - z_m[1]) / 0.2072, rel=0.05)
