"""The method `disparity`: dense disparities of a stereo network, from its file to metres."""

import numpy as np
import pytest

from tests.support.networks.depth_networks import DISPARITY_STEP, encoded, write_stereo
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.dense_stereo import DenseRanger
from track_range.ranging.methods.method import MethodContext
from track_range.ranging.methods.network_disparity import (
    DISPARITY,
    NetworkDisparityRanger,
)
from track_range.ranging.networks.network import open_stereo_network
from track_range.ranging.networks.network_format import NetworkError
from track_range.ranging.registry import METHODS, register_networks
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.tracking.tracks import Tracks

HW = (192, 320)
RIG = StereoRig.rectified(PinholeCamera(500.0, 500.0, 159.5, 95.5, HW[1], HW[0]), 1.0)
BOXES = np.array([[40.0, 40.0, 120.0, 140.0], [180.0, 60.0, 300.0, 150.0]])
TRUE_PX = (20.0, 40.0)


def tracks(is_observed=(True, True)):
    n = len(BOXES)
    return Tracks(np.arange(n), BOXES, np.zeros(n, np.int64), np.ones(n), np.array(is_observed))


def frame(index=0):
    """Images whose left one holds the disparities that the test network decodes."""
    disparity = np.full(HW, 8.0)
    for (x0, y0, x1, y1), px in zip(BOXES.astype(int), TRUE_PX, strict=True):
        disparity[y0 : y1 + 1, x0 : x1 + 1] = px
    return Frame(index, 0.1 * index, encoded(disparity, DISPARITY_STEP), encoded(0 * disparity))


@pytest.fixture
def ranger(tmp_path):
    write_stereo(tmp_path / "net.onnx")
    network = open_stereo_network(tmp_path / "net.onnx")
    ranger = NetworkDisparityRanger("disparity", network, RIG, alignment=Alignment(residual_px=0.0))
    yield ranger
    ranger.close()


def test_grey_images_are_those_of_equal_channels(tmp_path):
    network = open_stereo_network(write_stereo(tmp_path / "net.onnx"))
    grey = np.full(HW, 20, np.uint8)
    grey[:, ::2] = 40
    colour = np.repeat(grey[:, :, None], 3, axis=2)
    expected = network.measure(colour, colour).values
    np.testing.assert_allclose(np.unique(expected), [20.078, 40.156], atol=1e-3)  # 257/256 of grey
    for pair in ((grey, grey), (colour, grey), (grey, colour)):
        np.testing.assert_array_equal(network.measure(*pair).values, expected)
    with pytest.raises(NetworkError, match="one size"):
        network.measure(grey, grey[:, 1:])


def test_metres_from_the_file_of_a_network(ranger):
    shown = frame()
    ranger.start(shown)
    ranges = ranger.measure(tracks(), shown)
    np.testing.assert_allclose(ranges.distance_m, [25.0, 12.5], rtol=0.01)
    # 0.1 px of the surface, 0.3 px and 1 % of the network
    sigma_px = ranges.sigma_m / ranges.distance_m * np.array(TRUE_PX)
    assert (sigma_px > np.hypot(0.3, 0.01 * np.array(TRUE_PX))).all()
    assert (sigma_px < 1.3 * np.hypot(0.32, 0.013 * np.array(TRUE_PX))).all()
    assert ranger.background_s > 0
    depth = ranger.dense.depth_m()
    assert depth[90, 80] == pytest.approx(25.0, rel=0.01)
    assert depth[5, 5] == pytest.approx(500 / 8, rel=0.01)


def test_predicted_boxes_and_single_images_are_not_measured(ranger):
    assert np.isnan(ranger.measure(tracks((False, True)), frame()).distance_m[0])
    single = Frame(1, 0.1, frame().left, None)
    assert np.isnan(ranger.measure(tracks(), single).distance_m).all()
    assert ranger.dense is None


