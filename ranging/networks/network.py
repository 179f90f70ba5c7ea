"""DepthNetwork and StereoNetwork: networks of ONNX files, from images to a DenseMap."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.models.onnx_session import OnnxNetwork, Runtime
from track_range.foundation.arrays import FloatArray, FloatArray32, Image
from track_range.ranging.measurement.dense_map import DenseMap, Quantity
from track_range.ranging.networks.inputs import NetworkInputs
from track_range.ranging.networks.network_format import MAX_SIDE_PX, NetworkError, NetworkFormat
from track_range.ranging.networks.output_check import OutputCheck
from track_range.ranging.networks.placement import InputPlacement
from track_range.ranging.networks.recognition import format_of

_MIN_MASK = 0.5  # of pixels with a depth
# points for the shift of point maps, its steps, and the least depth in the unit of the points
_N_FITTED, _N_STEPS, _MIN_Z = 4096, 10, 1e-3


class _Network:
    """A network with its format; `source` says where the format is from."""

    def __init__(self, session: OnnxNetwork, source: str, network: NetworkFormat) -> None:
        self.session, self.source, self.format = session, source, network
        self.inputs = NetworkInputs(session, network)
        self._names = [one.name for one in session.output_infos]
        self._check_outputs()
        self._check = OutputCheck(session.path, network.metric)

    @property
    def path(self) -> Path:
        """The file of the network."""
        return self.session.path

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user, such as a device that is not available."""
        return (*self.session.notes, *self._check.notes)

    @property
    def is_metric(self) -> bool:
        """Whether its values are metres or pixels, and not right up to a factor."""
        return self.format.metric

    @property
    def described(self) -> dict[str, Any]:
        """How the file is understood, for summary.json."""
        return {
            "sha256": self.session.sha256(),
            "format": self.source,
            "gives": self.format.gives,
            "metric": self.format.metric,
            "device": self.session.device,
        }

    def _check_outputs(self) -> None:
        named = {
            "output": self.format.output,
            "confidence": self.format.confidence,
            "factor": self.format.factor,
            "mask": self.format.mask,
        }
        known = ", ".join(self._names)
        for key, name in named.items():
            if name is not None and name not in self._names:
                raise NetworkError(
                    f"{self.path}: '{key}': expected one of its outputs {known}, found {name!r}."
                )
        if self.format.output is None and len(self._names) != 1:
            raise NetworkError(
                f"{self.path}: expected the name of the output with the {self.format.gives}, found "
                f"several outputs; add `output: {self._names[0]}` or another one of {known} to its "
                "MODEL.yaml."
            )

    def inference_s(self, image_hw: tuple[int, int]) -> float:
        """Seconds that the network takes for a grey image, or pair, of this size."""
        image = np.full((*image_hw, 3), 128, np.uint8)
        start_s = time.perf_counter()
        self._run(dict.fromkeys(("image", "left", "right"), image), float(image_hw[1]))
        return time.perf_counter() - start_s

    def _run(
        self, images: dict[str, Image], fx_px: float
    ) -> tuple[InputPlacement, dict[str, npt.NDArray[Any]]]:
        image_hw = next(iter(images.values())).shape[:2]
        placement = self.inputs.placement((image_hw[0], image_hw[1]))
        inputs = self.inputs.blobs(images, placement, fx_px)
        outputs = self.session.run_inputs(inputs)
        return placement, dict(zip(self._names, outputs, strict=True))

    def _plane(self, outputs: dict[str, npt.NDArray[Any]], name: str | None) -> FloatArray32:
        """An output as (h, w): its first channel; NaN where it is not finite."""
        return np.ascontiguousarray(self._channels(outputs, name)[0])

    def _channels(self, outputs: dict[str, npt.NDArray[Any]], name: str | None) -> FloatArray32:
        """An output as (channels, h, w), of the first image; NaN where it is not finite."""
        name = name or self._names[0]
        values = np.asarray(outputs[name], np.float32)
        shape = values.shape
        while values.ndim > 3:
            values = values[0]
        if values.ndim == 3 and values.shape[2] <= 3 < values.shape[0]:
            values = values.transpose(2, 0, 1)
        if values.ndim == 2:
            values = values[None]
        if values.ndim != 3 or not values.size or max(values.shape) > MAX_SIDE_PX:
            raise NetworkError(
                f"{self.path}: expected an output {name} [batch, 1, height, width], got {shape}."
            )
        return np.where(np.isfinite(values), values, np.float32(np.nan))

    def _confidence(
        self, outputs: dict[str, npt.NDArray[Any]], placement: InputPlacement
    ) -> FloatArray32 | None:
        if self.format.confidence is None:
            return None
        return placement.of_the_image(self._plane(outputs, self.format.confidence).clip(0.0, 1.0))


