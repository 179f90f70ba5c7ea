"""Runs with a wrong baseline, on KITTI."""

import json

import pytest

pytestmark = pytest.mark.real


@pytest.mark.parametrize(("factor", "cause"), [(0.5, "squares"), (1.0, ""), (2.54, "centimetres read as inches")])
def test_wrong_baselines_are_doubted(cli, shared_data, tmp_path, factor, cause):
    drive = shared_data / "kitti_stereo" / "0005"
    lines = dict(line.split(":", 1) for line in (drive / "calib.txt").read_text().splitlines() if ":" in line)
    left, right = ([float(number) for number in lines[name].split()] for name in ("P2", "P3"))
    right[3] = left[3] - factor * (left[3] - right[3])
    lines["P3"] = " ".join(map(str, right))
    rig = tmp_path / "calib.txt"
    rig.write_text("".join(f"{name}: {numbers}\n" for name, numbers in lines.items()))
    options = ("--no-sgbm", "--no-overlay", "--lanes", "off", "--truth", drive / "label.txt", "--out", tmp_path / "out")
    assert cli("--stereo", drive / "left.mp4", drive / "right.mp4", "--rig", rig, *options)[0] == 0
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    notes = " ".join(summary["notes"])
    if factor == 1.0:
        assert "scale_doubt" not in summary
        assert "Scale in doubt" not in notes
        return
    assert summary["scale_doubt"]["factor"] == pytest.approx(factor, rel=0.25)
    assert "Scale in doubt" in notes
    assert cause in notes
    assert summary["methods"]["fused"]["within_2_sigma"] > 0.7
    assert summary["events"]["n"] == 0
