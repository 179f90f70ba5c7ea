"""The method `depth`: from the depths of a network's file to distances."""

import numpy as np
import pytest

from tests.support.networks.depth_networks import encoded, write_depth
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.measurement.relative_depth import RelativeFit
from track_range.ranging.methods.method import MethodContext, MethodError
from track_range.ranging.methods.network_depth import (
    DEPTH,
    NetworkDepthRanger,
    OwnDistances,
    network_method,
)
from track_range.ranging.networks.network import open_depth_network
from track_range.ranging.registry import METHODS
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.ranging.size_models.network_scale import NetworkErrors, NetworkScale
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

HW = (192, 640)
CAMERA = PinholeCamera(500.0, 500.0, 319.5, 95.5, HW[1], HW[0])
LEFT_PX = np.arange(6) * 100.0 + 20
BOXES = np.stack([LEFT_PX, 0 * LEFT_PX + 50, LEFT_PX + 70, 0 * LEFT_PX + 140], axis=1)
TRUE_M = np.array([8.0, 12.0, 18.0, 25.0, 35.0, 50.0])


def tracks(is_observed=True):
    n = len(BOXES)
    return Tracks(np.arange(n), BOXES, np.full(n, 2), np.ones(n), np.full(n, is_observed))


def frame(index=0, depth_m=TRUE_M):
    depth = np.full(HW, 80.0)
    depth[150:] = 0.3  # the road, which is nearest
    for (x0, y0, x1, y1), value in zip(BOXES.astype(int), depth_m, strict=True):
        depth[y0 : y1 + 1, x0 : x1 + 1] = value
    return Frame(index, 0.1 * index, encoded(depth), None)


@pytest.fixture
def ranger_of(tmp_path):
    """Opens the method of a made network; closes its rangers."""
    opened = []

    def ranger(kind=NetworkDepthRanger, **options):
        network = open_depth_network(write_depth(tmp_path / "net.onnx", **options))
        opened.append(kind("depth", network, CAMERA, network.format.errors))
        return opened[-1]

    yield ranger
    for one in opened:
        one.close()


@pytest.mark.parametrize("gives", ["depth", "inverse_depth"])
def test_metres_from_the_file_of_a_network(ranger_of, gives):
    ranger, shown = ranger_of(OwnDistances, gives=gives, factor=1.0), frame()
    ranger.start(shown)
    ranges = ranger.measure(tracks(), shown)
    np.testing.assert_allclose(ranges.distance_m, TRUE_M, rtol=0.02)
    assert not ranges.is_fallback
    assert ranger.background_s > 0
    assert ranger.dense is not None
    assert np.isnan(ranger.measure(tracks(is_observed=False), frame(1)).distance_m).all()


def test_distances_are_corrected_by_the_scale_of_the_drive(ranger_of):
    ranger, shown = ranger_of(factor=0.5), frame()
    measured = ranger.measure_at_scale(tracks(), shown, {}, DriveScale())
    np.testing.assert_allclose(measured.by_network.ranges.distance_m, TRUE_M / 2, rtol=0.02)
    sigma = measured.ranges.sigma_m / measured.ranges.distance_m
    assert (sigma > 0.3).all()
    known = NetworkScale(log_factor=np.log(0.5), sigma=0.03)
    scale = DriveScale(network={"depth": known})
    corrected = ranger.measure_at_scale(tracks(), frame(1), {}, scale).ranges
    np.testing.assert_allclose(corrected.distance_m[1:5], TRUE_M[1:5], rtol=0.1)
    assert (np.abs(corrected.distance_m - TRUE_M) < 2 * corrected.sigma_m).all()


def test_beside_a_pair_it_is_fused_only_where_others_do_not_measure(ranger_of):
    """Also after the correction by what the frame itself shows, which begins with its own ranges."""
    ranger, shown = ranger_of(), frame()
    pair = Ranges(np.arange(len(TRUE_M)), TRUE_M, 0.02 * TRUE_M)
    for others, is_fallback in (({}, False), ({"mono": pair}, False), ({"stereo": pair}, True)):
        measured = ranger.measure_at_scale(tracks(), shown, others, DriveScale())
        assert measured.ranges.is_fallback is is_fallback
        assert measured.by_network.ranges.is_fallback is is_fallback


