"""Networks with the inputs and outputs of the exports of known projects.

Names and shapes are those of the sources in docs/how-to/networks.md.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.support.networks.depth_networks import encoded, write_export
from track_range.ranging.networks.formats import FORMATS
from track_range.ranging.networks.network import open_network
from track_range.ranging.networks.network_format import NetworkError

FOCAL_PX = 800.0
# depths fall towards the lower border, as before a road
ROWS = np.linspace(40.0, 4.0, 60)[:, None].repeat(80, axis=1)
IMAGE = encoded(ROWS)
H, W = ROWS.shape


def points_at(z, focal_px):
    """(h, w, 3) points of the pixels of a map of depths."""
    h, w = z.shape
    x = (np.arange(w) + 0.5 - w / 2) / focal_px
    y = (np.arange(h) + 0.5 - h / 2) / focal_px
    return np.stack([x[None] * z, y[:, None] * z, z], axis=2)


PLAIN = ["float32 1 3 height width"]
NORMALS = np.zeros((1, 3, H, W))
SKY = np.zeros((1, 1, H, W))
# name, inputs, outputs, depth in metres for a network that gives ROWS
DEPTHS = [
    ("depth-anything-3-metric", ["image float32 1 3 60 80"], {"depth": ROWS[None], "sky": SKY}),
    (
        "unidepth-2",
        ["rgbs float32 batch 3 60 80"],
        {
            "pts_3d": points_at(ROWS, FOCAL_PX).transpose(2, 0, 1)[None],
            "confidence": SKY,
            "intrinsics": np.eye(3)[None],
        },
    ),
    (
        "unidepth-2-rays",
        ["rgbs float32 batch 3 60 80", "rays float32 batch 3 60 80"],
        {
            "pts_3d": points_at(ROWS, FOCAL_PX).transpose(2, 0, 1)[None],
            "confidence": SKY,
            "intrinsics": np.eye(3)[None],
        },
    ),
    (
        "unidepth-2-first-camera",
        ["image float32 batch 3 60 80", "K float32 batch 3 3"],
        {
            "out_K": np.eye(3)[None],
            "depth": ROWS[None, None],
            "depth_ssi": SKY,
            "confidence": SKY,
        },
    ),
    (
        "metric3d-transformers",
        ["pixel_values float32 batch_size 3 height width"],
        {"predicted_depth": ROWS[None], "predicted_normal": NORMALS, "normal_confidence": SKY[0]},
    ),
    ("metric3d", ["image float32 1 3 616 1064"], {"pred_depth": ROWS[None, None]}),
    (
        "depth-pro",
        ["pixel_values float32 1 3 1536 1536"],
        {"predicted_depth": 1 / ROWS[None], "field_of_view": np.array([60.0])},
    ),
    (
        "depth-pro-metres",
        ["pixel_values float32 1 3 1536 1536"],
        {"predicted_depth": ROWS[None], "focallength_px": np.array([1500.0])},
    ),
    (
        "moge-2",
        ["image float32 batch_size 3 height width", "num_tokens int64"],
        {
            "points": (points_at(ROWS, FOCAL_PX) - [0, 0, 2.5])[None],
            "normal": NORMALS.transpose(0, 2, 3, 1),
            "mask": np.ones((1, H, W)),
            "metric_scale": np.array([2.0]),
        },
    ),
]


@pytest.mark.parametrize(("name", "inputs", "outputs"), DEPTHS, ids=[row[0] for row in DEPTHS])
def test_depth_networks_are_recognised_and_give_metres(tmp_path, name, inputs, outputs):
    network = open_network(write_export(tmp_path / "net.onnx", inputs, outputs))
    assert network.source == f"format {name}, by the names of inputs and outputs"
    placement = network.inputs.placement((H, W))
    focal_px = FOCAL_PX * placement.scale_x
    factor = {
        "depth-anything-3-metric": focal_px / 300,
        "metric3d": focal_px / 1000,
        "metric3d-transformers": focal_px / 1000,
        "depth-pro": focal_px / 1536,  # the inverse of 1 / depth times 1536 / f
        "moge-2": 2.0,
    }.get(name, 1.0)
    dense = network.measure(IMAGE, FOCAL_PX)
    values = 1 / dense.values if dense.quantity == "inverse_depth" else dense.values
    expected = factor * placement.of_the_image(ROWS)
    np.testing.assert_allclose(values, expected, rtol=2e-4 if name == "moge-2" else 1e-5)


def test_sizes_are_multiples_and_near_the_area_of_the_training(tmp_path):
    inputs = ["pixel_values float32 batch_size 3 height width"]
    path = write_export(tmp_path / "net.onnx", inputs, {"predicted_depth": ROWS[None]})
    path.with_suffix(".yaml").write_text("format: depth-anything-2-metric")
    height, width = open_network(path).inputs.placement((375, 1242)).input_hw
    assert (height % 14, width % 14) == (0, 0)
    assert height * width == pytest.approx(518**2, rel=0.05)
    assert width / height == pytest.approx(1242 / 375, rel=0.05)


def test_the_names_of_several_formats_ask_which_one_it_is(tmp_path):
    inputs = ["pixel_values float32 batch_size 3 height width"]
    path = write_export(tmp_path / "net.onnx", inputs, {"predicted_depth": ROWS[None]})
    with pytest.raises(NetworkError, match=r"write net\.yaml with `format: depth-anything` or"):
        open_network(path)


def test_other_sizes_than_the_known_ones_of_a_name_ask(tmp_path):
    path = write_export(
        tmp_path / "net.onnx", ["image float32 1 3 60 80"], {"pred_depth": ROWS[None, None]}
    )
    with pytest.raises(NetworkError, match=r"pred_depth .*write net\.yaml, such as `\{task: depth"):
        open_network(path)


DISPARITIES = np.linspace(1.0, 30.0, 60)[:, None].repeat(80, axis=1)
PADDED = np.zeros((64, 96))
PADDED[:60, :80] = DISPARITIES
SIX = ["left float32 1 3 64 96", "right float32 1 3 64 96"]
STEREO = [
    (
        "s2m2",
        ["input_left uint8 1 3 64 96", "input_right uint8 1 3 64 96"],
        {
            "output_disp": PADDED[None, None],
            "output_occ": PADDED[None, None],
            "output_conf": np.full((1, 1, 64, 96), 0.75),
        },
    ),
    (
        "raft-stereo",
        SIX,
        {"disparity": np.ones((1, 2, 16, 24)), "upscaled_disparity": -PADDED[None, None]},
    ),
    (
        "crestereo-combined",
        [
            "init_left float32 1 3 32 48",
            "init_right float32 1 3 32 48",
            "next_left float32 1 3 64 96",
            "next_right float32 1 3 64 96",
        ],
        {"next_output": np.stack([PADDED, 0 * PADDED])[None]},
    ),
    (
        "hitnet",
        ["input float32 1 6 64 96"],
        {"reference_output_disparity": PADDED[None, ..., None]},
    ),
    (
        "hitnet",
        ["input float32 1 2 64 96"],
        {"reference_output_disparity": PADDED[None, ..., None]},
    ),
    (
        "stereo-matching",
        ["left_values float32 batch 3 64 96", "right_values float32 batch 3 64 96"],
        {"disparity": PADDED[None]},
    ),
]


@pytest.mark.parametrize(("name", "inputs", "outputs"), STEREO)
def test_stereo_networks_are_recognised_and_give_pixels(tmp_path, name, inputs, outputs):
    network = open_network(write_export(tmp_path / "net.onnx", inputs, outputs))
    assert network.source == f"format {name}, by the names of inputs and outputs"
    dense = network.measure(IMAGE, IMAGE)
    np.testing.assert_allclose(dense.values, DISPARITIES, rtol=1e-6)
    if name == "s2m2":
        np.testing.assert_allclose(dense.confidence, 0.75)


@pytest.mark.parametrize("name", ["foundation-stereo", "igev", "crestereo", "psmnet"])
def test_pairs_of_common_names_need_their_format(tmp_path, name):
    path = write_export(tmp_path / "net.onnx", SIX, {"disp": PADDED[None, None]})
    with pytest.raises(NetworkError, match=f"`format: {name}`"):
        open_network(path)
    path.with_suffix(".yaml").write_text(f"format: {name}")
    np.testing.assert_allclose(open_network(path).measure(IMAGE, IMAGE).values, DISPARITIES)


@pytest.mark.parametrize(
    ("inputs", "outputs", "words"),
    [
        (
            [*SIX, "flow_init float32 1 2 32 48"],
            {"output": PADDED[None, None]},
            "second pass of a network",
        ),
        (
            SIX,
            dict.fromkeys(
                FORMATS["fast-foundation-stereo-parts"].names[0].partition(" -> ")[2].split(),
                PADDED,
            ),
            "single_onnx",
        ),
    ],
)
def test_parts_of_networks_are_refused(tmp_path, inputs, outputs, words):
    path = write_export(tmp_path / "net.onnx", inputs, outputs)
    with pytest.raises(NetworkError, match=words):
        open_network(path)


@pytest.mark.parametrize(
    "pixels",
    [
        "float32 1 1 3 height width",  # views of Depth Anything 3
        "float16 1 3 60 80",
        "float32 1 60 80 3",
        "float32 3 60 80",
    ],
)
def test_inputs_have_the_type_and_dimensions_of_the_file(tmp_path, pixels):
    outputs = {"predicted_depth": ROWS[None], "predicted_confidence": SKY}
    path = write_export(tmp_path / "net.onnx", [f"pixel_values {pixels}"], outputs)
    path.with_suffix(".yaml").write_text("format: depth-anything-3\noutput: predicted_depth")
    dense = open_network(path).measure(IMAGE, FOCAL_PX)
    assert (dense.quantity, dense.is_metric) == ("depth", False)
    np.testing.assert_allclose(dense.values, ROWS, rtol=1e-6)


def test_several_outputs_need_a_name(tmp_path):
    outputs = {"predicted_depth": ROWS[None], "predicted_confidence": SKY}
    path = write_export(tmp_path / "net.onnx", ["pixels float32 1 3 60 80"], outputs)
    path.with_suffix(".yaml").write_text("format: depth-anything-3")
    with pytest.raises(NetworkError, match="add `output: predicted_depth` or another one of"):
        open_network(path)


@pytest.mark.parametrize(
    ("pixels", "words"),
    [("float32 4 3 60 80", "expected an input"), ("float32 1 5 60 80", "3 channels of the input")],
)
def test_inputs_that_are_no_images_are_errors(tmp_path, pixels, words):
    path = write_export(tmp_path / "net.onnx", [f"x {pixels}"], {"depth": ROWS[None]})
    path.with_suffix(".yaml").write_text("format: zoedepth")
    with pytest.raises(NetworkError, match=words):
        open_network(path)


def test_disparities_of_a_reduced_image_are_pixels_of_the_image(tmp_path):
    path = write_export(
        tmp_path / "net.onnx",
        ["a float32 1 3 30 40", "b float32 1 3 30 40"],
        {"disp": DISPARITIES[None, ::2, ::2] / 2},
    )
    path.with_suffix(".yaml").write_text("format: igev\nfit: stretch")
    np.testing.assert_allclose(
        open_network(path).measure(IMAGE, IMAGE).values, DISPARITIES[::2, ::2]
    )


def test_each_format_has_a_row_in_the_documentation():
    docs = Path(__file__).resolve().parents[3] / "docs"
    text = (docs / "how-to" / "networks.md").read_text(encoding="utf-8")
    missing = [name for name, row in FORMATS.items() if row.format and f"`{name}`" not in text]
    assert missing == []
