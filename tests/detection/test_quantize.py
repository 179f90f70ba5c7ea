"""INT8 and FP16 copies of a small network, and of a real one if available."""

import logging
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from track_range.detection.models import quantize
from track_range.detection.models.onnx_session import ModelError, OnnxSession, Runtime
from track_range.detection.models.quantize import convert_fp16, quantize_int8
from track_range.detection.models.writing import atomic_output, silent_conversion

SIZE_PX = 32
METADATA = {"family": "yolov5", "names": '["car", "person"]'}


def weight(rng, name, *shape):
    """Random weights with He's scale, so that activations neither vanish nor explode."""
    values = rng.normal(0, np.sqrt(2 / np.prod(shape[1:])), shape)
    return numpy_helper.from_array(values.astype(np.float32), name)


def saved(path, nodes, initializers, *, outputs=("boxes",), opset=12, size=SIZE_PX):
    """Write a network with metadata, like an exporter."""
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, size, size])
    results = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in outputs]
    graph = helper.make_graph(nodes, "net", [image], results, initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=7)
    helper.set_model_props(model, METADATA)
    onnx.save(onnx.shape_inference.infer_shapes(model), path)
    return path


def silu(node_input, name):
    """Nodes of x * sigmoid(x) without node names."""
    return [
        helper.make_node("Sigmoid", [node_input], [f"{name}_s"]),
        helper.make_node("Mul", [node_input, f"{name}_s"], [name]),
    ]


def convolution(source, name, *, stride=1):
    return helper.make_node(
        "Conv", [source, f"w_{name}"], [name], pads=[1, 1, 1, 1], strides=[stride, stride]
    )


def yolo_network(path, *, quiet_gain=1.0):
    """Write a network of three convolutions with SiLU and a head; its output has pixels (x 640) and
    scores (0..1).

    `quiet_gain` scales all but two output channels of the first convolution down and the weights of
    the second one up by the same factor, like batch norms that are folded into depthwise networks.
    """
    rng = np.random.default_rng(1)
    gain = np.full(16, quiet_gain, np.float32)
    gain[:2] = 1
    first = numpy_helper.to_array(weight(rng, "", 16, 3, 3, 3)) * gain[:, None, None, None]
    second = numpy_helper.to_array(weight(rng, "", 32, 16, 3, 3)) / gain[:, None, None]
    weights = [
        numpy_helper.from_array(first, "w_a"),
        numpy_helper.from_array(second, "w_b"),
        weight(rng, "w_c", 32, 32, 3, 3),
        weight(rng, "w_head", 6, 32, 3, 3),
        numpy_helper.from_array(np.float32(640), "pixels"),
        *(
            numpy_helper.from_array(np.array(v, np.int64), f"at_{v[0]}")
            for v in ([0], [1], [4], [6])
        ),
    ]
    nodes = [convolution("images", "a", stride=2), *silu("a", "a_act")]
    nodes += [convolution("a_act", "b", stride=2), *silu("b", "b_act")]
    nodes += [convolution("b_act", "c"), *silu("c", "c_act"), convolution("c_act", "head")]
    nodes += [
        helper.make_node("Sigmoid", ["head"], ["unit"]),
        helper.make_node("Slice", ["unit", "at_0", "at_4", "at_1"], ["corners"]),
        helper.make_node("Slice", ["unit", "at_4", "at_6", "at_1"], ["scores"]),
        helper.make_node("Mul", ["corners", "pixels"], ["corners_px"]),
        helper.make_node("Concat", ["corners_px", "scores"], ["boxes"], axis=1),
    ]
    return saved(path, nodes, weights)