def test_measured_errors_of_the_file_are_used(ranger_of):
    settings = "errors: {factor: 0.5, drive_sigma: 0.05, track_sigma: 0.03, class_sigma: 0.02}\n"
    measured = ranger_of(factor=0.5, settings=settings).measure_at_scale(
        tracks(), frame(), {}, DriveScale()
    )
    assert measured.by_network.errors == NetworkErrors(
        factor=0.5, drive_sigma=0.05, track_sigma=0.03, class_sigma=0.02
    )
    np.testing.assert_allclose(measured.ranges.distance_m[1:5], TRUE_M[1:5], rtol=0.15)


def test_relative_network_is_calibrated_by_others_and_not_fused_with_them(ranger_of):
    """Inverse depths times 3 plus 0.1 in each frame; the last object has no other distance."""
    ranger = ranger_of(gives="inverse_depth", settings="metric: false\n")
    known_m = np.where(TRUE_M < 50, TRUE_M, np.nan)
    others = {"mono": Ranges(np.arange(6), known_m, 0.08 * known_m)}
    for index in range(5):
        relative_m = 1 / (3 / TRUE_M + 0.1 + 0.002 * index)
        shown = frame(index, relative_m)
        measured = ranger.measure_at_scale(tracks(), shown, others, DriveScale())
        assert measured.by_network is None
        assert measured.ranges.is_fallback
    errors = np.abs(measured.ranges.distance_m / TRUE_M - 1)
    assert (errors[:5] < 0.12).all()
    assert (np.abs(measured.ranges.distance_m - TRUE_M) < 2 * measured.ranges.sigma_m).all()
    (note,) = ranger.notes
    assert "scale and shift" in note


def test_relative_fit_needs_objects_at_several_distances():
    fit = RelativeFit()
    same_m = np.full(5, 20.0)
    fit.update(1 / same_m, same_m, 0.1 * same_m, 0.0)
    assert np.isnan(fit.distances(1 / same_m, 0 * same_m)[0]).all()


def test_relative_fit_is_robust_and_covers_its_errors():
    rng, within = np.random.default_rng(2), []
    for _ in range(40):
        fit = RelativeFit()
        true_m = np.exp(rng.uniform(np.log(6), np.log(60), 10))
        q = 5 / true_m * np.exp(rng.normal(0, 0.08, 10)) + 0.3
        reference_m = true_m * np.exp(rng.normal(0, 0.08, 10))
        reference_m[0] *= 3  # a mismatch
        fit.update(q, reference_m, 0.08 * reference_m, 0.0)
        distance_m, sigma_m = fit.distances(q, 0 * q)
        within.append(np.abs(distance_m - true_m)[1:] < sigma_m[1:])
    assert 0.55 < np.concatenate(within).mean() < 0.95


def test_relative_depths_have_a_free_factor(ranger_of):
    ranger = ranger_of(factor=0.01, settings="metric: false\n")
    measured = ranger.measure_at_scale(tracks(), frame(), {}, DriveScale())
    assert measured.by_network.errors.drive_sigma > 2
    assert not (measured.ranges.sigma_m < 0.5 * measured.ranges.distance_m).any()


def test_own_distances_refuse_relative_networks(ranger_of):
    ranger = ranger_of(OwnDistances, gives="inverse_depth", settings="metric: false\n")
    with pytest.raises(MethodError, match="scale and a shift"):
        ranger.measure(tracks(), frame())


def test_method_is_created_with_its_file_only(tmp_path):
    assert DEPTH.create(MethodContext(camera=CAMERA)) is None
    path = write_depth(tmp_path / "net.onnx")
    method = network_method("depth-net")
    ranger = method.create(MethodContext(camera=CAMERA, depth_models={"depth-net": path}))
    assert ranger.network.path == path
    ranger.close()
    assert METHODS.named("depth") == DEPTH
