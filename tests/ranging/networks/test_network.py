"""Depth and stereo networks of ONNX files: from images to dense maps."""

import numpy as np
import pytest

from tests.support.networks.depth_networks import (
    DISPARITY_STEP,
    encoded,
    write_depth,
    write_echo,
    write_export,
    write_stereo,
)
from track_range.ranging.networks.network import open_depth_network, open_stereo_network
from track_range.ranging.networks.network_format import NetworkError

# blue, green and red of each pixel, and what a network takes of it
PIXEL = (10, 100, 200)
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


def test_the_example_of_an_unknown_network_is_for_its_inputs_and_can_be_used(tmp_path):
    inputs = ["a float32 1 3 48 64", "b float32 1 3 48 64"]
    path = write_export(tmp_path / "made.onnx", inputs, {"px": DEPTHS[None]})
    with pytest.raises(NetworkError) as raised:
        open_stereo_network(path)
    path.with_suffix(".yaml").write_text(str(raised.value).split("`")[1])
    left = encoded(DEPTHS)
    np.testing.assert_allclose(open_stereo_network(path).measure(left, left).values, DEPTHS)


def test_a_file_of_other_keys_names_what_is_missing(tmp_path):
    path = write_depth(tmp_path / "made.onnx")
    path.with_suffix(".yaml").write_text("family: RoadNet")
    with pytest.raises(NetworkError, match=r"expected `format: NAME`, or .*found family"):
        open_depth_network(path)


def test_a_stereo_network_is_no_depth_network(tmp_path):
    with pytest.raises(NetworkError, match="give it as --stereo-model"):
        open_depth_network(write_stereo(tmp_path / "made.onnx"))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("depth: 3", "'depth': this key is unknown"),
        ("metrik: true", "'metrik': this key is unknown; did you mean metric"),
        ("gives: metres", "'gives': expected"),
        ("std: [1, 0, 1]", r"'std\.1': expected a number above 0, found 0"),
        ("format: madas", "'format': .*found 'madas'; did you mean midas"),
        ("scale: 0", "expected a scale other than 0"),
        ("inputs: [right image]", r"'inputs\.0': expected image, left"),
        ("inputs: [image, 1]", "expected the inputs image, found 1"),
        ("format: best", "'format': .*found 'best'; known are depth-anything,"),
        ("task: [depth]", "'task': expected"),
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
    assert str(raised.value)[-1] in ".?"
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("channel", "settings", "value"),
    [
        (0, "colours: rgb", PIXEL[2] / 255),
        (0, "colours: bgr\ndivisor: 1", PIXEL[0]),
        (1, "mean: [0.5, 0.25, 0.5]\nstd: [1, 0.1, 1]", (PIXEL[1] / 255 - 0.25) / 0.1),
        (2, "mean: [0, 0, 0.01]", PIXEL[0] / 255 - 0.01),
    ],
)
def test_a_network_takes_pixels_as_its_format_says(tmp_path, channel, settings, value):
    text = f"task: depth\ngives: depth\nmetric: false\n{settings}"
    path = write_echo(tmp_path / "echo.onnx", channel, shape=(12, 16), settings=text)
    image = np.full((24, 32, 3), PIXEL, np.uint8)
    dense = open_depth_network(path).measure(image, 100.0)
    np.testing.assert_allclose(dense.values, np.float32(value), rtol=1e-5)


@pytest.mark.parametrize(("channel", "value"), [(0, 40), (3, 90)])
def test_a_pair_of_six_channels_is_left_then_right(tmp_path, channel, value):
    text = "task: stereo\ngives: disparity\ndivisor: 1"
    path = write_echo(tmp_path / "echo.onnx", channel, shape=(12, 16), n_channels=6, settings=text)
    left, right = np.full((12, 16, 3), 40, np.uint8), np.full((12, 16, 3), 90, np.uint8)
    np.testing.assert_allclose(open_stereo_network(path).measure(left, right).values, value)


@pytest.mark.parametrize("fit", ["letterbox", "pad", "stretch"])
def test_the_map_covers_the_image_with_any_placement(tmp_path, fit):
    text = f"task: depth\ngives: depth\nmetric: false\ndivisor: 1\nfit: {fit}"
    path = write_echo(tmp_path / "echo.onnx", 0, shape=(48, 48), settings=text)
    image = np.zeros((24, 32, 3), np.uint8)
    image[:, :16], image[:, 16:] = 50, 150
    values = open_depth_network(path).measure(image, 100.0).values
    half = values.shape[1] // 2
    assert values.shape == {"letterbox": (36, 48), "pad": (24, 32), "stretch": (48, 48)}[fit]
    np.testing.assert_allclose(values[:, : half - 2], 50, atol=1)
    np.testing.assert_allclose(values[:, half + 2 :], 150, atol=1)