def blobs(n, size=SIZE_PX, seed=3):
    """Inputs (1, 3, size, size) of random blocks of 8 x 8 pixels, 0..1."""
    rng = np.random.default_rng(seed)
    coarse = rng.random((n, 1, 3, size // 8, size // 8), np.float32)
    return list(coarse.repeat(8, 3).repeat(8, 4))


def mean_errors(path, other, inputs):
    """Mean absolute difference of two networks' outputs: (pixels, scores)."""
    one, two = (
        np.stack([OnnxSession(p, Runtime(device="cpu")).run(blob)[0] for blob in inputs])
        for p in (path, other)
    )
    difference = np.abs(one - two).mean(axis=(0, 1, 3, 4))
    return difference[:4].mean(), difference[4:].mean()


def metadata(path):
    return {entry.key: entry.value for entry in onnx.load(path).metadata_props}


def operators(path):
    return [node.op_type for node in onnx.load(path).graph.node]


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    return yolo_network(tmp_path_factory.mktemp("float") / "net.onnx")


@pytest.fixture(scope="module")
def int8(network):
    out = network.with_name("net-int8.onnx")
    quantize_int8(network, out, blobs=iter(blobs(12)))
    return out


@pytest.fixture(scope="module")
def fp16(network):
    out = network.with_name("net-fp16.onnx")
    convert_fp16(network, out)
    return out


def test_int8_is_close_to_float(network, int8):
    pixels, scores = mean_errors(network, int8, blobs(4, seed=9))
    assert 0.05 < pixels < 6  # of 640; equal outputs would mean that no layer is quantised
    assert 1e-4 < scores < 0.01


def test_fp16_is_close_to_float(network, fp16):
    pixels, scores = mean_errors(network, fp16, blobs(4, seed=9))
    assert 1e-4 < pixels < 0.2
    assert 1e-7 < scores < 3e-4


def test_pixels_are_never_rounded_to_halves(fp16):
    boxes = OnnxSession(fp16, Runtime(device="cpu")).run(blobs(1)[0])[0]
    corners = boxes[:, :4]
    assert (corners != corners.astype(np.float16)).mean() > 0.9


@pytest.mark.parametrize(("copy", "fraction"), [("int8", 0.6), ("fp16", 0.7)])
def test_copy_is_smaller_with_equal_metadata(request, network, copy, fraction):
    out = request.getfixturevalue(copy)
    onnx.checker.check_model(onnx.load(out), full_check=True)
    assert 0.2 < out.stat().st_size / network.stat().st_size < fraction
    assert metadata(out) == METADATA
    before, after = (OnnxSession(path, Runtime(device="cpu")) for path in (network, out))
    assert (after.input_dtype, after.input_shape) == (before.input_dtype, before.input_shape)


def test_heads_stay_in_float(int8):
    graph = onnx.load(int8).graph
    producer = {name: node for node in graph.node for name in node.output}
    bytes_in = {name for name, node in producer.items() if node.op_type == "DequantizeLinear"}
    layers = [node for node in graph.node if node.op_type == "Conv"]
    assert [node.input[1] in bytes_in for node in layers] == [True, True, True, False]
    tail = [producer[name] for name in ("boxes", "scores", "corners_px", "corners", "unit", "head")]
    assert [
        name for node in tail for name in node.input if name in bytes_in and node.op_type != "Conv"
    ] == []


def test_noisy_tensor_stays_in_float(tmp_path):
    path = yolo_network(tmp_path / "uneven.onnx", quiet_gain=0.005)
    out, inaccurate = tmp_path / "accurate.onnx", tmp_path / "inaccurate.onnx"
    quantize_int8(path, out, blobs=blobs(12))
    quantize_int8(path, inaccurate, blobs=blobs(12), max_noise_ratio=np.inf)
    inputs = blobs(4, seed=9)
    error_px, large_error_px = (mean_errors(path, copy, inputs)[0] for copy in (out, inaccurate))
    assert 0.01 < error_px < large_error_px / 3
    assert operators(out).count("DequantizeLinear") < operators(inaccurate).count(
        "DequantizeLinear"
    )


def mean_shift(path, other, tensor, folder):
    """Mean absolute difference of the mean of a tensor (N, C, H, W), by channel, between two
    networks."""
    means = []
    for file in (path, other):
        model = onnx.load(file)
        del model.graph.output[:]
        model.graph.output.append(helper.make_tensor_value_info(tensor, TensorProto.FLOAT, None))
        onnx.save(model, folder / "probe.onnx")
        session = OnnxSession(folder / "probe.onnx", Runtime(device="cpu"))
        means.append(np.mean([session.run(blob)[0] for blob in blobs(12)], axis=(0, 1, 3, 4)))
    return np.abs(means[0] - means[1]).mean()


def test_mean_output_is_that_of_the_original(network, int8, tmp_path):
    uncorrected = tmp_path / "uncorrected.onnx"
    quantize_int8(network, uncorrected, blobs=iter(blobs(12)), corrects_biases=False)
    assert mean_shift(network, int8, "head", tmp_path) < 0.1 * mean_shift(
        network, uncorrected, "head", tmp_path
    )


def test_shared_biases_are_corrected_separately(tmp_path):
    rng = np.random.default_rng(2)
    weights = [weight(rng, f"w_{name}", 4, 3 if name == "a" else 4, 3, 3) for name in "abcd"]
    nodes = [
        helper.make_node("Conv", [source, f"w_{name}", "bias"], [name], pads=[1, 1, 1, 1])
        for source, name in zip(("images", "a", "b", "c"), "abcd", strict=True)
    ]
    bias = numpy_helper.from_array(np.float32([0.1, -0.2, 0.3, 0.4]), "bias")
    path = saved(tmp_path / "net.onnx", nodes, [*weights, bias], outputs=["d"])
    corrected, uncorrected = tmp_path / "corrected.onnx", tmp_path / "uncorrected.onnx"
    quantize_int8(path, corrected, blobs=blobs(12))
    quantize_int8(path, uncorrected, blobs=blobs(12), corrects_biases=False)
    for tensor in "abcd":
        shifts = [mean_shift(path, file, tensor, tmp_path) for file in (corrected, uncorrected)]
        assert shifts[0] < 0.2 * shifts[1], tensor


def test_progress_counts_the_convolutions(network, tmp_path):
    calls = []
    quantize_int8(
        network, tmp_path / "out.onnx", blobs=blobs(2), progress=lambda *call: calls.append(call)
    )
    assert calls == [(i, len(calls)) for i in range(operators(network).count("Conv"))]


def test_noise_ratio_by_hand():
    # scale 1, noise 1/12, variance 5461.25
    ramp = np.linspace(0, 255, 256, dtype=np.float32).reshape(1, 1, 16, 16)
    assert quantize._noise_ratio(ramp) == pytest.approx(1 / 12 / 5461.25, rel=1e-6)
    flat = np.concatenate([ramp, np.zeros_like(ramp)], axis=1)  # the second channel is all noise
    assert quantize._noise_ratio(flat) == pytest.approx((1 + 1 / 12 / 5461.25) / 2, rel=1e-6)


def test_weighted_mean_of_yolov8_stays_in_float(tmp_path):
    rng = np.random.default_rng(2)
    weights = [
        weight(rng, "w_a", 8, 3, 3, 3),
        weight(rng, "w_head", 16, 8, 3, 3),
        numpy_helper.from_array(np.arange(16, dtype=np.float32).reshape(1, 16, 1, 1), "bins"),
    ]
    nodes = [convolution("images", "a"), *silu("a", "a_act"), convolution("a_act", "head")]
    nodes += [
        helper.make_node("Softmax", ["head"], ["share"], axis=1),
        helper.make_node("Conv", ["share", "bins"], ["boxes"]),
    ]
    path = saved(tmp_path / "v8.onnx", nodes, weights, opset=13)
    out = tmp_path / "out.onnx"
    quantize_int8(path, out, blobs=blobs(4))
    graph = onnx.load(out).graph
    bytes_in = {
        name for node in graph.node if node.op_type == "DequantizeLinear" for name in node.output
    }
    assert [n.input[1] in bytes_in for n in graph.node if n.op_type == "Conv"] == [
        True,
        False,
        False,
    ]


def test_shape_computations_are_not_quantised(tmp_path):
    rng = np.random.default_rng(4)
    weights = [
        *(
            weight(rng, f"w_{name}", 8, depth, 3, 3)
            for name, depth in (("a", 3), ("b", 8), ("boxes", 8))
        ),
        numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32), "twice"),
        numpy_helper.from_array(np.array([], np.float32), "none"),
    ]
    nodes = [
        convolution("images", "a", stride=2),
        *silu("a", "a_act"),
        helper.make_node("Shape", ["a_act"], ["shape"]),
    ]
    nodes += [
        helper.make_node("Cast", ["shape"], ["shape_f"], to=TensorProto.FLOAT),
        helper.make_node("Mul", ["shape_f", "twice"], ["sizes_f"]),
        helper.make_node("Floor", ["sizes_f"], ["sizes_floor"]),
        helper.make_node("Cast", ["sizes_floor"], ["sizes"], to=TensorProto.INT64),
        helper.make_node("Resize", ["a_act", "none", "none", "sizes"], ["up"], mode="nearest"),
        convolution("up", "b"),
        *silu("b", "b_act"),
        convolution("b_act", "boxes"),
    ]
    path = saved(tmp_path / "open.onnx", nodes, weights)
    model = onnx.load(path)
    for axis in (2, 3):
        model.graph.input[0].type.tensor_type.shape.dim[axis].dim_param = f"side{axis}"
    del model.graph.value_info[:]
    onnx.save(model, path)
    out = tmp_path / "out.onnx"
    quantize_int8(path, out, blobs=blobs(4, size=64))
    for size in (64, 200, 296):  # quantised with a step of 64 / 255, the other sizes would be wrong
        assert OnnxSession(out, Runtime(device="cpu")).run(
            np.zeros((1, 3, size, size), np.float32)
        )[0].shape[2:] == (
            size,
            size,
        )


