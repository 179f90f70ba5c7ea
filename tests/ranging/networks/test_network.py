"""Depth and stereo networks of ONNX files: from images to dense maps."""

import numpy as np
import pytest

from tests.support.networks.depth_networks import (
    DISPARITY_STEP,
    encoded,
    write_depth,
    write_stereo,
)
from track_range.ranging.networks.network import open_depth_network, open_stereo_network
from track_range.ranging.networks.network_format import NetworkError

DEPTHS = np.linspace(60.0, 5.0, 48).round(2)[:, None].repeat(64, axis=1)


def test_a_network_gives_the_depths_that_an_image_encodes(tmp_path):
    network = open_depth_network(write_depth(tmp_path / "made.onnx", factor=0.6))
    dense = network.measure(encoded(DEPTHS), 700.0)
    assert (dense.quantity, dense.image_hw, dense.is_metric) == ("depth", (48, 64), True)
    np.testing.assert_allclose(dense.values, 0.6 * DEPTHS, rtol=1e-5)


def test_flicker_follows_the_blue_channel(tmp_path):
    network = open_depth_network(write_depth(tmp_path / "made.onnx", flicker=0.5))
    for blue, factor in ((128, 1.0), (255, 1 + 0.5 * 127 / 128), (0, 0.5)):
        dense = network.measure(encoded(DEPTHS, blue=blue), 700.0)
        np.testing.assert_allclose(dense.values, factor * DEPTHS, rtol=1e-5)


def test_inverse_depths_and_unknown_pixels(tmp_path):
    depths = DEPTHS.copy()
    depths[:4] = np.nan
    network = open_depth_network(write_depth(tmp_path / "made.onnx", gives="inverse_depth"))
    dense = network.measure(encoded(depths), 700.0)
    assert dense.quantity == "inverse_depth"
    np.testing.assert_allclose(dense.values, 1 / depths, rtol=1e-5)


def test_disparities_are_pixels_of_the_image_also_of_an_image_with_padding(tmp_path):
    disparities = np.linspace(2.0, 60.0, 48)[:, None].repeat(64, axis=1)
    path = write_stereo(tmp_path / "made.onnx", shape=(64, 96))
    left = encoded(disparities, DISPARITY_STEP)
    dense = open_stereo_network(path).measure(left, left)
    assert (dense.quantity, dense.values.shape) == ("disparity", (48, 64))
    np.testing.assert_allclose(dense.values, disparities, atol=DISPARITY_STEP)


def test_a_constant_network_with_a_fixed_input(tmp_path):
    network = open_depth_network(write_depth(tmp_path / "made.onnx", constant=20.0, shape=(28, 42)))
    dense = network.measure(encoded(DEPTHS), 700.0)
    assert dense.values.shape == (28, 42)
    np.testing.assert_allclose(dense.values, 20.0)


def test_a_network_of_unknown_names_asks_for_its_settings(tmp_path):
    path = write_depth(tmp_path / "made.onnx")
    path.with_suffix(".yaml").unlink()
    with pytest.raises(
        NetworkError, match=r"made\.onnx: .*write made\.yaml with `format: depth-any"
    ):
        open_depth_network(path)


def test_a_stereo_network_is_no_depth_network(tmp_path):
    with pytest.raises(NetworkError, match="give it as --stereo-model"):
        open_depth_network(write_stereo(tmp_path / "made.onnx"))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("depth: 3", "'depth': this key is unknown"),
        ("gives: metres", "'gives': expected"),
        ("std: [1, 0, 1]", r"'std\.1': expected a number above 0, found 0"),
        ("format: madas", "'format': expected depth-anything, .*found 'madas'"),
        ("scale: 0", "expected a scale other than 0"),
        ("inputs: [right image]", r"'inputs\.0': expected image, left"),
        ("inputs: [image, 1]", "expected the inputs image, found 1"),
        ("format: crestereo-second-pass", "expected a whole network, found the second pass"),
        ("output: disp", "'output': expected one of its outputs depth, found 'disp'"),
    ],
)
def test_each_wrong_value_of_the_settings_is_one_sentence(tmp_path, line, words):
    path = write_depth(tmp_path / "made.onnx")
    settings = path.with_suffix(".yaml")
    kept = [old for old in settings.read_text().splitlines() if old[:5] != line[:5]]
    settings.write_text("\n".join([*kept, line]))
    with pytest.raises(NetworkError, match=words) as raised:
        open_depth_network(path)
    assert str(raised.value).endswith(".")
    assert "\n" not in str(raised.value)
