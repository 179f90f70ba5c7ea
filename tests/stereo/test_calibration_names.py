"""Calibrations by the names of their values: names, containers, units, directions and sizes, all
with known values."""

from __future__ import annotations

import json
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from tests.support.recordings.calibration_files import NAMES, storage
from tests.support.recordings.calibration_matrices import (
    D1,
    D2,
    K1,
    K2,
    R,
    T,
    matlab,
    plain,
    values,
)
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import load_calibration, load_rig

BASELINE_M = float(np.linalg.norm(T))


def check(loaded: tuple[Any, tuple[str, ...]], translation: np.ndarray = T) -> tuple[str, ...]:
    rig, notes = loaded
    assert isinstance(rig, StereoRig)
    assert rig.left.matrix == pytest.approx(K1, abs=1e-9)
    assert rig.right.matrix == pytest.approx(K2, abs=1e-9)
    assert rig.left.distortion == pytest.approx(D1[0])
    assert rig.right.distortion == pytest.approx(D2[0])
    assert rig.right_from_left[:3, :3] == pytest.approx(R, abs=1e-9)
    assert rig.right_from_left[:3, 3] == pytest.approx(translation.ravel(), abs=1e-9)
    return notes


@pytest.mark.parametrize("names", NAMES)
def test_names_in_json(tmp_path, names):
    path = tmp_path / "stereo.json"
    path.write_text(json.dumps(plain(values(names))))
    check(load_calibration(path))


@pytest.mark.parametrize("names", [names for names in NAMES if "." not in names])
@pytest.mark.parametrize("suffix", [".yml", ".xml", ".npz"])
def test_names_in_storage_and_numpy(tmp_path, names, suffix):
    path, content = tmp_path / f"stereo{suffix}", values(names)
    if suffix == ".npz":
        np.savez(path, map1=np.zeros((480, 640, 2), np.float32), **content)
    else:
        storage(path, content)
    check(load_rig(path, size_px=(640, 480)))


def test_containers(tmp_path):
    np.savez_compressed(tmp_path / "c.npz", **values(NAMES[2]))
    check(load_calibration(tmp_path / "c.npz"))
    for name, matrix in values(NAMES[15]).items():
        np.save(tmp_path / f"{name}.npy", matrix)
    np.save(tmp_path / "undistortion_map_left.npy", np.zeros((480, 640, 2), np.float32))
    check(load_calibration(tmp_path / "cam_mats_left.npy"))
    check(load_calibration(tmp_path / "undistortion_map_left.npy"))
    printed = tmp_path / "printed.txt"
    with np.printoptions(precision=17, floatmode="unique"):
        lines = [
            f"{name}:\n{matrix}"
            for name, matrix in values(NAMES[0]).items()
            if name in NAMES[0].split()
        ]
    printed.write_text("Calibration done\n" + "\n".join(lines))
    check(load_calibration(printed))
    script = "\n".join(
        f"{name} = np.array({matrix.tolist()})"
        for name, matrix in values(NAMES[4]).items()
        if name[0] in "mdRT"
    )
    printed.write_text("import numpy as np\n" + script)
    check(load_calibration(printed))


@pytest.mark.parametrize(
    ("factor", "word"), [(1.0, "metres"), (100.0, "centimetres"), (1000.0, "millimetres")]
)
def test_unit_by_the_length_of_t(tmp_path, factor, word):
    path = storage(tmp_path / "stereo.yml", values(NAMES[0], T * factor))
    assert any(word in note for note in check(load_calibration(path)))


@pytest.mark.parametrize(("square", "factor"), [(22.2, 200.0), (0.0222, 1.0)])
def test_square_size(tmp_path, square, factor):
    """20 long: 2 cm in millimetres by a square of 22.2 mm, else 20 cm."""
    path = storage(tmp_path / "stereo.yml", {**values(NAMES[0], T * factor), "square_size": square})
    rig, _ = load_calibration(path)
    assert rig.baseline_m == pytest.approx(BASELINE_M * (0.2 if square > 1 else 1.0))


