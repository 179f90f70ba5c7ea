"""Darknet's cfg files: parsing, shapes of layers, and errors."""

import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from tests.support.networks import darknet_networks
from tests.support.networks.darknet_networks import section
from track_range.detection.catalogue.darknet.network import Convolution, read_layers, read_network
from track_range.detection.models.onnx_session import ModelError

NET = "[net]\nwidth=32\nheight=16\n"
CONV = section("convolutional", filters=6, activation="linear")
YOLO = section("yolo", mask="0", anchors="2,3, 4,5", classes=1, num=2)
HEAD = CONV + YOLO
TAIL = section("route", layers="0") + HEAD
GOOD = NET + HEAD + TAIL


def network(text):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "net.cfg"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_network(path)


def shape_of(layer_section, *, width=32, height=16):
    """Output shape of a layer for an image of this size."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "net.cfg"
        path.write_text(f"[net]\nwidth={width}\nheight={height}\n" + layer_section)
        return read_layers(path)[2].layers[0].shape


def test_cfg_whitespace_comments_and_aliases():
    variant = GOOD.replace("[net]", "# a comment\n; another\n[network]").replace(
        "[convolutional]", " [conv] "
    )
    variant = variant.replace("filters=6", "  filters = 6  # one anchor").replace("0\n", "0 ,\n", 1)
    assert network(variant) == network(GOOD)
    assert network(b"\xef\xbb\xbf" + variant.replace("\n", "\r\n").encode()) == network(GOOD)
    # a comment in another encoding
    assert network(b"# \xb5\xc4\n" + GOOD.encode()) == network(GOOD)


def test_first_of_duplicate_options_is_used():
    assert network(GOOD.replace("filters=6", "filters=6\nfilters=7")) == network(GOOD)


def test_defaults_equal_darknet():
    read = network(NET + "[convolutional]\n" + HEAD + TAIL)
    assert read.layers[0].operation == Convolution(
        n_filters=1,
        n_channels=3,
        size=1,
        stride_yx=(1, 1),
        pad=0,
        groups=1,
        has_batch_norm=False,
        activation="logistic",
    )
    assert (read.input_shape, read.letter_box) == ((3, 16, 32), None)
    without_mask = network(
        GOOD.replace("mask=0", "").replace("num=2", "num=1").replace(", 4,5", "")
    )
    assert without_mask.heads[0][1].anchors_px == ((2, 3),)
    assert without_mask.heads[0][1].scale_x_y == 1
    assert len(network(GOOD.replace("classes=1", "").replace("filters=6", "filters=25")).heads) == 2


def test_anchors_in_the_order_of_the_mask():
    read = network(GOOD.replace("mask=0", "mask=1,0").replace("filters=6", "filters=12"))
    assert read.heads[0][1].anchors_px == ((4, 5), (2, 3))


def test_shapes_of_the_published_networks():
    strides = {
        "yolov4_tiny": [(416, 32), (416, 16)],
        "yolov3_tiny": [(416, 32), (416, 16)],
        "yolov4": [(608, 8), (608, 16), (608, 32)],
    }
    for name, heads in strides.items():
        read = network(getattr(darknet_networks, name)())
        sides = [read.layers[source].shape for source, _ in read.heads]
        assert sides == [(255, size_px // stride, size_px // stride) for size_px, stride in heads]


@settings(deadline=None, max_examples=60)
@given(
    width=st.integers(7, 40), height=st.integers(7, 40), size=st.integers(1, 7), stride=st.integers(1, 4),
    padding=st.integers(0, 3),
)  # fmt: skip
def test_number_of_pooling_windows(width, height, size, stride, padding):
    def count(side, both_pads):
        return sum(
            1 for start in range(side + both_pads) if start * stride + size <= side + both_pads
        )

    conv = section(
        "convolutional", filters=4, size=size, stride=stride, padding=padding, activation="linear"
    )
    assert shape_of(conv, width=width, height=height) == (
        4,
        count(height, 2 * padding),
        count(width, 2 * padding),
    )
    pool = section("maxpool", size=size, stride=stride)
    assert shape_of(pool, width=width, height=height) == (
        3,
        count(height, size - 1),
        count(width, size - 1),
    )


def test_pad_takes_precedence_over_padding():
    assert shape_of(
        section("convolutional", filters=2, size=5, pad=1, padding=0, activation="linear")
    ) == (2, 16, 32)
    assert shape_of(section("convolutional", filters=2, size=4, pad=1, activation="linear")) == (
        2,
        17,
        33,
    )
    assert shape_of(section("upsample", stride=3)) == (3, 48, 96)


ERRORS = {
    "nothing": ("", "no section"),
    "no net": (HEAD, r"\[net\]"),
    "no section": ("width=3\n" + GOOD, "line 1: .*'width=3'"),
    "no equals": (GOOD.replace("mask=0", "mask 0"), "line 9: .*'mask0'"),
    "no key": (GOOD + "=3", "'=3'"),
    "long": (GOOD + "x" * 99, f"'{'x' * 40}...'"),
    "binary": (b"\x00\x01\xff\xfe\n" + GOOD.encode(), "line 1: expected"),
    "unknown": (GOOD + "[reorg]\nstride=2", r"line 27, \[reorg\]: .*not supported"),
    "second net": (GOOD + "[net]", r"\[net\]: .*not supported"),
    "no width": ("[net]\nheight=16\n" + HEAD + TAIL, r"line 1, \[net\]: .*'width=...'"),
    "grey": (NET + "channels=1\n" + HEAD + TAIL, "channels=1"),
    "no number": (GOOD.replace("width=32", "width=x"), "integers .*'width=x'"),
    "underscore": (GOOD.replace("width=32", "width=3_2"), "integers .*'width=3_2'"),
    "digits": (GOOD.replace("width=32", "width=" + "9" * 5000), "integers .*'width=9"),
    "large input": (GOOD.replace("width=32", "width=65535"), "8192 pixels .*65535"),
    "large output": (NET + section("upsample", stride=30000), "values, got 960000x480000x3"),
    "long kind": (NET + f"[{'x' * 1000}]", "not supported"),
    "num": (GOOD.replace("num=2", "num=99999999"), "integers .*'num=99999999'"),
    "too many anchors": (GOOD.replace("num=2", "num=9"), "num=2, .*num=9"),
    "anchor": (GOOD.replace("anchors=", "anchors=1e9,"), "anchors"),
    "no size": (GOOD.replace("width=32", "width=0"), "integers .*'width=0'"),
    "huge": (GOOD.replace("filters=6", "filters=99999"), "'filters=99999'"),
    "activation": (GOOD.replace("linear", "gelu"), "leaky.*'activation=gelu'"),
    "xnor": (GOOD.replace("filters=6", "filters=6\nxnor=1"), "xnor=0"),
    "dilation": (GOOD.replace("filters=6", "filters=6\ndilation=2"), "dilation=1"),
    "groups": (GOOD.replace("filters=6", "filters=6\ngroups=2"), "groups=2"),
    "window": (GOOD.replace("filters=6", "filters=6\nsize=17"), "size=17 .*32x16"),
    "pool": (NET + section("maxpool", size=3, padding=9), "padding=9"),
    "depth": (NET + section("maxpool", size=2, maxpool_depth=1), "maxpool_depth=0"),
    "upsample": (NET + section("upsample", scale=0.5), "scale=1"),
    "backwards": (NET + section("upsample", stride=-2), "'stride=-2'"),
    "no layers": (NET + "[route]", "'layers=...'"),
    "empty layers": (NET + "[route]\nlayers=,", "numbers.*'layers=,'"),
    "ahead": (NET + CONV + "[route]\nlayers=1", "'layers=1'"),
    "too far": (NET + CONV + "[route]\nlayers=-2", "'layers=-2'"),
    "sizes": (
        NET + CONV + section("maxpool", stride=2) + section("route", layers="-1,-2"),
        "size: 16x8x6 and 32x16x6",
    ),
    "share": (NET + CONV + section("route", layers=-1, groups=4), "groups=4, group_id=0"),
    "share id": (
        NET + CONV + section("route", layers=-1, groups=2, group_id=2),
        "groups=2, group_id=2",
    ),
    "no from": (NET + CONV + "[shortcut]", "'from=...'"),
    "shapes": (
        NET + CONV + section("convolutional", filters=5) + section("shortcut", from_=-2),
        "shape: 32x16x5 and 32x16x6",
    ),
    "weighted": (
        NET + CONV + CONV + section("shortcut", from_=-2, weights_type="per_channel"),
        "none.*'weights_type=per_channel'",
    ),
    "after yolo": (NET + HEAD + HEAD, r"\[convolutional\]: .*layer 1.*\[yolo\]"),
    "route yolo": (NET + HEAD + section("route", layers=-1), r"\[route\]: .*layer 1.*\[yolo\]"),
    "new coordinates": (GOOD.replace("num=2", "num=2\nnew_coords=1"), "new_coords=0"),
    "no anchors": (GOOD.replace("anchors=2,3, 4,5", ""), "'anchors=...'"),
    "odd anchors": (GOOD.replace("4,5", "4"), "anchors as pairs"),
    "zero anchors": (GOOD.replace("4,5", "4,0"), "anchors as pairs"),
    "worded anchors": (GOOD.replace("4,5", "4,x"), "numbers.*'anchors=2,3,4,x'"),
    "endless anchors": (GOOD.replace("4,5", "4,inf"), "finite.*'anchors=2,3,4,inf'"),
    "mask": (GOOD.replace("mask=0", "mask=2"), "mask"),
    "repeated mask": (
        GOOD.replace("mask=0", "mask=0,0").replace("filters=6", "filters=12"),
        "line 8, .*mask.*0, 0",
    ),
    "unused anchors": (GOOD.replace("anchors=", "anchors=1,1, "), "line 8, .*num=3"),
    "width": (
        NET.replace("32", "33")
        + section("convolutional", filters=3, size=3, pad=1, stride=2)
        + HEAD
        + TAIL,
        r"\[yolo\]: .*33x16",
    ),
    "stride": (
        NET.replace("32", "64")
        + section("convolutional", filters=3, size=3, pad=1, stride=31)
        + HEAD
        + TAIL,
        r"\[yolo\]: .*64x16",
    ),
    "no upsample": (
        darknet_networks.yolov3_tiny().replace("[upsample]", "[maxpool]"),
        r"line \d+, \[route\]: .*size",
    ),
    "scale": (GOOD.replace("num=2", "num=2\nscale_x_y=3"), "scale_x_y"),
    "filters": (GOOD.replace("filters=6", "filters=7"), "filters=6.*7 channels"),
    "no conv": (NET + CONV + section("maxpool") + YOLO, r"\[convolutional\]"),
    "one head": (NET + HEAD, "got 1"),
    "four heads": (GOOD + TAIL + TAIL, "got 4"),
    "uneven": (
        NET + HEAD + TAIL.replace("filters=6", "filters=12").replace("mask=0", "mask=0,1"),
        "same number of classes",
    ),
}


@pytest.mark.parametrize("name", ERRORS)
def test_invalid_cfgs(name):
    text, message = ERRORS[name]
    with pytest.raises(ModelError, match=rf"net\.cfg.*{message}") as caught:
        network(text)
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith(".")


def test_valid_cfg_has_no_errors():
    assert len(network(GOOD).layers) == 5


def test_missing_cfg(tmp_path):
    with pytest.raises(ModelError, match=r"none\.cfg: no such file"):
        read_network(tmp_path / "none.cfg")
