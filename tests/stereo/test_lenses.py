"""Lens models: inverse of each other, equal to OpenCV's, hand-worked values, and limits of what
they image."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from track_range.foundation.registry import PluginError
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.lenses.kannala_brandt import largest_angle_rad
from track_range.stereo.lenses.lens import KANNALA_BRANDT, PINHOLE, KalibrModel
from track_range.stereo.lenses.pinhole import undistort
from track_range.stereo.lenses.registry import LENSES, _check_kalibr
from track_range.stereo.rig_formats.reading import load_camera, load_rig
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig

TUM_VI = (0.0034823894, 0.0007150348, -0.0020532361, 0.00020293673)
"""Kannala-Brandt coefficients of a lens with 190 degrees."""

EXAMPLES = {
    PINHOLE: (-0.25, 0.08, 0.001, -0.0005, 0.0),
    "kannala-brandt": TUM_VI,
    "double-sphere": (-0.18, 0.59),
    "omni": (1.7, -0.15, 0.05, 0.001, -0.0008),
}

ANGLES_DEG = {PINHOLE: 40.0, "kannala-brandt": 100.0, "double-sphere": 100.0, "omni": 100.0}
"""Largest angle from the axis that is tested."""


def directions(largest_deg: float) -> np.ndarray:
    theta, phi = (
        part.ravel()
        for part in np.meshgrid(
            np.radians(np.linspace(0, largest_deg, 31)), np.linspace(0, 2 * np.pi, 24)
        )
    )
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1
    )


@pytest.mark.parametrize("name", list(EXAMPLES))
def test_undistortion_inverts_distortion(name):
    lens, rays = LENSES.named(name), directions(ANGLES_DEG[name])
    projected = lens.distort(5.0 * rays, EXAMPLES[name])  # the length of a direction has no effect
    assert np.isfinite(projected).all()
    assert np.allclose(lens.undistort(projected, EXAMPLES[name]), rays, atol=1e-7)


@given(st.tuples(*[st.floats(-0.02, 0.02)] * 4), st.floats(0.0, 1.4), st.floats(0, 6.28))
def test_kannala_brandt_inverse_for_any_coefficients(k, theta, phi):
    theta = min(theta, largest_angle_rad(k))
    ray = np.array(
        [[math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]]
    )
    assert np.allclose(
        LENSES.named(KANNALA_BRANDT).undistort(LENSES.named(KANNALA_BRANDT).distort(ray, k), k),
        ray,
        atol=1e-5,
    )


def test_kannala_brandt_equals_opencvs_fisheye():
    rays = directions(80)
    expected = cv2.fisheye.projectPoints(
        rays[:, None], np.zeros(3), np.zeros(3), np.eye(3), np.array(TUM_VI)
    )[0]
    assert np.allclose(
        LENSES.named(KANNALA_BRANDT).distort(rays, TUM_VI), expected.reshape(-1, 2), atol=1e-9
    )


def test_pinhole_equals_opencvs_projection():
    rays = directions(40)
    expected = cv2.projectPoints(
        rays, np.zeros(3), np.zeros(3), np.eye(3), np.array(EXAMPLES[PINHOLE])
    )[0]
    assert np.allclose(
        LENSES.named(PINHOLE).distort(rays, EXAMPLES[PINHOLE]), expected.reshape(-1, 2), atol=1e-9
    )


def test_double_sphere_by_hand():
    # xi = 0.5, alpha = 0.5, X = (3, 0, 4): d1 = 5, xi d1 + z = 6.5, d2 = sqrt(9 + 42.25)
    scale = 1 / (0.5 * math.sqrt(51.25) + 0.5 * 6.5)
    projected = LENSES.named("double-sphere").distort(np.array([[3.0, 0.0, 4.0]]), (0.5, 0.5))
    assert projected.tolist() == [pytest.approx([3 * scale, 0.0])]


def test_omni_without_distortion_by_hand():
    # xi = 1, X = (3, 4, 0): |X| = 5, m = (3, 4) / 5
    projected = LENSES.named("omni").distort(np.array([[3.0, 4.0, 0.0]]), (1.0, 0.0, 0.0, 0.0, 0.0))
    assert projected.tolist() == [pytest.approx([0.6, 0.8])]


def test_double_sphere_and_omni_without_offset_are_pinholes():
    rays = directions(60)
    ideal = rays[:, :2] / rays[:, 2:]
    assert np.allclose(LENSES.named("double-sphere").distort(rays, (0.0, 0.0)), ideal)
    assert np.allclose(LENSES.named("omni").distort(rays, (0.0,) * 5), ideal)


@pytest.mark.parametrize("name", list(EXAMPLES))
def test_what_a_lens_does_not_image_is_nan(name):
    lens = LENSES.named(name)
    behind = np.array([[0.0, 0.01, -1.0]])
    if name == "kannala-brandt":
        falling = (0.0, -0.1, 0.0, 0.0)  # the polynomial falls beyond 68 degrees
        assert np.degrees(largest_angle_rad(falling)) == pytest.approx(
            np.degrees((1 / 0.5) ** 0.25), abs=0.1
        )
        assert np.isnan(lens.distort(behind, falling)).all()
        assert np.isnan(lens.undistort(np.array([[5.0, 0.0]]), falling)).all()
    else:
        assert np.isnan(lens.distort(behind, EXAMPLES[name])).all()


def test_outside_the_image_circle_is_nan():
    assert np.isnan(
        LENSES.named("double-sphere").undistort(np.array([[9.0, 0.0]]), (0.5, 0.7))
    ).all()
    assert np.isnan(
        LENSES.named("omni").undistort(np.array([[9.0, 0.0]]), (1.5, 0.0, 0.0, 0.0, 0.0))
    ).all()


@pytest.mark.parametrize("name", list(EXAMPLES))
def test_no_points(name):
    assert LENSES.named(name).distort(np.zeros((0, 3)), EXAMPLES[name]).shape == (0, 2)
    assert LENSES.named(name).undistort(np.zeros((0, 2)), EXAMPLES[name]).shape == (0, 3)


@pytest.mark.parametrize("name", list(EXAMPLES))
def test_recorded_pixels_of_a_camera(name):
    camera = PinholeCamera(200.0, 210.0, 320.0, 240.0, 640, 480, EXAMPLES[name], name)
    rays = directions(ANGLES_DEG[name])
    assert np.allclose(camera.recorded_rays(camera.recorded_px(rays)), rays, atol=1e-7)
    assert camera.recorded_px(np.array([[0.0, 0.0, 3.0]])).tolist() == [
        pytest.approx([320.0, 240.0])
    ]
    assert camera.is_wide == (name != PINHOLE)
    assert camera.is_distorted
    assert not camera.without_distortion().is_distorted


def camera_of(name: str) -> PinholeCamera:
    """A camera with the example of a lens."""
    return PinholeCamera(420.0, 421.0, 319.5, 239.5, 640, 480, EXAMPLES[name], name)


def test_each_lens_has_an_example():
    assert tuple(EXAMPLES) == LENSES.names


@pytest.mark.parametrize("name", LENSES.names)
def test_every_lens_is_written_to_rig_yaml_and_read_back(name, tmp_path):
    camera, path = camera_of(name), tmp_path / "rig.yaml"
    save_camera(camera, path)
    assert load_camera(path, size_px=None) == (camera, ())
    rig = StereoRig.rectified(camera, 0.4)
    save_rig(rig, path)
    again, _ = load_rig(path, size_px=camera.size_px)
    assert (again.left, again.right) == (camera, camera)


@pytest.mark.parametrize(
    ("name", "model"),
    [(name, model) for name, lens in LENSES.usable.items() for model in lens.kalibr],
)
def test_every_lens_is_read_from_a_file_of_kalibr(name, model, tmp_path):
    given = EXAMPLES[name][: model.n_intrinsics + 4]
    before, after = given[: model.n_intrinsics], given[model.n_intrinsics :]
    distortion = [] if model.distortion == "none" else list(after)
    (path := tmp_path / "camchain.yaml").write_text(
        f"cam0: {{camera_model: {model.camera}, distortion_model: {model.distortion}, "
        f"intrinsics: {[*before, 420.0, 421.0, 319.5, 239.5]}, "
        f"distortion_coeffs: {distortion}, resolution: [640, 480]}}\n"
    )
    camera, _ = load_camera(path, size_px=(640, 480))
    assert (camera.lens, camera.matrix.tolist()) == (name, camera_of(name).matrix.tolist())
    if model.distortion != "none" or not after:
        assert camera.distortion == given
    else:
        assert not any(camera.distortion[model.n_intrinsics :])


def test_a_lens_with_many_coefficients_is_read_from_a_file_of_kalibr(tmp_path, monkeypatch):
    """Four of eight coefficients stand before fu."""
    many = replace(
        LENSES.named("omni"),
        coefficients=tuple("abcdefgh"),
        distort=lambda rays, _: rays[:, :2] / rays[:, 2:],
        undistort=lambda points, _: undistort(points, ()),
        kalibr=(KalibrModel("many", "poly", n_intrinsics=3),),
    )
    monkeypatch.setitem(LENSES.registered, "many", many)
    (path := tmp_path / "camchain.yaml").write_text(
        "cam0: {camera_model: many, distortion_model: poly, resolution: [640, 480], "
        "intrinsics: [1, 2, 3, 420, 421, 319.5, 239.5], distortion_coeffs: [4, 5, 6, 7, 8]}\n"
    )
    camera, _ = load_camera(path, size_px=(640, 480))
    assert (camera.lens, camera.distortion) == ("many", (1, 2, 3, 4, 5, 6, 7, 8))
    path.write_text(path.read_text().replace(", 8]", "]"))
    with pytest.raises(RigError, match=r"expected 8 coefficients .*distortion_coeffs, found 7"):
        load_camera(path, size_px=(640, 480))


def test_a_lens_of_a_package_with_a_taken_name_of_kalibr_is_refused():
    with pytest.raises(PluginError, match="Kalibr's ds with none is the name of another lens"):
        _check_kalibr(LENSES.named("double-sphere"), LENSES.usable.values(), ())


def test_two_lenses_with_one_name_of_kalibr(tmp_path, monkeypatch):
    monkeypatch.setitem(LENSES.registered, "other", LENSES.named("double-sphere"))
    (path := tmp_path / "camchain.yaml").write_text(
        "cam0: {camera_model: ds, intrinsics: [-0.2, 0.6, 240, 240, 320, 240]}"
    )
    with pytest.raises(RigError, match="Kalibr's ds with none, found double-sphere and other"):
        load_camera(path, size_px=None)


def test_unknown_lens_names_the_known_ones(tmp_path):
    save_camera(camera_of("omni"), path := tmp_path / "rig.yaml")
    path.write_text(path.read_text().replace("lens: omni", "lens: fisheye"))
    with pytest.raises(RigError, match=r"'double-sphere' or 'omni', .*'fisheye'"):
        load_camera(path, size_px=None)
