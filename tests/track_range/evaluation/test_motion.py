"""Closing speed, speed over ground, time to collision and warnings against labelled motion."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.support.recordings.label_rows import F_PX, label_row as row
from track_range.cli.commands.evaluate.motion import _cell_grids
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.evaluation.motion.cells import motion_cells, quantity_figures, worst_drive
from track_range.evaluation.motion.labelled_motion import kitti_motion, track_slopes
from track_range.evaluation.motion.measured_motion import MeasuredMotion, measured_motion
from track_range.evaluation.motion.nuscenes import nuscenes_motion
from track_range.evaluation.motion.scores import (
    motion_figures,
    quantities,
    speed_figures,
    ttc_figures,
)
from track_range.evaluation.motion.states import true_states
from track_range.evaluation.motion.tusimple import tusimple_motion, velocity_score
from track_range.foundation.errors import UsageError
from track_range.ranging.evaluation.box_methods import MethodOptions
from track_range.ranging.truth.frame_times import ASSUMED_STEP_S, KITTI_STEP_S, TimeSource


def unmeasured(n):
    """Motion of n boxes without an answer."""
    return MeasuredMotion(np.zeros(n, np.bool_), *np.full((11, n), np.nan))


EGO_MPS, LEAD_MPS, N_FRAMES = 10.0, 6.0, 45


@pytest.fixture
def labels_calib_poses(tmp_path):
    """A parked car 3 m beside the path, and one ahead that drives at 6 m/s, from a camera at 10
    m/s, without turns."""
    for name in ("labels", "calib", "poses"):
        (tmp_path / name).mkdir()
    times_s = ASSUMED_STEP_S * np.arange(N_FRAMES)
    rows = []
    for frame, t in enumerate(times_s):
        rows.append(row(frame, 1, "Car", 70.0 - EGO_MPS * t, x_m=3.0))
        rows.append(row(frame, 2, "Car", 40.0 - (EGO_MPS - LEAD_MPS) * t))
    (tmp_path / "labels/0001.txt").write_text("\n".join(rows) + "\n")
    (tmp_path / "calib/0001.txt").write_text(f"P2: {F_PX} 0 600 0 0 {F_PX} 180 0 0 0 1 0\n")
    pose = [f"1 0 0 0 0 1 0 0 0 0 1 {EGO_MPS * t}" for t in times_s]
    (tmp_path / "poses/0001.txt").write_text("\n".join(pose) + "\n")
    return tmp_path / "labels", tmp_path / "calib", tmp_path / "poses"


def test_true_motion_is_that_of_the_drive(labels_calib_poses):
    truth = kitti_motion(*labels_calib_poses)
    is_parked = truth.boxes.track_id == 1
    inner = (truth.boxes.frame >= 3) & (truth.boxes.frame < N_FRAMES - 3)
    assert (np.isfinite(truth.closing_mps) == inner).all()  # at least 0.3 s before and after
    assert truth.closing_mps[inner & is_parked] == pytest.approx(EGO_MPS, abs=1e-3)
    assert truth.closing_mps[inner & ~is_parked] == pytest.approx(EGO_MPS - LEAD_MPS, abs=1e-3)
    assert truth.speed_mps[inner & is_parked] == pytest.approx(0.0, abs=1e-3)
    assert truth.speed_mps[inner & ~is_parked] == pytest.approx(LEAD_MPS, abs=1e-3)
    assert truth.ego_mps == pytest.approx(EGO_MPS)
    assert truth.yaw_rad_s == pytest.approx(0.0)
    first = inner & ~is_parked & (truth.boxes.frame == 10)
    rear_m = 40.0 - 4.0 * ASSUMED_STEP_S * 10
    assert truth.ttc_s[first] == pytest.approx(rear_m / 4.0, rel=2e-3)
    assert truth.duration_s == pytest.approx(N_FRAMES * ASSUMED_STEP_S)


def test_states_of_the_drive(labels_calib_poses):
    truth = kitti_motion(*labels_calib_poses)
    is_parked, known = truth.boxes.track_id == 1, np.isfinite(truth.speed_mps)
    assert (true_states(truth)[known & is_parked] == 0).all()
    assert (true_states(truth)[known & ~is_parked] == 1).all()
    assert truth.heading_rad[known & ~is_parked] == pytest.approx(0.0, abs=1e-3)
    figures = motion_figures(truth, measured_motion(truth, "mono"))["states"]["vehicles"]
    assert figures["n"] == known.sum()
    assert figures["coverage"] > 0.7
    assert figures["wrong"] == 0.0
    assert figures["by_true_state"]["parked"]["parked"] == 1.0
    assert figures["by_true_state"]["oncoming"]["n"] == 0
    sure = figures["reliability"]["0.99-1"]
    assert sure["right"] == 1.0
    assert 0.99 <= sure["stated"] <= 1.0


def test_true_states_by_direction(labels_calib_poses):
    """The heading counts from the drive, 45 degrees to either side; slow objects are parked."""
    truth = kitti_motion(*labels_calib_poses)
    degrees = np.resize([0.0, 44.0, -46.0, 134.0, 136.0, 180.0], len(truth.boxes))
    speed_mps = np.resize([1.0, 1.0, 1.0, 1.0, 1.0, 0.6, *[0.4] * 5, np.nan], len(truth.boxes))
    moved = replace(truth, heading_rad=np.radians(degrees), speed_mps=speed_mps)
    states = true_states(moved)
    assert states[:11].tolist() == [1, 1, 3, 3, 2, 2, 0, 0, 0, 0, 0]
    assert np.isnan(states[11])


def test_yaw_of_the_camera_is_no_speed_of_objects(labels_calib_poses):
    """The camera stands and turns to the right by 0.1 rad/s: a standing car moves in its frame, but
    not over ground."""
    labels, calib, poses = labels_calib_poses
    angles = 0.1 * ASSUMED_STEP_S * np.arange(N_FRAMES)
    rows, pose = [], []
    for frame, a in enumerate(angles):
        x_m, z_m = np.cos(a) * 2.0 - np.sin(a) * 32.0, np.sin(a) * 2.0 + np.cos(a) * 32.0
        rows.append(row(frame, 1, "Car", z_m - 2.0, x_m=x_m))  # its centre is 2 m behind its rear
        pose.append(f"{np.cos(a)} 0 {np.sin(a)} 0 0 1 0 0 {-np.sin(a)} 0 {np.cos(a)} 0")
    (labels / "0001.txt").write_text("\n".join(rows) + "\n")
    (poses / "0001.txt").write_text("\n".join(pose) + "\n")
    truth = kitti_motion(labels, calib, poses)
    known = np.isfinite(truth.speed_mps)
    assert truth.yaw_rad_s == pytest.approx(0.1)
    assert truth.speed_mps[known] == pytest.approx(0.0, abs=2e-3)
    assert truth.ego_mps == pytest.approx(0.0)
    early = known & (truth.boxes.frame == 5)
    assert truth.closing_mps[early] == pytest.approx(-0.1 * truth.boxes.x_m[early], abs=2e-3)


def test_camera_that_looks_aside(labels_calib_poses):
    """At 10 m/s, 60 degrees to the right of the drive: 5 m/s along the axis, 8.66 m/s to the left
    of it. A person who stands moves to the right in the images, but not over ground."""
    labels, calib, poses = labels_calib_poses
    rows, pose = [], []
    for frame in range(N_FRAMES):
        t = ASSUMED_STEP_S * frame
        rows.append(row(frame, 1, "Pedestrian", 45.0 - 5.0 * t, x_m=8.660254 * t - 15.0))
        pose.append(f"1 0 0 {-8.660254 * t} 0 1 0 0 0 0 1 {5.0 * t}")
    (labels / "0001.txt").write_text("\n".join(rows) + "\n")
    (poses / "0001.txt").write_text("\n".join(pose) + "\n")
    truth = kitti_motion(labels, calib, poses)
    assert truth.ego_mps == pytest.approx(5.0)
    assert truth.right_mps == pytest.approx(-8.660254)
    assert truth.mounting(0).yaw_deg == pytest.approx(-60.0)
    assert not np.isfinite(truth.ttc_s).any()
    measured = measured_motion(truth, "mono")
    known = np.isfinite(measured.speed_mps) & np.isfinite(truth.speed_mps)
    assert known.sum() > N_FRAMES // 2
    assert (np.abs(measured.speed_mps) < 0.5)[known].all()
    assert motion_figures(truth, measured)["warnings"]["hours"] == 0.0
    blind = measured_motion(truth, "mono", is_ego_known=False)
    assert not np.isfinite(blind.speed_mps).any()


def test_direction_of_a_camera_at_rest_is_not_known(labels_calib_poses):
    labels, calib, poses = labels_calib_poses
    (poses / "0001.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * N_FRAMES)
    truth = kitti_motion(labels, calib, poses)
    assert truth.mounting(0) is None
    assert truth.are_ahead.tolist() == [True]


def test_exact_boxes_give_the_true_motion(labels_calib_poses, cli, tmp_path):
    labels, calib, poses = labels_calib_poses
    arguments = (
        "--labels",
        labels,
        "--calib",
        calib,
        "--poses",
        poses,
        "--json",
        tmp_path / "f.json",
    )
    status, printed, _ = cli("evaluate", "motion", *arguments)
    assert status == 0, printed
    figures = json.loads((tmp_path / "f.json").read_text())
    near = figures["bands"]["10-40"]
    errors = ("median_mps", "p95_mps", "within_1_sigma", "within_2_sigma")
    assert set(near) == {"n", "coverage", *errors, *(f"{name}_ci95" for name in errors)}
    assert near["median_mps_ci95"][0] <= near["median_mps"] <= near["median_mps_ci95"][1]
    # the sizes of the cars are read 4.6 % too large, and so is the 4 m/s of the one ahead
    assert 0 <= near["median_mps"] < 0.046 * 4.0 + 0.02
    assert 0.8 < near["coverage"] <= 1.0
    assert figures["by_class"]["car"]["10-40"] == near
    assert figures["speed"]["bands"]["10-40"]["median_mps"] < 0.046 * 4.0 + 0.02
    assert set(figures["ttc"]["below_6_s"]) >= {"n", "median_pct", "rte_pct", "mid"}
    assert 0 < figures["ttc"]["below_20_s"]["rte_pct"] < 10
    assert figures["warnings"]["hours"] == pytest.approx(N_FRAMES * ASSUMED_STEP_S / 3600, abs=1e-4)
    assert figures["warnings"]["false_alarms"] == 0
    assert "Time to collision" in printed
    closing = figures["cells"]["closing"]
    lead, parked = closing["own speed 2-6 m/s"], closing["own speed 0-0.5 m/s"]
    lead_n = lead["n"] + closing["own speed 6- m/s"]["n"]
    assert lead_n == parked["n"] == closing["all"]["n"] / 2 > 0
    assert closing["believed static"]["rms"] < 0.3
    assert closing["turn, speed known"]["n"] == closing["camera stands"]["n"] == 0
    assert figures["drives"]["closing"] == {"0001": closing["all"]}
    assert figures["worst_drives"]["closing"] == "0001"
    assert "by cell" in printed
    assert "by drive" not in printed
    assert figures["cells"]["ttc"]["all"]["within_3_sigma"] > 0.9


def test_drives_are_printed_where_there_are_several():
    none = {"closing": {}, "speed": {}, "ttc": {}}
    drives = {"0001": {"n": 60}, "0002": {"n": 70}}
    figures = {
        "cells": none,
        "drives": none | {"closing": drives},
        "worst_drives": {"closing": "0002", "speed": None, "ttc": None},
    }
    (grid,) = _cell_grids(figures)
    assert [row[0].text for row in grid.rows] == ["0001", "0002 (worst)"]


def test_look_ahead_answers_more(labels_calib_poses):
    """With 2 px of noise: later frames give the first ones a closing speed, with smaller errors."""
    import track_range as tr

    labels, calib, poses = labels_calib_poses
    # with seed 0, only the parked car is answered
    given = {"calib": calib, "poses": poses, "noise_px": 2.0, "seed": 1}
    bands = {
        look_ahead: tr.evaluate.motion(labels, look_ahead=look_ahead, **given)["bands"]
        for look_ahead in (False, True)
    }
    far, far_ahead = bands[False]["40-80"], bands[True]["40-80"]
    near, near_ahead = bands[False]["10-40"], bands[True]["10-40"]
    assert far["n"] == far_ahead["n"]
    assert far["coverage"] + 0.3 < far_ahead["coverage"] <= 1.0
    assert near["coverage"] < near_ahead["coverage"]
    assert 0.0 < near_ahead["median_mps"] < near["median_mps"]
    assert 0.0 < far_ahead["median_mps"] < 1.0


def test_slopes_need_labels_on_both_sides():
    time_s = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 5.0])
    key = np.zeros((1, 8), np.int64)
    slopes = track_slopes(key, time_s, np.stack([2 * time_s, time_s**2], axis=1))
    assert np.isfinite(slopes[:, 0]).tolist() == [
        False,
        False,
        False,
        True,
        False,
        False,
        False,
        False,
    ]
    # the slope of t^2 at 0.3 s over a symmetrical span
    assert slopes[3] == pytest.approx([2.0, 0.6])


def test_speed_figures_by_hand():
    """Errors of 0.5, 1 and 3 m/s in four labels with a truth, of which one has no answer."""
    true = np.array([5.0, 5.0, 5.0, 5.0, np.nan])
    speed, sigma = np.array([5.5, 4.0, 8.0, 5.0, 5.0]), np.array([0.6, 0.6, 1.0, np.nan, 0.1])
    figures = speed_figures(np.stack([speed, sigma, true]), np.ones(5, np.bool_))
    assert (figures["n"], figures["coverage"], figures["median_mps"]) == (4, 0.75, 1.0)
    assert figures["p95_mps"] == pytest.approx(2.8)
    assert figures["within_1_sigma"] == pytest.approx(1 / 3, abs=1e-3)
    assert figures["within_2_sigma"] == pytest.approx(2 / 3, abs=1e-3)
    assert speed_figures(np.full((3, 5), np.nan), np.ones(5, np.bool_))["coverage"] is None


def test_speeds_with_a_large_sigma_are_no_answers(labels_calib_poses):
    truth = kitti_motion(*labels_calib_poses)
    sigmas = np.full(len(truth.boxes), 1.4)
    sigmas[0] = 1.5
    measured = replace(unmeasured(len(sigmas)), closing_sigma_mps=sigmas, speed_sigma_mps=sigmas)
    compared = quantities(truth, measured)
    for name in ("closing", "speed"):
        assert np.flatnonzero(np.isnan(compared[name][1])).tolist() == [0]


def test_errors_of_ttc_as_tsttc_defines_them():
    """5 s measured as 4 s, 4 s as 30 s, which clipped to 20 s; one not measured, one too far
    away."""
    figures = ttc_figures(np.array([4.0, 30.0, np.nan, 9.0]), np.array([5.0, 4.0, 3.0, 9.0]), 6.0)
    assert (figures["n"], figures["coverage"]) == (2, pytest.approx(2 / 3, abs=1e-3))
    assert figures["rte_pct"] == pytest.approx(100 * (0.2 + 4.0) / 2)
    s = [t / (t + 0.1) for t in (4.0, 5.0, 20.0, 4.0)]
    assert figures["mid"] == pytest.approx(
        1e4 * (abs(np.log(s[0] / s[1])) + abs(np.log(s[2] / s[3]))) / 2, abs=1e-3
    )


def test_false_alarms_by_cause(labels_calib_poses):
    """Alarms for the car ahead, and for the parked one beside the path, with right and with wrong
    distances."""
    truth = kitti_motion(*labels_calib_poses)
    boxes = truth.boxes
    true_m, closing = boxes.distance_m.copy(), truth.closing_mps.copy()
    alarm = (boxes.frame >= 10) & (boxes.frame < 20)
    alarm &= (boxes.track_id == 1) | (boxes.frame != 15)  # two alarms for the car ahead
    found = replace(unmeasured(len(boxes)), is_alarm=alarm, distance_m=true_m, closing_mps=closing)
    figures = motion_figures(truth, found)["warnings"]
    assert figures["false_alarms"] == 3
    assert figures["by_cause"] == {"driver": 2, "wrong path": 1}
    assert figures["in_alarm_s"] == pytest.approx((9 + 4 + 3) * ASSUMED_STEP_S, abs=0.01)
    assert figures["per_hour"] == pytest.approx(3 / truth.duration_s * 3600, abs=0.01)
    true_m[boxes.track_id == 1] *= 0.8
    closing[boxes.track_id == 2] += 2.0
    assert motion_figures(truth, found)["warnings"]["by_cause"] == {"box error": 2, "scale": 1}


def test_messages_name_the_option_and_the_file(labels_calib_poses, cli):
    labels, calib, poses = labels_calib_poses
    status, _, error = cli("evaluate", "motion", "--labels", labels, "--calib", calib)
    assert status == 2
    assert "--poses" in error
    (poses / "0001.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(LabelFileError, match=r"0001\.txt: .*pose"):
        kitti_motion(labels, calib, poses)
    (poses / "0001.txt").write_text("1 2 3\n")
    with pytest.raises(LabelFileError, match="12 numbers"):
        kitti_motion(labels, calib, poses)


def test_unknown_methods(labels_calib_poses):
    import track_range as tr

    labels, calib, poses = labels_calib_poses
    with pytest.raises(UsageError, match=r"stereo.*mono"):
        tr.evaluate.motion(labels, calib=calib, poses=poses, method="stereo")


@pytest.mark.real
def test_a_given_sequence(shared_data, tmp_path):
    """Sequence 0004 of KITTI, exact boxes: fast parked and moving cars."""
    import track_range as tr

    labels = tmp_path / "label_02"
    labels.mkdir()
    (labels / "0004.txt").symlink_to(shared_data / "kitti_labels" / "label_02" / "0004.txt")
    poses = shared_data / "kitti_poses"
    if not poses.is_dir():
        pytest.skip(f"real data not here: no folder {poses}")
    figures = tr.evaluate.motion(labels, calib=shared_data / "kitti_labels" / "calib", poses=poses)
    near, far = figures["bands"]["10-40"], figures["bands"]["40-80"]
    assert (near["n"], far["n"]) == (457, 270)
    # 0.39: the cars that move have a sigma above 1.5 m/s in their first seconds
    assert 0.33 < near["coverage"] < 0.5
    assert 0.1 < near["median_mps"] < 1.1
    assert 0.1 < figures["speed"]["bands"]["10-40"]["median_mps"] < 0.9
    assert 0.9 < figures["speed"]["bands"]["10-40"]["within_2_sigma"] <= 1.0
    assert 3 < figures["ttc"]["below_6_s"]["rte_pct"] < 15
    assert figures["warnings"]["hours"] == pytest.approx(314 * KITTI_STEP_S / 3600, abs=1e-4)
    assert figures["warnings"]["false_alarms"] <= 1


def test_official_velocity_score_by_hand():
    """Errors of (1, 0) and (0, 2) near, 3 m/s at 44 m, none far away: the mean of 2.5 and 9."""
    true = np.array([[1.0, 0.0], [-2.0, 1.0], [5.0, 0.0]])
    velocity = true + np.array([[1.0, 0.0], [0.0, 2.0], [3.0, 0.0]])
    position = np.array([[10.0, 1.0], [19.0, 2.0], [44.0, 3.0]])
    score = velocity_score(velocity, true, position)
    assert score == {"near": 2.5, "medium": 9.0, "far": None, "mean": 5.75}


def mono3d(folder, speeds_mps, *, ego_mps=8.0, yaw_rad_s=0.0):
    """A file of mono3d labels: cars from 30 m on, 3 m to the right, with these own speeds along the
    first axis."""
    images, rows = [], []
    for k in range(5):
        t, a = 0.5 * k, -0.5 * yaw_rad_s * k  # nuScenes: x forward, y left, z up
        image = {
            "id": str(k),
            "file_name": f"samples/CAM_FRONT/n__CAM_FRONT__{int(1e15 + 5e5 * k)}.jpg",
            "cam2ego_rotation": [0.5, -0.5, 0.5, -0.5],
            "cam2ego_translation": [0.0, 0.0, 1.5],
            "ego2global_rotation": [np.cos(a / 2), 0.0, 0.0, np.sin(a / 2)],
            "ego2global_translation": [ego_mps * t, 0.0, 0.0],
            "cam_intrinsic": [[1000.0, 0.0, 800.0], [0.0, 1000.0, 450.0], [0.0, 0.0, 1.0]],
            "width": 1600,
            "height": 900,
        }
        images.append(image)
        for number, speed_mps in enumerate(speeds_mps):
            east, south = 32.0 + 12 * number + (speed_mps - ego_mps) * t, 3.0
            x, z = np.cos(a) * south + np.sin(a) * east, np.cos(a) * east - np.sin(a) * south
            rows.append(
                {
                    "image_id": str(k),
                    "category_id": 0,
                    "bbox": [1000 * (x - 0.9) / z + 800, 1000 * 0.1 / z + 450, 1800 / z, 1500 / z],
                    "bbox_cam3d": [x, 0.85, z, 4.0 + number / 10, 1.5, 1.8, -np.pi / 2],
                    "velo_cam3d": [np.sin(a) * speed_mps, np.cos(a) * speed_mps]
                    if k < 4
                    else [np.nan, np.nan],
                }
            )
    path = folder / "mono3d.json"
    content = {"categories": [{"id": 0, "name": "car"}], "images": images, "annotations": rows}
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("yaw_rad_s", [0.0, 0.05])
def test_motion_of_mono3d_labels(tmp_path, yaw_rad_s):
    """A parked car and one at 6 m/s: closing speeds are the slopes of their depths, also while the
    camera turns."""
    truth = nuscenes_motion(mono3d(tmp_path, [0.0, 6.0], yaw_rad_s=yaw_rad_s))
    boxes = truth.boxes
    z = boxes.distance_m + 2.0
    assert len(boxes) == 10
    assert len(np.unique(boxes.track_id)) == 2
    known = np.isfinite(truth.closing_mps)
    assert known.sum() == 6  # not in the first and the last image
    assert truth.yaw_rad_s[known] == pytest.approx(yaw_rad_s, abs=1e-3)
    for track, speed_mps in zip(boxes.track_id[:2], (0.0, 6.0), strict=True):
        rows = boxes.track_id == track
        slope = (z[rows][:-2] - z[rows][2:]) / 1.0
        assert truth.closing_mps[rows][1:-1] == pytest.approx(slope, abs=0.12)
        if yaw_rad_s == 0:
            assert truth.closing_mps[rows][1:-1] == pytest.approx(8.0 - speed_mps, abs=1e-6)
        assert truth.speed_mps[rows][1:-1] == pytest.approx(speed_mps, abs=1e-6)


def test_other_files_are_no_mono3d_labels(tmp_path):
    path = tmp_path / "other.json"
    path.write_text('{"categories": [], "images": []}')
    with pytest.raises(LabelFileError, match=r"other\.json: .*mono3d"):
        nuscenes_motion(path)


def test_clips_of_tusimple_need_labels_and_images(tmp_path):
    with pytest.raises(LabelFileError, match=r"annotation\.json"):
        tusimple_motion(tmp_path)
    box = {"left": 700.0, "top": 330.0, "right": 780.0, "bottom": 390.0}
    labels = [{"bbox": box, "position": [24.0, 1.0], "velocity": [-2.0, 0.0]}]
    (tmp_path / "annotation.json").write_text(json.dumps(labels))
    with pytest.raises(LabelFileError, match=r"001\.jpg"):
        tusimple_motion(tmp_path)
    (tmp_path / "annotation.json").write_text("[{}]")
    with pytest.raises(LabelFileError, match="position and velocity"):
        tusimple_motion(tmp_path)


@pytest.mark.real
def test_closing_speeds_of_nuscenes(shared_data):
    """Six cameras at 2 Hz, of a data set on which nothing of the filters was chosen; sides of
    streets, where most cars are parked, have smaller errors than their sigma."""
    truth = nuscenes_motion(shared_data / "nuscenes" / "mono3d.json")
    measured = measured_motion(truth, "mono")
    figures = motion_figures(truth, measured)
    assert truth.are_ahead.sum() == 1
    is_front = truth.are_ahead[truth.boxes.sequence]
    z = truth.boxes.distance_m
    ahead = speed_figures(
        quantities(truth, measured)["closing"], is_front & (z >= 10.0) & (z < 40.0)
    )
    near, far = figures["bands"]["10-40"], figures["bands"]["40-80"]
    assert 1100 < near["n"] < 1400
    assert 0.75 < near["coverage"] < 0.95
    assert 0.05 < near["median_mps"] < 0.2
    assert 0.6 < ahead["within_1_sigma"] < 0.85
    assert near["within_1_sigma"] > 0.6
    assert 0.9 < near["within_2_sigma"] < 0.99
    assert 0.7 < far["coverage"] < 0.95
    # also of the cameras to the sides and to the rear
    assert figures["speed"]["bands"]["10-40"]["n"] == near["n"]
    assert 0.1 < figures["speed"]["bands"]["10-40"]["median_mps"] < 0.23


@pytest.mark.real
@pytest.mark.slow
def test_states_and_closing_speeds_of_argoverse(shared_data):
    """Three logs of another continent and camera, no constant was chosen on them, 2 px noise."""
    folder = shared_data / "av2"
    truth = kitti_motion(
        *(folder / name for name in ("label_shape", "calib", "poses")),
        noise_px=2.0,
        times=TimeSource(None, 10.0),
    )
    options = MethodOptions(box_sigma_px=2.0, region="north-america")
    figures = motion_figures(truth, measured_motion(truth, "mono", options))
    near = figures["bands"]["10-40"]
    assert 0.2 < near["median_mps"] < 0.36  # 0.45 without `BelievedSizes`
    assert 0.91 < near["within_2_sigma"] < 0.97
    by_state = figures["states"]["vehicles"]["by_true_state"]
    assert by_state["parked"]["coverage"] > 0.55
    assert by_state["parked"]["parked"] > 0.97
    assert by_state["moving"]["oncoming"] < 0.005


@pytest.mark.real
@pytest.mark.slow
def test_velocity_of_a_tusimple_clip(shared_data):
    import track_range as tr

    figures = tr.evaluate.motion(shared_data / "tusimple" / "clip", data="tusimple")
    assert figures["bands"]["10-40"]["coverage"] == 1.0
    assert 0 <= figures["bands"]["10-40"]["median_mps"] < 0.6
    assert 0 < figures["velocity_score"]["medium"] < 0.5
    assert figures["velocity_score"]["near"] is None


def test_figures_of_a_quantity():
    """Errors of 0.5, 1.2, 3.0 and 0 s with a sigma of 1 s; one without an answer, one not known."""
    true = np.array([5.0, 5.0, 5.0, 5.0, 5.0, np.nan])
    value, sigma = np.array([5.5, 3.8, 8.0, 5.0, np.nan, 5.0]), np.ones(6)
    values = np.stack([value, sigma, true])
    figures = quantity_figures(values, np.ones(6, np.bool_))
    assert (figures["n"], figures["coverage"], figures["stated_sigma"]) == (5, 0.8, 1.0)
    assert figures["rms"] == pytest.approx(np.sqrt((0.25 + 1.44 + 9.0) / 4), abs=1e-3)
    assert figures["median_error"] == pytest.approx(0.85)
    fractions = [figures[f"within_{k}_sigma"] for k in (1, 2, 3)]
    assert fractions == [0.5, 0.75, 1.0]
    empty = quantity_figures(values, np.zeros(6, np.bool_))
    assert empty["n"] == 0
    assert empty["coverage"] is empty["rms"] is empty["within_2_sigma"] is None


def test_worst_drive_has_the_smallest_fraction_of_many_values():
    drives = {
        "few": {"n": 60, "coverage": 0.5, "within_2_sigma": 0.1},
        "good": {"n": 90, "coverage": 0.9, "within_2_sigma": 0.95},
        "bad": {"n": 90, "coverage": 0.9, "within_2_sigma": 0.7},
        "empty": {"n": 0, "coverage": None, "within_2_sigma": None},
    }
    assert worst_drive(drives) == "bad"
    assert worst_drive({"empty": drives["empty"]}) is None


def test_cells_are_masks_of_the_boxes(labels_calib_poses):
    truth = kitti_motion(*labels_calib_poses)
    boxes, n = truth.boxes, len(truth.boxes)
    xyxy_px = boxes.xyxy_px.copy()
    xyxy_px[0, 0], xyxy_px[1, 3] = 1.0, boxes.size_px[1, 1] - 2.0
    truth = replace(truth, boxes=replace(boxes, xyxy_px=xyxy_px), yaw_rad_s=np.full(n, -0.2))
    static, ego_mps = np.full(n, 0.5), truth.ego_mps.copy()
    static[2], ego_mps[3] = 0.95, np.nan
    cells = motion_cells(truth, replace(unmeasured(n), static=static, ego_mps=ego_mps))
    assert np.flatnonzero(cells["cut by the border"]).tolist() == [0, 1]
    assert np.flatnonzero(cells["believed static"]).tolist() == [2]
    assert np.flatnonzero(cells["turn, speed unknown"]).tolist() == [3]
    assert cells["turn, speed known"].sum() == n - 1
    assert cells["vehicles"].all()
    assert not cells["people"].any()
    z, is_lead = boxes.distance_m, boxes.track_id == 2
    known = np.isfinite(truth.speed_mps)
    assert (cells["20-40 m"] == ((z >= 20) & (z < 40))).all()
    assert (cells["moving, 20-40 m"] == (cells["20-40 m"] & is_lead & known)).all()
