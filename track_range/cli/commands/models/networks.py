"""What is understood of a network: rows of a depth or stereo network, or of a detector."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from track_range.cli.commands.models.info import detector_rows
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.arrays import FloatArray32, Image
from track_range.foundation.errors import ConfigError
from track_range.ranging.measurement.dense_map import DenseMap
from track_range.ranging.networks.network import DepthNetwork, StereoNetwork, open_network
from track_range.ranging.networks.network_format import NetworkError
from track_range.ranging.networks.recognition import has_network_settings

Row = tuple[str, str, str]  # property, value, source

# runs after the first one, of which the median is shown, unless the first one is slow
_N_TIMED, _SLOW_S = 5, 1.0
_UNITS = {"depth": "m", "inverse_depth": "1/m", "disparity": "px"}


def model_rows(
    path: Path, image_hw: tuple[int, int], images: list[Image], fx_px: float | None
) -> list[Row]:
    """Rows of the network in a file; with images, also of what it gives for them.

    ModelError if the file has neither a depth or stereo network nor a detector; ConfigError for
    another number of images than the network takes.
    """
    try:
        network = open_network(path)
    except NetworkError as error:
        try:
            detector = YoloDetector(path)
        except ModelError as reason:
            if has_network_settings(path):
                raise error from None
            no_detector = str(reason).removeprefix(f"{path}: ")
            raise NetworkError(f"{error} It is no detector either: {no_detector}") from error
        return [("kind", "detector", ""), *detector_rows(detector)]
    return [
        *_format_rows(network),
        *_size_rows(network, image_hw),
        *_values(network, images, fx_px),
    ]


def _format_rows(network: DepthNetwork | StereoNetwork) -> Iterator[Row]:
    stated, session = network.format, network.session
    yield "kind", f"{stated.task} network", network.source
    for info in session.input_infos:
        content = network.inputs.contents[info.name]
        yield f"input {info.name}", f"{list(info.shape)} {info.type}", f"gets {content}"
    used = {
        stated.output or session.output_infos[0].name: stated.gives,
        stated.confidence: "confidence",
        stated.factor: "factor",
        stated.mask: "mask",
    }
    for info in session.output_infos:
        meaning = used.get(info.name, "not used")
        yield f"output {info.name}", f"{list(info.shape)} {info.type}", meaning
    yield (
        "pixels",
        f"({stated.colours} / {stated.divisor:g} - {_numbers(stated.mean)}) / "
        f"{_numbers(stated.std)}",
        "",
    )
    factor = "" if stated.scale == 1 else f"{stated.gives} times {stated.scale:g}"
    if stated.focal_px is not None:
        factor = f"depth times f / {stated.focal_px:g}, f in pixels of the input"
    up_to = "up to a factor" if stated.gives == "depth" else "up to a factor and a constant"
    yield "scale", "metric" if stated.metric else up_to, factor


def _size_rows(network: DepthNetwork | StereoNetwork, image_hw: tuple[int, int]) -> Iterator[Row]:
    placement = network.inputs.placement(image_hw)
    (h, w), (height, width) = placement.input_hw, placement.resized_hw
    yield (
        "size",
        f"{w}x{h} for images of {image_hw[1]}x{image_hw[0]}",
        f"{placement.fit}: {width}x{height} of the input",
    )
    time_s = network.inference_s(image_hw)
    if time_s < _SLOW_S:
        time_s = float(np.median([network.inference_s(image_hw) for _ in range(_N_TIMED)]))
    yield "time", f"{1000 * time_s:.0f} ms per image", f"on {network.session.device}"
    yield "sha256", network.session.sha256(), ""


def _values(
    network: DepthNetwork | StereoNetwork, images: list[Image], fx_px: float | None
) -> Iterator[Row]:
    if not images:
        return
    n = 1 if isinstance(network, DepthNetwork) else 2
    if len(images) != n:
        raise ConfigError(
            f"--image: expected {n} for a {network.format.task} network, found {len(images)}."
        )
    if isinstance(network, DepthNetwork):
        width = float(images[0].shape[1])
        focal = f"f = {fx_px or width:g} px"
        assumed = "" if fx_px else ", assumed (--focal-px)"
        dense = network.measure(images[0], fx_px or width)
        source = focal + assumed
    else:
        dense, source = network.measure(images[0], images[1]), ""
    parts = zip(("upper", "middle", "lower"), np.array_split(dense.values, 3), strict=True)
    for name, part in parts:
        yield f"{name} third", _spread(dense, part), source


def _spread(dense: DenseMap, part: FloatArray32) -> str:
    """Median and 80 % of the values in a part of a map."""
    known = part[np.isfinite(part)]
    if not known.size:
        return "no values"
    low, median, high = np.percentile(known, [10, 50, 90])
    unit = _UNITS[dense.quantity] if dense.is_metric else "relative"
    return f"{median:.3g} ({low:.3g} to {high:.3g}) {unit}, {100 * known.size / part.size:.0f} %"


def _numbers(values: tuple[float, ...]) -> str:
    return str([round(value, 4) for value in values])