def test_values_that_cannot_be_are_unknown(tmp_path):
    network = open_depth_network(write_depth(tmp_path / "made.onnx"))
    depths = DEPTHS.copy()
    depths[:2], depths[2:4] = 0.05, np.nan
    values = network.measure(encoded(depths), 700.0).values
    assert np.isnan(values[:4]).all()
    assert np.isfinite(values[4:]).all()


def test_a_first_image_without_metres_is_an_error_and_a_later_one_a_note(tmp_path):
    path = write_depth(tmp_path / "made.onnx", factor=1e-3)
    with pytest.raises(NetworkError, match=r"expected depths from 0\.1 to 1000 m, found a median"):
        open_depth_network(path).measure(encoded(DEPTHS), 700.0)
    network = open_depth_network(write_depth(tmp_path / "good.onnx"))
    network.measure(encoded(DEPTHS), 700.0)
    assert network.notes == ()
    network.measure(encoded(1e-3 * DEPTHS), 700.0)
    assert "nothing usable in 1 of 2 images" in network.notes[0]


def test_a_black_first_image_is_no_error(tmp_path):
    network = open_depth_network(write_depth(tmp_path / "made.onnx"))
    assert np.isnan(network.measure(np.zeros((48, 64, 3), np.uint8), 700.0).values).all()


@pytest.mark.parametrize(
    ("truly", "stated"), [("depth", "inverse_depth"), ("inverse_depth", "depth")]
)
def test_depths_in_the_place_of_inverse_depths_are_an_error(tmp_path, truly, stated):
    path = write_depth(tmp_path / "made.onnx", gives=truly)
    path.with_suffix(".yaml").write_text(
        f"task: depth\ngives: {stated}\nmetric: false\ncolours: bgr\ndivisor: 1"
    )
    network = open_depth_network(path)
    for _ in range(4):
        network.measure(encoded(DEPTHS), 700.0)
    with pytest.raises(NetworkError, match=f"set `gives: {truly}`"):
        network.measure(encoded(DEPTHS), 700.0)


def test_an_upright_image_settles_the_order(tmp_path):
    network = open_depth_network(write_depth(tmp_path / "made.onnx"))
    network.measure(encoded(DEPTHS), 700.0)
    for _ in range(6):
        network.measure(encoded(DEPTHS[::-1]), 700.0)


def test_negative_disparities_are_an_error(tmp_path):
    path = write_stereo(tmp_path / "made.onnx", factor=-1.0)
    left = encoded(np.linspace(2.0, 60.0, 48)[:, None].repeat(64, axis=1), DISPARITY_STEP)
    with pytest.raises(NetworkError, match="expected positive disparities"):
        open_stereo_network(path).measure(left, left)


@pytest.mark.parametrize(
    ("truly", "stated"), [("depth", "inverse_depth"), ("inverse_depth", "depth")]
)
def test_the_reverse_of_metres_is_an_error_although_few_values_can_be_metres(
    tmp_path, truly, stated
):
    path = write_depth(tmp_path / "made.onnx", gives=truly)
    path.with_suffix(".yaml").write_text(f"task: depth\ngives: {stated}\ncolours: bgr\ndivisor: 1")
    image = encoded(np.geomspace(200.0, 5.0, 48)[:, None].repeat(64, axis=1))
    network = open_depth_network(path)

    def drive():
        for _ in range(5):
            network.measure(image, 700.0)

    with pytest.raises(NetworkError, match=rf"set `gives: {truly}`|expected depths from 0\.1"):
        drive()


def test_a_scale_that_leaves_metres_to_the_sky_alone_is_an_error(tmp_path):
    path = write_depth(tmp_path / "made.onnx", factor=1e-3)
    depths = DEPTHS.copy()
    depths[:16] = 300.0
    with pytest.raises(NetworkError, match=r"found a median of 0\.0\d+ in the first image"):
        open_depth_network(path).measure(encoded(depths), 700.0)


def test_depths_of_0_at_the_horizon_are_no_reverse(tmp_path):
    depths = DEPTHS.copy()
    depths[:26] = 0.0
    network = open_depth_network(write_depth(tmp_path / "made.onnx"))
    for _ in range(6):
        assert np.isfinite(network.measure(encoded(depths), 700.0).values[26:]).all()
