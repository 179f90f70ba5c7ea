"""Small depth and stereo networks for tests, which read their answer from the pixels of the image.

`encoded` writes depths into an image: 256 G + R, in steps of `STEP`, at every pixel. A network of
`write_depth` then gives exactly these depths, so that a test chooses what a network sees of a
simulated drive: its truth, 40 % short, or flickering with the image's blue channel.
"""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

STEP = 0.01  # m per count of 256 G + R; up to 655 m. In px for disparities: 1/256 is finer
DISPARITY_STEP = 1 / 256


def encoded(values, step=STEP, blue=0):
    """(H, W, 3) BGR image with `values` (H, W) in its green and red channel, 0 = unknown (NaN);
    `blue` (H, W) or one number."""
    counts = np.clip(np.nan_to_num(np.rint(np.asarray(values) / step)), 0, 65535).astype(np.uint16)
    channels = [np.broadcast_to(np.uint8(blue), counts.shape), counts >> 8, counts & 255]
    return np.stack(channels, axis=2).astype(np.uint8)


def write_depth(
    path, *, factor=1.0, flicker=0.0, gives="depth", constant=None, shape=(None, None), settings=""
):
    """Write a network MODEL.onnx with its MODEL.yaml: the depth that an image encodes, times
    factor * (1 + flicker * (mean blue - 128) / 128), so that images whose blue channel is
    different at each frame make it flicker.

    Args:
        gives: "depth" in m, or "inverse_depth" in 1/m (0 where nothing is encoded).
        constant: a depth in m for all pixels, instead of the encoded one.
        shape: height and width of the input; None = any.
        settings: further lines of MODEL.yaml, such as "metric: false".
    """
    builder = _Builder()
    image = builder.image("image", shape)
    value = builder.decoded(image, STEP)
    if constant is not None:
        value = builder.op("Add", builder.op("Mul", value, 0.0), constant)
    blue = builder.op("ReduceMean", builder.channel(image, 0), keepdims=1)
    flickering = builder.op("Add", builder.op("Mul", blue, factor * flicker / 128), factor)
    value = builder.op("Mul", value, builder.op("Sub", flickering, factor * flicker))
    if gives == "inverse_depth":
        inverse = builder.op("Div", 1.0, builder.op("Max", value, 1e-6))
        value = builder.op("Where", builder.op("Greater", value, 0.0), inverse, 0.0)
    builder.save(path, value, "depth")
    _write_settings(path, f"task: depth\ngives: {gives}\n{_RAW}{settings}")
    return path


def write_stereo(path, *, factor=1.0, offset=0.0, shape=(None, None), settings=""):
    """Write a stereo network with its MODEL.yaml: the disparity that the left image encodes in
    steps of `DISPARITY_STEP`, times `factor`, plus `offset` in px of its input."""
    builder = _Builder()
    left, right = builder.image("left", shape), builder.image("right", shape)
    value = builder.op("Mul", builder.decoded(left, DISPARITY_STEP), factor)
    unused = builder.op("Mul", builder.channel(right, 0), 0.0)
    value = builder.op("Add", builder.op("Add", value, offset), unused)
    builder.save(path, value, "disparity")
    _write_settings(path, f"task: stereo\ngives: disparity\nfit: pad\n{_RAW}{settings}")
    return path


def write_echo(path, channel, *, shape, n_channels=3, settings=""):
    """Write a depth network whose output is one channel of what it takes; `shape` is that of its
    input (height, width)."""
    builder = _Builder()
    image = builder.image("image", shape, n_channels)
    builder.save(path, builder.channel(image, channel), "depth")
    _write_settings(path, settings)
    return path


_RAW = "colours: bgr\ndivisor: 1\n"


def _write_settings(path, text):
    path.with_suffix(".yaml").write_text(text, encoding="utf-8")


class _Builder:
    """An ONNX graph, written node by node."""

    def __init__(self):
        self.nodes, self.weights, self.inputs = [], [], []

    def image(self, name, shape, n_channels=3):
        sides = [side or f"{name}_{axis}" for axis, side in zip("hw", shape, strict=True)]
        info = helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, n_channels, *sides])
        self.inputs.append(info)
        return name

    def constant(self, value, dtype=np.float32):
        name = f"constant{len(self.weights)}"
        self.weights.append(numpy_helper.from_array(np.asarray(value, dtype), name))
        return name

    def op(self, kind, *inputs, **attributes):
        names = [one if isinstance(one, str) else self.constant(one) for one in inputs]
        output = f"value{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, names, [output], **attributes))
        return output

    def channel(self, image, number):
        return self.op("Gather", image, self.constant([number], np.int64), axis=1)

    def decoded(self, image, step):
        green, red = self.channel(image, 1), self.channel(image, 2)
        return self.op("Mul", self.op("Add", self.op("Mul", green, 256.0), red), step)

    def save(self, path, value, name):
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        info = helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, "h", "w"])
        graph = helper.make_graph(self.nodes, "made", self.inputs, [info], self.weights)
        opset = [helper.make_opsetid("", 17)]
        model = helper.make_model(graph, opset_imports=opset, ir_version=8)
        onnx.checker.check_model(model)
        path.write_bytes(model.SerializeToString())


_NUMBERS = {
    "uint8": TensorProto.UINT8,
    "int64": TensorProto.INT64,
    "float16": TensorProto.FLOAT16,
    "float32": TensorProto.FLOAT,
}


def write_export(path, inputs, outputs):
    """Write a network with the inputs and outputs of an export, and constant outputs.

    Args:
        inputs: "NAME TYPE SIDE..." of each, such as "image float32 1 3 height width".
        outputs: array of each by name.
    """
    infos = []
    for text in inputs:
        name, kind, *sides = text.split()
        shape = [int(side) if side.isdigit() else side for side in sides]
        infos.append(helper.make_tensor_value_info(name, _NUMBERS[kind], shape))
    arrays = {name: np.asarray(array, np.float32) for name, array in outputs.items()}
    nodes = [helper.make_node("Identity", [f"{name}_value"], [name]) for name in arrays]
    weights = [numpy_helper.from_array(array, f"{name}_value") for name, array in arrays.items()]
    results = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, array.shape)
        for name, array in arrays.items()
    ]
    graph = helper.make_graph(nodes, "export", infos, results, weights)
    opset = [helper.make_opsetid("", 17)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path
