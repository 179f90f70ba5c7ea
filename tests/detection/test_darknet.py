"""Import of Darknet files: hand-worked layers, metadata and errors."""

import json

import numpy as np
import onnx
import pytest

from tests.support.networks import darknet_networks
from tests.support.networks.darknet_networks import section, write_weights
from track_range.detection.catalogue.darknet.importer import import_darknet
from track_range.detection.catalogue.darknet.network import read_network
from track_range.detection.catalogue.entries import CATALOGUE
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.models.onnx_session import ModelError, OnnxSession, Runtime
from track_range.detection.yolo.detector import YoloDetector

DARKNET_EPSILON = 1e-5


def run(path, blob):
    return OnnxSession(path, Runtime(device="cpu", n_threads=1)).run(np.float32(blob))


# --- by hand
# ----------------------------------------------------------------------------------------------------------

YOLO = section("yolo", mask="0", anchors="2,3, 4,5", classes=1, num=2)
LAST = section("convolutional", filters=6, activation="linear") + YOLO


def small(*layers, width=4, height=2, net=""):
    """A small cfg with these layers."""
    return f"[net]\nwidth={width}\nheight={height}\nchannels=3\n{net}\n" + "".join(layers)


def file_bytes(*arrays, version=(0, 2, 5), count_type="<u8"):
    header = np.array(version, "<i4").tobytes() + np.zeros(1, count_type).tobytes()
    return header + b"".join(np.asarray(array, "<f4").tobytes() for array in arrays)


def imported(tmp_path, text, content):
    (tmp_path / "net.cfg").write_text(text)
    (tmp_path / "net.weights").write_bytes(content)
    return import_darknet(
        tmp_path / "net.cfg", tmp_path / "net.weights", tmp_path / "net.onnx", names=["car"]
    )


ONE = section("convolutional", batch_normalize=1, filters=1, activation="{}") + LAST
TWO_HEADS = ONE + section("route", layers=0) + LAST
LAST_VALUES = (np.zeros(6), np.arange(1, 7))  # biases, then six weights for one channel


@pytest.mark.parametrize(
    ("activation", "expected"),
    [
        ("linear", -1),
        ("leaky", -0.1),
        ("relu", 0),
        ("logistic", 1 / (1 + np.e)),
        ("tanh", -np.tanh(1)),
        ("swish", -1 / (1 + np.e)),
        ("mish", -np.tanh(np.log(1 + 1 / np.e))),
    ],
)
def test_batch_norm_and_activations_by_hand(tmp_path, activation, expected):
    # (0.2 x 5 + 0.3 x 10 + 0.5 x 4 - 2) / 2 x 3 - 7 = -1; Darknet adds 0.00001 to the variance,
    # here up to 4
    norm = ([-7], [3], [2], [4 - DARKNET_EPSILON], [5, 10, 4])
    imported(
        tmp_path,
        small(TWO_HEADS.replace("{}", activation)),
        file_bytes(*norm, *LAST_VALUES, *LAST_VALUES),
    )
    blob = np.broadcast_to(np.reshape([0.2, 0.3, 0.5], (1, 3, 1, 1)), (1, 3, 2, 4))
    for output in run(tmp_path / "net.onnx", blob):
        np.testing.assert_allclose(output[0, :, 1, 3], expected * np.arange(1, 7), atol=2e-6)


def test_leaky_and_zero_variance(tmp_path):
    content = file_bytes([0], [1], [0], [0], [1, 0, 0], *LAST_VALUES, *LAST_VALUES)
    imported(tmp_path, small(TWO_HEADS.replace("{}", "leaky")), content)
    output = run(tmp_path / "net.onnx", np.full((1, 3, 2, 4), 0.25))[0]
    np.testing.assert_allclose(output[0, 0, 0, 0], 0.25 / np.sqrt(0.00001), rtol=1e-6)


