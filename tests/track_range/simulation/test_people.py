"""Tests of the bodies of people and cyclists: their extent, and detection by the packaged
detector."""

import numpy as np
import pytest

import track_range as tr
from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES
from track_range.simulation.render.canvas import OPAQUE_ALPHA
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.bodies.faces import lid, loft, ring
from track_range.simulation.world.bodies.road_users import body_of
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import SIZE_HWL_M, RoadUser
from track_range.simulation.world.truth import visible_objects

RIG = kitti_like_rig()
UPRIGHT = {ROAD_CLASSES.index(name) for name in ("person", "bicycle", "motorcycle")}


def drawn_points(faces):
    """(N, 3) centres of the opaque texels, without shadows."""
    points = []
    for face in faces:
        if not face.is_shadow:
            row, column = np.nonzero(face.texture[:, :, 3] >= OPAQUE_ALPHA)
            height, width = face.texture.shape[:2]
            along, down = (column + 0.5) / width, (row + 0.5) / height
            points.append(face.corner + along[:, None] * face.along + down[:, None] * face.down)
    return np.concatenate(points)


@pytest.mark.parametrize("kind", ["Pedestrian", "Cyclist"])
@pytest.mark.parametrize("scale", [0.92, 1.0, 1.08])
@pytest.mark.parametrize("seed", [0, 1])
def test_body_fills_its_box(kind, scale, seed):
    size = tuple(scale * side for side in SIZE_HWL_M[kind])
    user = RoadUser(
        track_id=5, kitti_type=kind, size_hwl_m=size, start_xz_m=(0.0, 0.0), rotation_y_rad=0.0
    )
    points = drawn_points(body_of(user, seed))
    height, width, length = size
    low, high = np.array([-length / 2, -height, -width / 2]), np.array([length / 2, 0.0, width / 2])
    assert (points > low - 0.005).all()
    assert (points < high + 0.005).all()
    np.testing.assert_allclose(points.min(axis=0), low, atol=0.015)
    np.testing.assert_allclose(points.max(axis=0), high, atol=0.015)


def test_loft_is_a_closed_cone():
    """All points lie on the surface between two ellipses, and the faces look outwards."""
    rng = np.random.default_rng(0)
    low, high = ring((0.0, 0.0, 0.0), (0.2, 0.1)), ring((0.0, 1.0, 0.0), (0.1, 0.05))
    faces = loft(rng, low, high, (90, 90, 90))
    for face in faces:
        centre = face.corner + 0.5 * face.along + 0.5 * face.down
        assert np.cross(face.along, face.down) @ (centre * (1, 0, 1)) < 0
    points = drawn_points(faces)
    radius = np.hypot(points[:, 0] / 0.2, points[:, 2] / 0.1) + 0.5 * -points[:, 1]  # 1 on the cone
    assert radius.min() > 0.90
    assert radius.max() < 1.05  # half a texel beyond


def test_lid_covers_its_ring():
    corners = ring((0.3, 1.0, -0.2), (0.2, 0.1))
    points = drawn_points([lid(np.random.default_rng(0), corners, (90, 90, 90))])
    offset = np.abs(points - (0.3, -1.0, -0.2))
    assert offset[:, 1].max() == 0
    assert np.hypot(offset[:, 0] / 0.2, offset[:, 2] / 0.1).max() < 1.1
    assert offset[:, [0, 2]].max(axis=0) == pytest.approx([0.185, 0.092], abs=0.03)


@pytest.mark.slow
def test_packaged_detector_finds_people():
    """At least 70 % of people and cyclists within 15 m in the demo's scenario are detected with
    confidence 0.25."""
    scene = make_scenario("crossing", seed=0, seconds=6.0)
    renderer, detector = Renderer(scene, RIG), tr.Detector("road", min_score=0.25)
    is_detected = []
    for time_s in (2.8, 3.6, 4.4, 5.2):
        image, inverse_depth = renderer.render_with_depth(time_s)
        visible = visible_objects(
            scene, time_s, frame=0, camera=RIG.left, inverse_depth=inverse_depth
        )
        labels, detections = visible.labels, detector.detect(image)
        is_upright = np.isin(labels.kitti_type, ["Pedestrian", "Cyclist"])
        chosen = is_upright & (visible.visible_share > 0.6) & (labels.location_m[:, 2] < 15)
        boxes = detections.xyxy_px[np.isin(detections.class_id, list(UPRIGHT))]
        is_detected.extend(iou(labels.xyxy_px[chosen], boxes).max(axis=1, initial=0) >= 0.5)
    assert len(is_detected) > 15
    assert np.mean(is_detected) > 0.7