def test_units_in_doubt_and_given(tmp_path):
    path = storage(tmp_path / "stereo.yml", values(NAMES[0], T / 0.025))  # squares of 25 mm
    with pytest.raises(RigError, match=r"wider than a vehicle.*--unit"):
        load_rig(path, size_px=(640, 480))
    rig, notes = load_calibration(path, metres_per_unit=0.01)
    assert rig.baseline_m == pytest.approx(BASELINE_M / 2.5)
    assert not any("metres" in note for note in notes)
    storage(path, values(NAMES[0], T * 1000))
    assert load_calibration(path, metres_per_unit=0.01)[0].baseline_m == pytest.approx(
        BASELINE_M * 10
    )
    named = {**plain(values(NAMES[0], T * 30)), "units": "inches"}
    path.with_suffix(".json").write_text(json.dumps({**named, "units": "mm"}))
    assert load_calibration(path.with_suffix(".json"), metres_per_unit=0.1)[
        0
    ].baseline_m == pytest.approx(BASELINE_M * 3)


def test_rotation_vector_and_row(tmp_path):
    content = values(NAMES[0]) | {"R": cv2.Rodrigues(R)[0], "T": T.T}
    check(load_calibration(storage(tmp_path / "stereo.yml", content)))


def inverse() -> dict[str, np.ndarray]:
    return {"R": R.T, "T": -R.T @ T}


def test_inverse_transform_of_named_cameras(tmp_path):
    content = values("K_left D_left K_right D_right R T") | inverse()
    notes = check(load_calibration(storage(tmp_path / "stereo.yml", content)))
    assert any("from the right camera to the left" in note for note in notes)


def test_second_camera_on_the_left(tmp_path):
    """Cameras 1 and 2 with x1 = R x2 + T of the true pair: camera 2 is the left one."""
    content = dict(zip("K1 D1 K2 D2".split(), (K2, D2, K1, D1), strict=True)) | inverse()
    notes = check(load_calibration(storage(tmp_path / "stereo.yml", content)))
    assert any("camera 2 is to the left" in note for note in notes)


def rectification() -> dict[str, Any]:
    r1, r2, p1, p2, q, *_ = cv2.stereoRectify(K1, D1, K2, D2, (640, 480), R, T)
    return {"R1": r1, "R2": r2, "P1": p1, "P2": p2, "Q": q}


def test_rectification_determines_the_direction_and_the_pair(tmp_path):
    both = values(NAMES[0]) | rectification()
    assert len(check(load_calibration(storage(tmp_path / "a.yml", both)))) == 1
    notes = check(load_calibration(storage(tmp_path / "b.yml", both | inverse())))
    assert any("inverted" in note for note in notes)
    without = {key: value for key, value in both.items() if key not in "RT"}
    check(load_calibration(storage(tmp_path / "c.yml", without)))
    notes = load_calibration(storage(tmp_path / "d.yml", both | {"T": 1.5 * T}))[1]
    assert any("P2[0, 3]" in note for note in notes)
    other = np.asarray(cv2.Rodrigues(np.array([0.1, 0.1, 0.0]))[0])
    notes = load_calibration(storage(tmp_path / "e.yml", both | {"R": other}))[1]
    assert any("contradicts" in note for note in notes)


def test_projections_only(tmp_path):
    rig, notes = load_calibration(storage(tmp_path / "p.yml", rectification()))
    assert rig.is_rectified
    assert rig.baseline_m == pytest.approx(BASELINE_M)
    assert "rectified" in notes[0]


def test_poses_of_both_cameras(tmp_path):
    world = np.asarray(cv2.Rodrigues(np.array([0.3, 0.2, 0.1]))[0])
    offset = np.array([[1.0], [2.0], [3.0]])
    content = {
        "cam1": {
            "K": K1,
            "dist_coeffs": D1,
            "R": world,
            "T": offset,
            "img_width": 640,
            "img_height": 480,
        },
        "cam2": {
            "K": K2,
            "dist_coeffs": D2,
            "R": R @ world,
            "T": R @ offset + T,
            "img_width": 640,
            "img_height": 480,
        },
    }
    (tmp_path / "cameras.json").write_text(json.dumps(plain(content)))
    loaded = load_calibration(tmp_path / "cameras.json")
    check(loaded)
    assert loaded[0].left.size_px == loaded[0].right.size_px == (640, 480)


@pytest.mark.parametrize("size", [[640, 480], [480, 640]])
def test_size_in_either_order(tmp_path, size):
    content = plain(values(NAMES[0])) | {"image_size": size}
    (tmp_path / "a.json").write_text(json.dumps(content))
    assert load_calibration(tmp_path / "a.json")[0].left.size_px == (640, 480)


def test_four_coefficients_by_the_field_of_view(tmp_path):
    content = values(NAMES[0]) | {"D1": D1[:, :4], "D2": D2[:, :4]}
    rig, notes = load_calibration(storage(tmp_path / "a.yml", content))
    assert rig.left.lens == "pinhole"
    assert any("fisheye_model: 1" in note for note in notes)