def test_pools_upsampling_routes_and_shortcuts_by_hand(tmp_path):
    plain = section("convolutional", filters=6, activation="linear")
    text = small(
        plain,  # 0: the image's channels twice
        section("maxpool", size=2, stride=1),  # 1
        section("shortcut", from_="0", activation="linear"),  # 2
        section("route", layers="-1", groups=3, group_id=1),  # 3: channels 2, 3
        LAST,  # 4, 5
        section("route", layers="0"),  # 6
        section("maxpool", size=2, stride=2),  # 7
        section("upsample", stride=2),  # 8
        section("route", layers="3, -1"),  # 9: 2 + 6 channels
        LAST,
    )
    twice = np.concatenate([np.identity(3), np.identity(3)])
    select_2 = np.zeros((6, 2))
    select_2[:, 0], select_2[0] = 1, [0, 1]
    select_8 = np.zeros((6, 8))
    select_8[0, 0], select_8[1, 2] = 1, 1
    imported(
        tmp_path, text, file_bytes(np.zeros(6), twice, np.zeros(6), select_2, np.zeros(6), select_8)
    )
    red, blue = (
        np.array([[1, 2, 3, 4], [8, 7, 6, 5]]),
        np.array([[-1, -2, -3, -4], [-8, -7, -6, -5]]),
    )
    first, second = run(tmp_path / "net.onnx", np.stack([red, 0 * red, blue])[None])
    # the window of a pool with stride 1 extends by one to the right and below; padding is never the
    # maximum
    pooled_red, pooled_blue = [[8, 7, 6, 5], [8, 7, 6, 5]], [[-1, -2, -3, -4], [-7, -6, -5, -5]]
    np.testing.assert_array_equal(first[0, 0], pooled_red + red)  # channel 3 of the sum: red again
    np.testing.assert_array_equal(first[0, 1], pooled_blue + blue)  # channel 2 of the sum
    np.testing.assert_array_equal(second[0, 0], first[0, 1])
    np.testing.assert_array_equal(second[0, 1], [[8, 8, 6, 6], [8, 8, 6, 6]])


def test_unequal_strides_and_triple_shortcut(tmp_path):
    text = small(
        section("convolutional", filters=1, stride_x=2, stride_y=1, activation="linear"),
        section("dropout", probability=0.3),
        section("convolutional", filters=1, activation="linear"),
        section("shortcut", from_="-2,0", activation="relu"),
        LAST + section("route", layers=0) + LAST,
    )
    imported(tmp_path, text, file_bytes([0], [1, 0, 0], [0], [10], *LAST_VALUES, *LAST_VALUES))
    red = np.array([[1, 2, -3, 4], [5, 6, 7, 8]])
    first, second = run(tmp_path / "net.onnx", np.stack([red] * 3)[None])
    np.testing.assert_array_equal(first[0, 0], [[12, 0], [60, 84]])
    np.testing.assert_array_equal(second[0, 1], [[2, -6], [10, 14]])


def test_short_header_of_old_files(tmp_path):
    values = ([1], [1], [0], [1], [1, 2, 3], *LAST_VALUES, *LAST_VALUES)
    outputs = []
    for version, count_type in (((0, 1, 0), "<u4"), ((0, 2, 0), "<u8"), ((1, 0, 0), "<u8")):
        imported(
            tmp_path,
            small(TWO_HEADS.replace("{}", "relu")),
            file_bytes(*values, version=version, count_type=count_type),
        )
        outputs.append(run(tmp_path / "net.onnx", np.ones((1, 3, 2, 4)))[0])
    assert outputs[0][0, 0, 0, 0] == pytest.approx(7, abs=1e-4)
    np.testing.assert_array_equal(outputs[0], outputs[1])
    np.testing.assert_array_equal(outputs[0], outputs[2])


# --- metadata
# ---------------------------------------------------------------------------------------------------------


def random_import(tmp_path, text):
    (tmp_path / "net.cfg").write_text(text)
    network = read_network(tmp_path / "net.cfg")
    write_weights(tmp_path / "net.weights", network, seed=0)
    n_classes = network.heads[0][1].n_classes
    return import_darknet(
        tmp_path / "net.cfg",
        tmp_path / "net.weights",
        tmp_path / "net.onnx",
        names=ROAD_CLASSES[:n_classes],
    )


def test_metadata_of_imported_file(tmp_path):
    model_summary = random_import(
        tmp_path, darknet_networks.yolov4_tiny(size_px=(96, 64), n_classes=2, width=16)
    )
    assert (model_summary.family, model_summary.input_hw, model_summary.n_layers) == (
        "yolov4-tiny",
        (64, 96),
        38,
    )
    assert model_summary.n_parameters == (len((tmp_path / "net.weights").read_bytes()) - 20) / 4
    model = onnx.load(tmp_path / "net.onnx")
    assert (model.ir_version, model.opset_import[0].version) == (8, 13)
    assert [value.name for value in model.graph.input] == ["images"]
    assert [value.name for value in model.graph.output] == ["head_s32", "head_s16"]
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    assert metadata.pop("family") == "yolov4-tiny"
    assert metadata.pop("letterbox") == "centred-128"
    assert metadata.pop("colours") == "rgb"
    assert {key: json.loads(value) for key, value in metadata.items()} == {
        "names": ["person", "bicycle"],
        "anchors": [[[81, 82], [135, 169], [344, 319]], [[23, 27], [37, 58], [81, 82]]],
        "scale_x_y": [1.05, 1.05],
        "divisor": 255,
    }
    detector = YoloDetector(tmp_path / "net.onnx")
    assert (detector.model.family, detector.model.names) == ("yolov4-tiny", ("person", "bicycle"))
    assert detector.model.attributes["scale_x_y"].value == (1.05, 1.05)
    detections = detector.detect(
        np.random.default_rng(0).integers(0, 255, (100, 200, 3)).astype(np.uint8)
    )
    assert len(detections) > 0  # random weights give detections everywhere
    assert set(detections.class_id) <= {0, 1}