def test_conversion_is_silent(network, tmp_path, capfd, caplog):
    handlers = list(logging.root.handlers)
    with caplog.at_level(logging.DEBUG):
        quantize_int8(network, tmp_path / "a.onnx", blobs=blobs(2))
        convert_fp16(network, tmp_path / "b.onnx")
    assert (capfd.readouterr(), caplog.records, logging.root.handlers) == (("", ""), [], handlers)
    assert logging.root.manager.disable == 0


def test_no_temporary_files_remain(network, tmp_path):
    out = tmp_path / "out.onnx"
    quantize_int8(network, out, blobs=blobs(2))
    convert_fp16(network, out)
    with pytest.raises(ModelError):
        quantize_int8(network, out, blobs=[])
    assert list(tmp_path.iterdir()) == [out]


def both(path, out):
    yield lambda: quantize_int8(path, out, blobs=blobs(2))
    yield lambda: convert_fp16(path, out)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("int8", "int8.onnx: .*quantised"),
        ("fp16", "fp16.onnx: .*16-bit"),
        ("missing", "missing.onnx: no such"),
    ],
)
def test_only_float_networks_are_quantised(request, network, tmp_path, source, message):
    path = tmp_path / "missing.onnx" if source == "missing" else request.getfixturevalue(source)
    for convert in both(path, tmp_path / "out.onnx"):
        with pytest.raises(ModelError, match=message):
            convert()
    assert list(tmp_path.iterdir()) == []


