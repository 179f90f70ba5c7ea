"""Runs with a wrong baseline, on KITTI."""

import csv
import json

import pytest

pytestmark = pytest.mark.real


@pytest.mark.parametrize(
    ("factor", "cause"),
    [
        (0.5, "squares"),
        (0.67, "squares"),
        (1.0, ""),
        (1.5, "squares"),
        (2.54, "centimetres read as inches"),
    ],
)
def test_wrong_baselines_are_doubted(cli, shared_data, tmp_path, factor, cause):
    drive = shared_data / "kitti_stereo" / "0005"
    lines = dict(
        line.split(":", 1) for line in (drive / "calib.txt").read_text().splitlines() if ":" in line
    )
    left, right = ([float(number) for number in lines[name].split()] for name in ("P2", "P3"))
    right[3] = left[3] - factor * (left[3] - right[3])
    lines["P3"] = " ".join(map(str, right))
    rig = tmp_path / "calib.txt"
    rig.write_text("".join(f"{name}: {numbers}\n" for name, numbers in lines.items()))
    options = (
        "--no-sgbm",
        "--no-overlay",
        "--lanes",
        "off",
        "--truth",
        drive / "label.txt",
        "--out",
        tmp_path / "out",
    )
    assert cli("--stereo", drive / "left.mp4", drive / "right.mp4", "--rig", rig, *options)[0] == 0
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    notes = " ".join(summary["notes"])
    if factor == 1.0:
        assert "scale_doubt" not in summary
        assert 0.03 < summary["baseline_check"]["sigma"] < 0.12
        assert "The baseline agrees with the drive within" in notes
        assert "Scale in doubt" not in notes
        return
    assert summary["scale_doubt"]["factor"] == pytest.approx(factor, rel=0.2)
    assert list(summary["scale_doubt"]["causes"]) == ["baseline"]
    assert "Scale in doubt" in notes
    assert cause in notes
    # those before the doubt are among them
    assert summary["methods"]["fused"]["within_2_sigma"] > 0.6
    rows = csv.DictReader((tmp_path / "out/tracks.csv").read_text().splitlines())
    late = [
        (float(row["fused_m"]), float(row["fused_sigma_m"]))
        for row in rows
        if float(row["time_s"]) >= 0.6
    ]
    assert len(late) > 20
    assert all(
        0.5 * abs(1 - 1 / factor) < sigma_m / distance_m < abs(1 - 1 / factor) + 0.6
        for distance_m, sigma_m in late
    )
    with (tmp_path / "out/events.csv").open() as file:
        assert all(
            row["warning_s"] == "" for row in csv.DictReader(file) if row["scale_in_doubt"] == "1"
        )


@pytest.mark.parametrize(("factor", "text"), [(3.6, "km/h read as m/s"), (1.0, "")])
def test_a_speed_in_another_unit_is_doubted_with_one_camera(
    cli, shared_data, tmp_path, factor, text
):
    """The speed of KITTI's oxts, in km/h instead of m/s: the camera would be 6 m above the road."""
    drive = shared_data / "kitti_stereo" / "0003"
    speeds = [
        float(path.read_text().split()[8]) for path in sorted((drive / "oxts").rglob("0*.txt"))
    ]
    table = tmp_path / "speed.csv"
    rows = [f"{0.1 * k:.1f},{factor * speed:.3f}\n" for k, speed in enumerate(speeds)]
    table.write_text("time_s,speed_mps\n" + "".join(rows))
    options = ("--ego-speed", table, "--no-overlay", "--lanes", "off", "--out", tmp_path / "out")
    assert cli("--mono", drive / "left.mp4", "--rig", drive / "calib.txt", *options)[0] == 0
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert ("scale_doubt" in summary) == (factor != 1.0)
    if factor != 1.0:
        assert next(iter(summary["scale_doubt"]["causes"])) == "speed"
        assert text in " ".join(summary["notes"])
