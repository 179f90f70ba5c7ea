"""The plane of the road: exact geometry, fits to points, lengths and lines, its sigmas, its file."""

import numpy as np
import pytest

from track_range.ranging.world.ground_file import (
    GroundFile,
    checked_plane,
    read_ground,
    save_ground,
)
from track_range.ranging.world.road_plane import RoadPlane
from track_range.ranging.world.road_plane_fit import (
    GroundError,
    PlaneMeasurements,
    PlanePriors,
    fit_plane,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting

CAMERA = PinholeCamera.of_focal_length(1000.0, (1280, 720))
USUAL = PlanePriors(camera=PinholeCamera.of_focal_length(1150.0, (1280, 720)), focal_sigma=0.35)
KNOWN = PlanePriors(camera=CAMERA, focal_sigma=0.005)
TRUE = RoadPlane.of_mounting(CAMERA, Mounting(pitch_deg=18.0, z_m=6.0))
CORNERS_M = np.array([(12.0, 3.5), (12.0, -3.5), (36.0, 3.5), (36.0, -3.5)])


def shown_px(xy_m):
    return TRUE.pixels(np.concatenate([xy_m, np.zeros((len(xy_m), 1))], axis=1))


def measured(points_m=(), lengths_m=(), lines_m=(), *, rng=None, shift_m=(0.0, 0.0), y_sign=1.0):
    """Measurements of points, lengths (ends) and pairs of lines (four ends) of the true plane."""
    points, lengths, lines = (
        np.array(part, np.float64).reshape(-1, *shape)
        for part, shape in ((points_m, (2,)), (lengths_m, (2, 2)), (lines_m, (4, 2)))
    )
    pixels = [
        shown_px(part.reshape(-1, 2)).reshape(part.shape) for part in (points, lengths, lines)
    ]
    if rng is not None:
        pixels = [part + rng.normal(0.0, 1.5, part.shape) for part in pixels]
    kinds = (("point", points), ("length", lengths), ("lines", lines))
    names = [f"{kind} {i}" for kind, part in kinds for i in range(len(part))]
    return PlaneMeasurements(
        point_px=pixels[0],
        point_m=points * [1.0, y_sign] + np.array(shift_m),
        length_px=pixels[1],
        length_m=np.linalg.norm(lengths[:, 1] - lengths[:, 0], axis=1),
        parallel_px=pixels[2],
        names=tuple(names),
    )


def test_the_middle_of_the_image_is_height_over_tangent_ahead():
    centre = np.array([[CAMERA.cx_px, CAMERA.cy_px]])
    assert TRUE.on_road_m(centre)[0] == pytest.approx([6.0 / np.tan(np.radians(18.0)), 0.0])
    above = np.array([[CAMERA.cx_px, 0.0]])  # 18 - 19.8 degrees: above the horizon
    assert np.isnan(TRUE.on_road_m(above)).all()
    assert TRUE.on_road_m(shown_px(CORNERS_M)) == pytest.approx(CORNERS_M)


@pytest.mark.parametrize("y_sign", [1.0, -1.0])
def test_four_points_give_plane_and_camera_in_any_frame(y_sign):
    plane = fit_plane(measured(CORNERS_M, shift_m=(100.0, 7.0), y_sign=y_sign), USUAL)
    assert plane.is_mirrored == (y_sign < 0)
    summary = plane.summary()
    assert summary["focal_px"] == pytest.approx(1000.0, rel=0.02)
    assert summary["height_m"] == pytest.approx(6.0, rel=0.02)
    assert summary["pitch_deg"] == pytest.approx(18.0, abs=0.5)
    found_m = plane.on_road_m(shown_px(np.array([[20.0, 1.0]])))[0]
    assert found_m == pytest.approx([120.0, y_sign * (7.0 + y_sign * 1.0)], abs=0.05)


def test_lengths_with_a_focal_length():
    ends = [[(12, 3), (12, -3)], [(34, 3), (34, -3)], [(12, 3), (24, 3)]]
    plane = fit_plane(measured(lengths_m=ends), KNOWN)
    assert plane.summary()["height_m"] == pytest.approx(6.0, rel=0.02)
    moved_m = np.diff(plane.on_road_m(shown_px(np.array([[15.0, 0.0], [25.0, 0.0]]))), axis=0)
    assert np.linalg.norm(moved_m) == pytest.approx(10.0, rel=0.02)


def test_parallel_lines_determine_what_two_lengths_across_leave_open():
    across = [[(12, 3), (12, -3)]]
    with pytest.raises(GroundError, match="along the view are known to"):
        fit_plane(measured(lengths_m=across), USUAL)
    kerbs = [[(10, 4), (40, 4), (10, -4), (40, -4)]]
    plane = fit_plane(measured(lengths_m=across, lines_m=kerbs), KNOWN)
    assert max(plane.scale_sigma(shown_px(CORNERS_M))) < 0.1


def test_measurements_that_contradict_one_another_are_named():
    wrong = measured(CORNERS_M, lengths_m=[[(12, 3), (24, 3)]])
    wrong.length_m[0] = 20.0
    with pytest.raises(GroundError, match="fit one plane"):
        fit_plane(wrong, KNOWN)


@pytest.mark.slow
def test_sigmas_cover_the_errors_of_clicks():
    rng, errors = np.random.default_rng(0), []
    at_px = shown_px(np.array([[18.0, 0.0], [28.0, 0.0]]))
    for _ in range(10):
        plane = fit_plane(measured(CORNERS_M, rng=rng), KNOWN)
        at_m = plane.on_road_m(at_px)
        length_m = float(np.linalg.norm(at_m[1] - at_m[0]))
        _, covariance = plane.shared_covariance(at_m[:1], np.array([[10.0, 0.0]]))
        errors.append((length_m - 10.0) / np.sqrt(covariance[0, 0, 0]))
    assert 0.4 < np.sqrt(np.mean(np.square(errors))) < 1.7


def test_file_gives_the_plane_back_and_is_checked(tmp_path):
    plane = fit_plane(measured(CORNERS_M), USUAL)
    save_ground(tmp_path / "ground.yaml", GroundFile(plane, 1000.0))
    again = read_ground(tmp_path / "ground.yaml")
    assert again.plane.theta == pytest.approx(plane.theta)
    assert again.plane.covariance == pytest.approx(plane.covariance)
    assert again.plane.residuals == plane.residuals
    assert again.plain_focal_px is None
    with pytest.raises(GroundError, match="640x360"):
        checked_plane(tmp_path / "ground.yaml", PinholeCamera.of_focal_length(500.0, (640, 360)))
    with pytest.raises(GroundError, match="focal length"):
        checked_plane(tmp_path / "ground.yaml", CAMERA.with_focal_length(1100.0))
    save_ground(tmp_path / "plain.yaml", GroundFile(plane))
    with pytest.raises(GroundError, match="omit the calibration"):
        checked_plane(tmp_path / "plain.yaml", CAMERA.with_focal_length(1400.0))
    text = (tmp_path / "ground.yaml").read_text().replace("log_focal", "log_focus")
    (tmp_path / "wrong.yaml").write_text(text)
    with pytest.raises(GroundError, match=r"wrong\.yaml"):
        read_ground(tmp_path / "wrong.yaml")