def test_network_without_convolutions(tmp_path):
    path = saved(tmp_path / "relu.onnx", [helper.make_node("Relu", ["images"], ["boxes"])], [])
    for convert in both(path, tmp_path / "out.onnx"):
        with pytest.raises(ModelError, match=r"relu\.onnx: .*convolutions"):
            convert()


def test_network_with_one_convolution(tmp_path):
    path = saved(
        tmp_path / "one.onnx",
        [convolution("images", "boxes")],
        [weight(np.random.default_rng(0), "w_boxes", 4, 3, 3, 3)],
    )
    with pytest.raises(ModelError, match=r"one\.onnx: .*FP16"):
        quantize_int8(path, tmp_path / "out.onnx", blobs=blobs(2))


def test_no_blobs(network, tmp_path):
    with pytest.raises(ModelError, match=r"net\.onnx: .*calibration images"):
        quantize_int8(network, tmp_path / "out.onnx", blobs=iter([]))


@pytest.mark.parametrize("position", [0, 5])
def test_blobs_of_wrong_size(network, tmp_path, position):
    wrong = blobs(6)
    wrong[position] = np.zeros((1, 3, 40, 40), np.float32)
    with pytest.raises(ModelError, match=r"net\.onnx: .*(failed|cannot be quantised)"):
        quantize_int8(network, tmp_path / "out.onnx", blobs=wrong)
    assert list(tmp_path.iterdir()) == []