class DepthNetwork(_Network):
    """A network that gives the depth of one image."""

    def measure(self, image: Image, fx_px: float) -> DenseMap:
        """Depths or inverse depths of an image (H, W, 3), BGR, of a camera with this focal length
        in pixels; NaN where the network gives none.
        """
        placement, outputs = self._run({"image": image}, fx_px)
        if self.format.gives == "points":
            values = self._of_points(outputs, placement, fx_px)
        else:
            values = self._plane(outputs, self.format.output)
        values = values * np.float32(self.format.scale)
        if self.format.focal_px is not None:
            ratio = fx_px * placement.scale_x / self.format.focal_px
            values *= np.float32(1 / ratio if self.format.gives == "inverse_depth" else ratio)
        if self.format.mask is not None:
            values[~(self._plane(outputs, self.format.mask) >= _MIN_MASK)] = np.nan
        values = placement.of_the_image(values)
        quantity: Quantity = "depth"
        if self.format.gives == "inverse_depth":
            quantity = "inverse_depth"
        self._check.see(image, values, quantity)
        confidence = self._confidence(outputs, placement)
        return DenseMap(values, quantity, placement.image_hw, self.format.metric, confidence)

    def _of_points(
        self, outputs: dict[str, npt.NDArray[Any]], placement: InputPlacement, fx_px: float
    ) -> FloatArray32:
        """(h, w) depth z of points x, y, z, in metres if the format has a factor."""
        points = self._channels(outputs, self.format.output)
        if len(points) != 3:
            raise NetworkError(
                f"{self.path}: expected points [batch, 3, height, width], got "
                f"{outputs[self.format.output or self._names[0]].shape}."
            )
        z = points[2]
        if self.format.affine_points:
            z = z + shift_along_z(points, placement.rays(fx_px, (z.shape[0], z.shape[1])))
        if self.format.factor is not None:
            z = z * np.float32(np.asarray(outputs[self.format.factor]).flat[0])
        return np.asarray(z, np.float32)


class StereoNetwork(_Network):
    """A network that gives the disparities of a rectified pair."""

    def measure(self, left: Image, right: Image) -> DenseMap:
        """Disparities x_left - x_right in pixels of the left image, NaN where the network gives
        none, from images (H, W, 3), BGR, or (H, W), grey.
        """
        if left.shape[:2] != right.shape[:2]:
            raise NetworkError(
                f"{self.path}: expected two images of one size, got {left.shape} and {right.shape}."
            )
        placement, outputs = self._run({"left": left, "right": right}, float("nan"))
        values = self._plane(outputs, self.format.output)
        values = placement.of_the_image(values * np.float32(self.format.scale / placement.scale_x))
        self._check.see(left, values, "disparity")
        confidence = self._confidence(outputs, placement)
        return DenseMap(values, "disparity", placement.image_hw, self.format.metric, confidence)


def shift_along_z(points: FloatArray32, rays: FloatArray) -> np.float32:
    """The length along z by which points (3, h, w) lie on the rays (h, w, 3) of their pixels.

    The s of x / (z + s) = u, by least squares of x - u (z + s) with weights 1 / (z + s)^2 of the
    step before, for x and y together.
    """
    step = max(1, points[2].size // _N_FITTED)
    x = points[:2].reshape(2, -1)[:, ::step].astype(np.float64)
    z = points[2].reshape(-1)[::step].astype(np.float64)
    slopes = (rays[..., :2] / rays[..., 2:]).reshape(-1, 2)[::step].T
    usable = np.isfinite(x).all(axis=0) & np.isfinite(z)
    x, z, slopes = x[:, usable], z[usable], slopes[:, usable]
    shift = 0.0
    for _ in range(_N_STEPS):
        weights = slopes**2 / np.maximum(z + shift, _MIN_Z) ** 2
        total = weights.sum()
        if not total:
            break
        shift = float((weights * (x / np.where(slopes, slopes, 1.0) - z)).sum() / total)
    return np.float32(shift)


def open_network(path: Path, runtime: Runtime | None = None) -> DepthNetwork | StereoNetwork:
    """The depth or stereo network in an ONNX file; NetworkError or ModelError if it is none."""
    session = OnnxNetwork(path, runtime)
    source, network = format_of(path, session.input_infos, session.output_infos)
    kind = DepthNetwork if network.task == "depth" else StereoNetwork
    return kind(session, source, network)


def open_depth_network(path: Path, runtime: Runtime | None = None) -> DepthNetwork:
    """The depth network in an ONNX file; NetworkError or ModelError if it is none."""
    network = open_network(path, runtime)
    if not isinstance(network, DepthNetwork):
        raise NetworkError(
            f"{path}: expected a depth network, found a stereo network; give it as --stereo-model."
        )
    return network


def open_stereo_network(path: Path, runtime: Runtime | None = None) -> StereoNetwork:
    """The stereo network in an ONNX file; NetworkError or ModelError if it is none."""
    network = open_network(path, runtime)
    if not isinstance(network, StereoNetwork):
        raise NetworkError(
            f"{path}: expected a stereo network, found a depth network; give it as --depth-model."
        )
    return network