def test_a_repeated_frame_leaves_no_map_and_a_corrected_image_is_computed_again(ranger):
    ranger.measure(tracks(), frame(0))
    ranger.start(frame(1))
    ranger.skip(frame(1))
    assert ranger.dense is None
    first = frame(2)
    ranger.start(first)
    changed = Frame(2, 0.2, encoded(np.full(HW, 10.0), DISPARITY_STEP), first.right)
    np.testing.assert_allclose(ranger.measure(tracks(), changed).distance_m, 50.0, rtol=0.02)


def test_the_alignment_corrects_boxes_and_depths_alike(tmp_path):
    write_stereo(tmp_path / "net.onnx")
    alignment = Alignment(offset_px=2.0, slope_px=1.0, residual_px=0.1)
    network = open_stereo_network(tmp_path / "net.onnx")
    ranger = NetworkDisparityRanger("disparity", network, RIG, alignment=alignment)
    ranges = ranger.measure(tracks(), frame())
    centre_x = BOXES[:, [0, 2]].mean(axis=1)
    true_px = np.array(TRUE_PX) + 2.0 + (centre_x - 159.5) / 160
    np.testing.assert_allclose(ranges.distance_m, 500 / true_px, rtol=0.01)
    depth = ranger.dense.depth_m()
    at_boxes = depth[[90, 105], centre_x.astype(int)]
    np.testing.assert_allclose(at_boxes, ranges.distance_m, rtol=0.01)
    ranger.close()


def test_further_networks_are_methods_of_their_own():
    register_networks(["disparity-hitnet"])
    further = METHODS.usable["disparity-hitnet"]
    assert further.letter != DISPARITY.letter
    assert further.title != DISPARITY.title
    assert further.has_rig_scale
    letters = [method.letter for method in METHODS.usable.values()]
    assert len(set(letters)) == len(letters)
    METHODS.registered.pop("disparity-hitnet")


def test_without_a_file_there_is_no_method(tmp_path):
    context = MethodContext(camera=RIG.left, rig=RIG)
    assert DISPARITY.create(context) is None
    write_stereo(tmp_path / "net.onnx")
    created = DISPARITY.create(
        MethodContext(camera=RIG.left, rig=RIG, stereo_models={"disparity": tmp_path / "net.onnx"})
    )
    assert isinstance(created, NetworkDisparityRanger)
    created.close()


def test_semi_global_matching_shares_the_surfaces():
    """An object with a pole before it, in both images."""
    rng = np.random.default_rng(0)
    wall, post = rng.integers(0, 255, (2, HW[0], HW[1] + 60), np.uint8)
    left, right = wall[:, 10 : 10 + HW[1]].copy(), wall[:, 30 : 30 + HW[1]].copy()
    left[:, 225:240], right[:, 185:200] = post[:, :15], post[:, :15]
    ranger = DenseRanger(RIG, alignment=Alignment(residual_px=0.0))
    ranges = ranger.measure(tracks(), Frame(0, 0.0, left, right))
    ranger.close()
    np.testing.assert_allclose(ranges.distance_m, 25.0, rtol=0.02)


@pytest.mark.parametrize(
    ("factor", "reference", "is_found"),
    [(0.5, "stereo", True), (2.0, "mono", True), (0.75, "mono", False), (1.1, "stereo", False)],
)
def test_a_wrong_scale_of_the_disparities_is_said_and_is_in_the_sigma(
    tmp_path, factor, reference, is_found
):
    network = open_stereo_network(write_stereo(tmp_path / "net.onnx", factor=factor))
    ranger = NetworkDisparityRanger("disparity", network, RIG, alignment=Alignment(residual_px=0.0))
    true_m = np.array([25.0, 12.5])
    others = {reference: Ranges(np.arange(2), true_m, 0.01 * true_m)}
    for index in range(12):
        ranges = ranger.measure_with(tracks(), frame(index), others)
    ranger.close()
    error_m = np.abs(ranges.distance_m - true_m)
    if is_found:
        assert (ranges.sigma_m > 0.99 * error_m).all()
        assert f"{1 / factor:.2f} times those of the method {reference}" in ranger.notes[0]
    else:
        assert (ranges.sigma_m < 0.1 * true_m).all()
        assert ranger.notes == ()