def test_left_right_and_extrinsics_files(tmp_path):
    for side, k, d in (("left", K1, D1), ("right", K2, D2)):
        storage(tmp_path / f"{side}.yml", {"camera_matrix": k, "dist_coeff": d})
    storage(tmp_path / "extrinsics.yml", {"R": R, "T": T})
    for name in ("left.yml", "right.yml", "extrinsics.yml", "."):
        check(load_rig(tmp_path / name, size_px=(640, 480)))


@pytest.mark.parametrize("compressed", [False, True])
def test_matlab_struct(tmp_path, compressed):
    path = tmp_path / "stereo.mat"
    savemat(path, matlab(True), do_compression=compressed)
    loaded = load_calibration(path)
    check(loaded)
    assert loaded[0].left.size_px == (640, 480)
    path.with_suffix(".json").write_text(json.dumps(plain(matlab(True)["stereoParams"])))
    check(load_calibration(path.with_suffix(".json")))


def test_bouguets_toolbox(tmp_path):
    content = {"om": cv2.Rodrigues(R)[0], "T": 1000 * T, "nx": 640.0, "ny": 480.0}
    for side, k, d in (("left", K1, D1), ("right", K2, D2)):
        content |= {
            f"fc_{side}": k[[0, 1], [0, 1]][:, None],
            f"cc_{side}": k[:2, 2:],
            f"kc_{side}": d.T,
        }
    savemat(tmp_path / "Calib_Results_stereo.mat", content)
    loaded = load_calibration(tmp_path / "Calib_Results_stereo.mat")
    check(loaded)
    assert loaded[0].left.size_px == (640, 480)


@pytest.mark.parametrize(
    ("content", "key_word"),
    [
        (
            {"Left_Stereo_Map_x": np.zeros((4, 4)), "Right_Stereo_Map_x": np.zeros((4, 4))},
            "remap tables",
        ),
        ({"K1": K1, "D1": D1, "R": R, "T": T}, "no M2, D2"),
        ({"K1": K1, "K2": K2, "R": R, "T": T}, "distortion coefficients D1"),
        ({"speed": np.ones((2, 2))}, "found the keys speed"),
    ],
)
def test_incomplete_files_are_named(tmp_path, content, key_word):
    for path in (storage(tmp_path / "a.yml", content), tmp_path / "a.npz"):
        if path.suffix == ".npz":
            np.savez(path, **content)
        with pytest.raises(RigError, match=key_word):
            load_calibration(path)


def test_pickles_and_other_files_are_not_opened(tmp_path):
    np.savez(tmp_path / "a.npz", calibration=np.array({"K1": K1}, dtype=object))
    np.save(tmp_path / "b.npy", np.array({"K1": K1}, dtype=object))
    (tmp_path / "c.pkl").write_bytes(b"\x80\x04\x95\x10\x00")
    for name in ("a.npz", "b.npy", "c.pkl"):
        with pytest.raises(RigError, match=r"pickle.*numpy\.savez"):
            load_calibration(tmp_path / name)
    (tmp_path / "d.mat").write_bytes(b"MATLAB 7.3 MAT-file" + bytes(500))
    with pytest.raises(RigError, match="-v7"):
        load_calibration(tmp_path / "d.mat")
    (tmp_path / "e.npz").write_bytes(b"PK\x03\x04" + bytes(100))
    with pytest.raises(RigError, match="NumPy"):
        load_calibration(tmp_path / "e.npz")


def test_unit_in_a_name(tmp_path):
    names = (
        "left_camera_matrix left_distortion right_camera_matrix right_distortion R_left_to_right "
        "T_left_to_right_mm"
    )
    (tmp_path / "a.json").write_text(json.dumps(plain(values(names, 400 * T))))
    # 37 mm, not 37 cm
    assert load_calibration(tmp_path / "a.json")[0].baseline_m == pytest.approx(0.4 * BASELINE_M)
    content = plain(values(NAMES[0])) | {"baseline_mm": 1000 * BASELINE_M}
    (tmp_path / "a.json").write_text(json.dumps(content))
    check(load_calibration(tmp_path / "a.json"))
    content = plain(values(NAMES[0], 200 * T)) | {"baseline_mm": 200 * BASELINE_M}
    (tmp_path / "a.json").write_text(json.dumps(content))
    assert load_calibration(tmp_path / "a.json")[0].baseline_m == pytest.approx(0.2 * BASELINE_M)