def test_no_folder_to_write_into(network, tmp_path):
    for convert in both(network, tmp_path / "missing" / "out.onnx"):
        with pytest.raises(ModelError, match=r"out\.onnx: .*folder"):
            convert()


def test_weights_listed_as_inputs(network, tmp_path):
    model = onnx.load(network)
    image = model.graph.input.pop()
    weights = [
        helper.make_tensor_value_info(t.name, t.data_type, t.dims) for t in model.graph.initializer
    ]
    model.graph.input.extend([*weights, image])
    model.ir_version = 3
    path, out = tmp_path / "old.onnx", tmp_path / "out.onnx"
    onnx.save(model, path)
    quantize_int8(path, out, blobs=blobs(4))
    assert 0.05 < mean_errors(network, out, blobs(4, seed=9))[0] < 6


def test_network_with_target_sizes(network, tmp_path):
    # As in D-FINE's export: boxes in fractions of the image, times the input `orig_target_sizes`.
    model = onnx.load(network)
    model.graph.input.append(
        helper.make_tensor_value_info("orig_target_sizes", TensorProto.INT64, [1, 2])
    )
    model.graph.node.extend(
        [
            helper.make_node("Cast", ["orig_target_sizes"], ["sizes"], to=TensorProto.FLOAT),
            helper.make_node("ReduceMax", ["sizes"], ["side"], keepdims=0),
            helper.make_node("Mul", ["unit", "side"], ["scaled"]),
        ]
    )
    model.graph.output.append(helper.make_tensor_value_info("scaled", TensorProto.FLOAT, None))
    path, out = tmp_path / "detr.onnx", tmp_path / "out.onnx"
    onnx.save(onnx.shape_inference.infer_shapes(model), path)
    for convert in both(path, out):
        convert()
        (blob,) = blobs(1, seed=9)
        reference, copy = (OnnxSession(p, Runtime(device="cpu")).run(blob)[1] for p in (path, out))
        assert reference.max() > SIZE_PX / 2  # scaled by the size of the input
        assert 0 < np.abs(copy - reference).mean() < 0.05 * SIZE_PX


def test_converter_failure_message():
    message = r"net\.onnx: cannot be converted .*No model"
    with (
        pytest.raises(ModelError, match=message),
        silent_conversion(Path("net.onnx"), "converted to FP16"),
    ):
        raise RuntimeError("No model\nsecond line")


def test_int8_yolov5n_agrees_with_float(shared_data, tmp_path):
    path, out = shared_data / "models" / "yolov5n_coco_dyn.onnx", tmp_path / "out.onnx"
    inputs = blobs(6, size=192)
    quantize_int8(path, out, blobs=inputs)
    one, two = (
        OnnxSession(p, Runtime(device="cpu")).run(blobs(1, size=224, seed=8)[0])[0]
        for p in (path, out)
    )
    assert 0.3 < out.stat().st_size / path.stat().st_size < 0.4
    assert one.shape == two.shape
    assert 0.05 < np.abs(one - two)[..., :4].mean() < 4  # pixels of 224
    assert 1e-6 < np.abs(one - two)[..., 4].mean() < 0.01


def test_unwritable_output(tmp_path):
    (tmp_path / "out").mkdir()
    with (
        pytest.raises(ModelError, match="out: cannot be written"),
        atomic_output(tmp_path / "out") as folder,
    ):
        (folder / "out").write_text("a file cannot replace a folder")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