YOLOV4_SMALL = darknet_networks.yolov4(size_px=(32, 32), n_classes=1, width=64)


@pytest.mark.parametrize(
    ("text", "family"),
    [
        (darknet_networks.yolov4_tiny(size_px=(32, 32), n_classes=1, width=64), "yolov4-tiny"),
        (darknet_networks.yolov3_tiny(size_px=(32, 32), n_classes=1, width=64), "yolov3-tiny"),
        (YOLOV4_SMALL, "yolov4"),
        (YOLOV4_SMALL.replace("mish", "leaky"), "yolov3"),
    ],
)
def test_family_from_structure(tmp_path, text, family):
    assert random_import(tmp_path, text).family == family


@pytest.mark.parametrize(
    ("net", "letterbox", "n_notes"),
    [("", "centred-128", 1), ("letter_box=1", "centred-128", 0), ("letter_box=0", "stretch", 0)],
)
def test_letterbox_of_the_cfg(tmp_path, net, letterbox, n_notes):
    text = darknet_networks.yolov3_tiny(size_px=(32, 32), n_classes=1, width=64, net=net)
    model_summary = random_import(tmp_path, text)
    assert YoloDetector(tmp_path / "net.onnx").model.attributes["letterbox"].value == letterbox
    assert len(model_summary.notes) == n_notes
    assert all("--letterbox stretch" in note for note in model_summary.notes)


def test_heads_of_equal_stride_have_unique_names(tmp_path):
    random_import(tmp_path, small(TWO_HEADS.replace("{}", "relu")))
    model = onnx.load(tmp_path / "net.onnx")
    assert [value.name for value in model.graph.output] == ["head_s1", "head_s1_1"]


@pytest.mark.parametrize("name", ["yolov4-tiny", "yolov4"])
def test_size_of_published_weights(tmp_path, name):
    (tmp_path / "net.cfg").write_text(getattr(darknet_networks, name.replace("-", "_"))())
    files = next(entry.files for entry in CATALOGUE if entry.name == name)
    published = next(file.size_bytes for file in files if file.name.endswith(".weights"))
    assert 20 + 4 * read_network(tmp_path / "net.cfg").n_values == published


# --- errors
# -----------------------------------------------------------------------------------------------------------

GOOD = small(TWO_HEADS.replace("{}", "relu"))
VALUES = ([1], [1], [0], [1], [1, 2, 3], *LAST_VALUES, *LAST_VALUES)  # 31 of them


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (file_bytes(*VALUES)[:-4], "got 30;"),
        (file_bytes(*VALUES)[:-1], "got 30 and 3 bytes"),
        (file_bytes(*VALUES, [0, 0]), "got 33;"),
        (file_bytes(*VALUES) + b"\n", "got 31 and 1 bytes"),
        (file_bytes(*VALUES)[:15], "15 bytes"),
        (b"", "header"),
        (file_bytes(*VALUES, version=(2147483647, 2, 5)), "2147483647"),
        (file_bytes(*VALUES, version=(0, 2, -1)), "version"),
        (file_bytes([1], [1], [0], [-1], [1, 2, 3], *LAST_VALUES, *LAST_VALUES), "layer 0"),
        (file_bytes(*VALUES[:-1], [1, 2, 3, np.nan, 5, 6]), "layer 4"),
    ],
)
def test_mismatched_weights_leave_no_file(tmp_path, content, message):
    (tmp_path / "net.onnx").write_bytes(b"an older one")
    with pytest.raises(ModelError, match=rf"net\.weights: .*{message}"):
        imported(tmp_path, GOOD, content)
    assert (tmp_path / "net.onnx").read_bytes() == b"an older one"
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "net.cfg",
        "net.onnx",
        "net.weights",
    ]


def test_import_with_missing_files(tmp_path):
    imported(tmp_path, GOOD, file_bytes(*VALUES))
    cfg, weights = tmp_path / "net.cfg", tmp_path / "net.weights"
    with pytest.raises(ModelError, match=r"none\.weights: no such file"):
        import_darknet(cfg, tmp_path / "none.weights", tmp_path / "a.onnx", names=["car"])
    with pytest.raises(ModelError, match=r"net\.cfg: .*got 2"):
        import_darknet(cfg, weights, tmp_path / "a.onnx", names=["car", "bus"])
    with pytest.raises(ModelError, match=r"a\.onnx: .*folder"):
        import_darknet(cfg, weights, tmp_path / "none" / "a.onnx", names=["car"])
    assert not (tmp_path / "a.onnx").exists()