@pytest.mark.parametrize(("name", "units_per_m"), [("T_mm", 1000), ("t_cm", 100), ("T_m", 1)])
def test_unit_in_the_shortest_names(tmp_path, name, units_per_m):
    """A baseline of 3.7 m, which without its unit would be read as centimetres or be in doubt."""
    names = f"K1 D1 K2 D2 R {name}"
    (tmp_path / "a.json").write_text(json.dumps(plain(values(names, 40 * units_per_m * T))))
    assert load_calibration(tmp_path / "a.json")[0].baseline_m == pytest.approx(40 * BASELINE_M)


@pytest.mark.parametrize(
    "others",
    [
        {"T_mm": [-120, 0, 0], "T_m": [-0.5, 0, 0]},
        {"T_mm": [-500, 0, 0], "T": [-0.12, 0, 0]},
        {"T_m": [-0.5, 0, 0], "baseline_mm": 120},
        {"T": [-120, 0, 0], "baseline_m": 0.5},
    ],
)
def test_contradictory_lengths_in_any_order(tmp_path, others):
    content = plain(values("K1 D1 K2 D2 R T"))
    content.pop("T")
    first, second = others
    for keys in ((first, second), (second, first)):
        (tmp_path / "a.json").write_text(json.dumps(content | {key: others[key] for key in keys}))
        with pytest.raises(RigError) as error:
            load_calibration(tmp_path / "a.json")
        assert {first, second} <= set(str(error.value).split())


def test_a_focal_length_in_millimetres_is_none_in_pixels(tmp_path):
    content = plain(values(NAMES[0])) | {"focal_length_mm": 4.0, "sensor_width_mm": 6.4}
    (tmp_path / "a.json").write_text(json.dumps(content))
    check(load_calibration(tmp_path / "a.json"))
    scalars = {"focal_length_mm": 4.0, "fx": 543.75, "fy": 546.25, "cx": 335.5, "cy": 236.75}
    (tmp_path / "b.json").write_text(json.dumps(scalars | {"k1": 0.0}))
    assert load_calibration(tmp_path / "b.json")[0].fx_px == 543.75


def test_poses_by_flat_names_are_no_rectification(tmp_path):
    content = values(
        "camera_matrix_left dist_coeffs_left camera_matrix_right dist_coeffs_right R T"
    )
    content |= {
        "rot_matrix_left": np.eye(3),
        "t_left": np.zeros(3),
        "rot_matrix_right": R,
        "t_right": T.ravel(),
    }
    (tmp_path / "a.json").write_text(json.dumps(plain(content)))
    assert len(check(load_calibration(tmp_path / "a.json"))) == 1


def test_list_of_cameras(tmp_path):
    def camera(number: int, k: np.ndarray, r: np.ndarray, t: np.ndarray) -> dict[str, Any]:
        return {
            "id": f"cam_{number}",
            "distortion_model": "KB",
            "image_width": 640,
            "image_height": 480,
            "intrinsics": {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]},
            "distortion": {"k1": 0.01, "k2": 0.002, "k3": 0.0, "k4": 0.0},
            "extrinsics": {"rotation": r.tolist(), "translation": t.ravel().tolist()},
        }

    cameras = [camera(0, K1, np.eye(3), np.zeros(3)), camera(1, K2, R, 1000 * T)]
    (tmp_path / "a.json").write_text(json.dumps({"cameras": cameras}))
    rig, _ = load_calibration(tmp_path / "a.json")
    assert (rig.left.lens, rig.left.fx_px, rig.right.fx_px) == ("kannala-brandt", 543.75, 556.0)
    assert rig.right_from_left[:3, 3] == pytest.approx(T.ravel())


def test_wide_baselines_are_noted(tmp_path):
    notes = load_calibration(storage(tmp_path / "a.yml", values(NAMES[0], T * 20)))[1]
    assert any("wide baseline: if T counts squares" in note for note in notes)


def test_reprojection_matrix_alone(tmp_path):
    rig, notes = load_calibration(storage(tmp_path / "q.yml", {"Q": rectification()["Q"]}))
    p1 = rectification()["P1"]
    assert (rig.left.fx_px, rig.left.cx_px, rig.left.cy_px) == pytest.approx(
        (p1[0, 0], p1[0, 2], p1[1, 2])
    )
    assert rig.baseline_m == pytest.approx(BASELINE_M)
    assert "rectified" in notes[0]
