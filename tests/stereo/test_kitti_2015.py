"""The reader of KITTI 2015: its protocol by hand, the real set, and wrong sets."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.recordings.kitti_folder import (
    BASELINE_M,
    CALIBRATION,
    CARS,
    FOCAL_PX,
    write_pair,
    write_set,
)
from track_range.stereo.evaluation.kitti_2015 import (
    PairFileError,
    is_kitti_2015,
    labelled_instances,
    pair_names,
    read_pairs,
)
from track_range.stereo.geometry.rig import RigError


def test_pairs_of_a_set(tmp_path: Path) -> None:
    write_set(tmp_path, ("000007_10", "000002_10"))
    write_pair(tmp_path, "000002_11", seed=9)  # the next frame, without truth
    for part in ("disp_occ_0", "obj_map"):
        (tmp_path / part / "000002_11.png").unlink()
    assert is_kitti_2015(tmp_path)
    first, second = read_pairs(tmp_path)
    assert (first.name, second.name) == ("000002_10", "000007_10")
    assert first.left.shape == first.right.shape == (120, 360, 3)
    assert not np.array_equal(first.left, second.left)
    assert first.xyxy_px.tolist() == [
        [x1 - 0.5, y1 - 0.5, x2 + 0.5, y2 + 0.5] for x1, y1, x2, y2, _ in CARS
    ]
    assert first.true_px.tolist() == [20.0, 30.0]
    assert first.x_px.tolist() == [129.5, 259.5]
    assert (first.rig.left.fx_px, first.rig.baseline_m) == (FOCAL_PX, pytest.approx(BASELINE_M))
    assert (first.rig.left.width_px, first.rig.left.height_px) == (360, 120)


def test_parent_folder_and_calibration_per_pair(tmp_path: Path) -> None:
    root = write_set(tmp_path / "training")
    (root / "calib_cam_to_cam").mkdir()
    other = (
        CALIBRATION.replace("P2", "P_rect_02").replace("P3", "P_rect_03").replace("300.0", "310.0")
    )
    (root / "calib_cam_to_cam/000001.txt").write_text(other)
    assert is_kitti_2015(tmp_path)
    assert [pair.rig.left.fx_px for pair in read_pairs(tmp_path)] == [300.0, 310.0]


def test_rig_of_the_user(tmp_path: Path) -> None:
    write_set(tmp_path / "set")
    (tmp_path / "set/calib.txt").unlink()
    (tmp_path / "rig.txt").write_text(CALIBRATION.replace("300.0", "320.0"))
    assert next(read_pairs(tmp_path / "set", rig=tmp_path / "rig.txt")).rig.left.fx_px == 320.0


def test_simulated_set_has_its_rig_and_all_classes(tmp_path: Path) -> None:
    write_set(tmp_path)
    assert set(next(read_pairs(tmp_path)).class_names) == {"car"}
    (tmp_path / "calib.txt").rename(tmp_path / "rig.yaml")
    (tmp_path / "truth.csv").touch()
    pair = next(read_pairs(tmp_path))
    assert pair.rig.left.fx_px == FOCAL_PX
    assert pair.class_names == ()


def test_grey_images_and_row_offset(tmp_path: Path) -> None:
    write_set(tmp_path, ("a",))
    plain = next(read_pairs(tmp_path))
    assert np.array_equal(plain.left[:, :, 0], plain.left[:, :, 2])
    shifted = next(read_pairs(tmp_path, row_offset_px=2.0))
    assert np.array_equal(
        np.asarray(shifted.right[10:50, 20:80]), np.asarray(plain.right)[12:52, 20:80, 0]
    )
    assert np.array_equal(shifted.left, plain.left)


def test_instances_by_hand() -> None:
    instance = np.zeros((60, 80), np.uint8)
    truth = np.zeros((60, 80))
    instance[10:30, 10:30] = 1  # known outside its inner half only, but for 19 pixels
    truth[10:30, 10:15] = 7.0
    truth[16, 15:25], truth[17, 15:24] = 7.0, 7.0
    instance[10:30, 40:60] = 3  # 99 known pixels
    truth[15:24, 45:56] = 9.0
    # all known: half of the inner half at 5, more of it at 6, the rest at 40
    instance[40:50, 10:30] = 5
    truth[40:50, 10:30] = 40.0
    truth[42:48, 14:26] = 6.0
    truth[43:45, 15:25] = 5.0
    boxes, true_px = labelled_instances(truth, instance)
    assert boxes.tolist() == [[9.5, 39.5, 29.5, 49.5]]
    # rows 42 .. 47, columns 15 .. 24 (2.5 and 5 px cut off): 40 of 6, 20 of 5
    assert true_px.tolist() == [6.0]
    truth[18, 15] = 7.0  # the twentieth pixel of the first
    truth[15, 40] = 9.0  # the hundredth of the second
    boxes, true_px = labelled_instances(truth, instance)
    assert true_px.tolist() == [7.0, 9.0, 6.0]
    assert labelled_instances(truth, np.zeros_like(instance))[0].shape == (0, 4)


def drop(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def drop_folder(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).rename(folder / f"not-{name}")


def rewrite(name: str, image: np.ndarray) -> Callable[[Path], None]:
    return lambda folder: cv2.imwrite(str(folder / name), image) and None


def damage(name: str, content: bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_bytes(content) and None


FIRST = "000000_10.png"


@pytest.mark.parametrize(
    ("spoil", "key_word"),
    [
        (drop_folder("image_3"), "no image_3"),
        (drop_folder("obj_map"), "no obj_map"),
        (drop(f"image_3/{FIRST}"), f"image_3/{FIRST}: no such file"),
        (drop(f"obj_map/{FIRST}"), f"obj_map/{FIRST}: no such file"),
        (damage(f"image_2/{FIRST}", b"damaged"), f"image_2/{FIRST}"),
        (damage(f"image_2/{FIRST}", b""), f"image_2/{FIRST}"),
        (rewrite(f"image_3/{FIRST}", np.zeros((120, 358), np.uint8)), "358x120"),
        (rewrite(f"disp_occ_0/{FIRST}", np.zeros((120, 360), np.uint8)), "16-bit"),
        (rewrite(f"obj_map/{FIRST}", np.zeros((120, 360, 3), np.uint8)), "grey values"),
    ],
)
def test_wrong_sets(tmp_path: Path, spoil: Callable[[Path], None], key_word: str) -> None:
    spoil(write_set(tmp_path))
    with pytest.raises(PairFileError) as error:
        list(read_pairs(tmp_path))
    assert key_word in str(error.value)


def test_an_image_that_cannot_be_opened(tmp_path: Path) -> None:
    write_set(tmp_path)
    (tmp_path / "image_2" / FIRST).unlink()
    (tmp_path / "image_2" / FIRST).mkdir()
    with pytest.raises(PairFileError, match="folder"):
        list(read_pairs(tmp_path))


def test_missing_folder_and_truth(tmp_path: Path) -> None:
    with pytest.raises(PairFileError, match="no such folder"):
        pair_names(tmp_path / "nowhere")
    with pytest.raises(
        PairFileError, match="no image_2 and no image_3 and no disp_occ_0 and no obj_map"
    ):
        pair_names(tmp_path)
    write_set(tmp_path)
    for truth in (tmp_path / "disp_occ_0").iterdir():
        truth.unlink()
    with pytest.raises(PairFileError, match="true disparities"):
        pair_names(tmp_path)


def test_missing_or_unrectified_calibration(tmp_path: Path) -> None:
    write_set(tmp_path)
    (tmp_path / "calib.txt").unlink()
    with pytest.raises(RigError, match=r"calib_cam_to_cam/000000\.txt"):
        list(read_pairs(tmp_path))
    camera = (
        "{fx_px: 300, fy_px: 300, cx_px: 180, cy_px: 60, width_px: 360, height_px: 120, "
        "distortion: [0.1, 0, 0, 0]}"
    )
    motion = "{rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], translation_m: [-0.5, 0, 0]}"
    text = f"track_range_rig: 1\nleft: {camera}\nright: {camera}\nright_from_left: {motion}\n"
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(RigError, match="rectified"):
        list(read_pairs(tmp_path, rig=tmp_path / "rig.yaml"))


def test_the_real_set(shared_data: Path) -> None:
    pairs = list(read_pairs(shared_data / "kitti2015"))
    assert len(pairs) == 16
    assert sum(len(pair.true_px) for pair in pairs) == 36
    distance_m = np.concatenate([pair.rig.distance_m(pair.true_px) for pair in pairs])
    assert 4.5 < distance_m.min() < 6
    assert 45 < distance_m.max() < 60
    assert all((pair.xyxy_px[:, 2:] > pair.xyxy_px[:, :2]).all() for pair in pairs)
