"""Tests of the masks of heads and number plates, and of the plates' geometry."""

import cv2
import numpy as np
import pytest

from track_range.simulation.camera.drive_files import masks_of
from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.settings import DriveOptions
from track_range.simulation.world.bodies.faces import IdentifyingPart
from track_range.simulation.world.bodies.road_users import BUILDERS
from track_range.simulation.world.scene import AWAY_RAD, SIZE_HWL_M, TOWARDS_RAD, RoadUser, Scene

RIG = kitti_like_rig(width_px=620, height_px=188)


USERS = (
    ("Car", -4.0, 12.0, AWAY_RAD),
    ("Car", 4.0, 12.0, TOWARDS_RAD),
    ("Pedestrian", -1.0, 9.0, AWAY_RAD),
    ("Cyclist", 1.0, 9.0, TOWARDS_RAD),
    ("Pedestrian", -1.89, 17.0, AWAY_RAD),
)
"""Type, x, z and heading; the first pedestrian hides the second one."""


@pytest.fixture(scope="module")
def masks():
    """Part and road user of each pixel."""
    users = (
        RoadUser(
            track_id=10 + n,
            kitti_type=kind,
            size_hwl_m=SIZE_HWL_M[kind],
            start_xz_m=(x, z),
            rotation_y_rad=heading,
        )
        for n, (kind, x, z, heading) in enumerate(USERS)
    )
    scene = Scene(seed=1, ego_speed_mps=0.0, road_users=tuple(users))
    return masks_of(Renderer(scene, RIG, noise_grey=0).render_with_labels(0.0)[2])


@pytest.mark.parametrize("kind", ["Car", "Van", "Truck", "Bus", "Motorcycle"])
def test_plates_are_inside_the_3d_box(kind):
    faces = BUILDERS[kind](np.random.default_rng(0), SIZE_HWL_M[kind])
    plates = [face for face in faces if face.part == IdentifyingPart.PLATE]
    assert len(plates) == (1 if kind == "Motorcycle" else 2)
    height, width, length = SIZE_HWL_M[kind]
    for plate in plates:
        corners = (
            plate.corner + np.outer([0, 1, 0, 1], plate.along) + np.outer([0, 0, 1, 1], plate.down)
        )
        assert (np.abs(corners[:, 0]) <= length / 2).all()
        assert (np.abs(corners[:, 2]) <= width / 2).all()
        assert ((corners[:, 1] <= 0) & (corners[:, 1] >= -height)).all()


@pytest.mark.parametrize("user", [0, 1])
def test_plate_of_a_car(masks, user):
    part, row = masks
    rows, columns = np.nonzero((part > 0) & (row == user))
    assert set(part[rows, columns]) == {IdentifyingPart.PLATE}
    px_per_m = RIG.left.fx_px / (12.0 - SIZE_HWL_M["Car"][2] / 2)
    assert 0.35 * px_per_m < np.ptp(columns) + 1 < 0.55 * px_per_m
    assert 0.07 * px_per_m < np.ptp(rows) + 1 < 0.18 * px_per_m
    assert abs(columns.mean() - (RIG.left.cx_px + USERS[user][1] * px_per_m)) < 2


@pytest.mark.parametrize("user", [2, 3])
def test_heads(masks, user):
    part, row = masks
    px_per_m = RIG.left.fx_px / 9.0
    rows, columns = np.nonzero((part == IdentifyingPart.HEAD) & (row == user))
    assert abs(columns.mean() - (RIG.left.cx_px + USERS[user][1] * px_per_m)) < 6
    assert abs(rows.min() - (RIG.left.cy_px - (SIZE_HWL_M["Pedestrian"][0] - 1.65) * px_per_m)) < 3
    assert np.ptp(rows) < 0.3 * px_per_m


def test_hidden_parts_are_not_in_the_masks(masks):
    part, row = masks
    whole_px = ((part == IdentifyingPart.HEAD) & (row == 2)).sum() * (9 / 17) ** 2
    assert ((part == IdentifyingPart.HEAD) & (row == 4)).sum() < 0.3 * whole_px


def test_a_pixel_needs_two_samples():
    samples = np.zeros((2, 6), np.uint16)
    samples[0, 2], samples[:, 4], samples[0, 5] = 5, 6, 5
    part, row = masks_of(samples)
    assert part.tolist() == [[0, 0, 2]]
    assert row.tolist() == [[0, 0, 2]]


@pytest.mark.slow
def test_mask_files_have_the_track_ids(tmp_path):
    write_drive(
        tmp_path,
        seconds=0.1,
        rig=kitti_like_rig(width_px=310, height_px=94),
        options=DriveOptions(masks=True),
    )
    part = cv2.imread(str(tmp_path / "masks" / "000000.png"), cv2.IMREAD_UNCHANGED)
    number = cv2.imread(str(tmp_path / "mask_ids" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert (part.dtype, part.shape) == (np.uint8, (94, 310))
    assert number.dtype == np.uint16
    assert set(np.unique(part)) <= {0, 1, 2}
    assert ((part > 0) == (number > 0)).all()
