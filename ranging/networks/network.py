"""DepthNetwork and StereoNetwork: networks of ONNX files, from images to a DenseMap."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.models.onnx_session import OnnxNetwork, Runtime
from track_range.foundation.arrays import FloatArray32, Image
from track_range.foundation.files.input_files import shortened
from track_range.ranging.measurement.dense_map import DenseMap, Quantity
from track_range.ranging.networks.inputs import NetworkInputs
from track_range.ranging.networks.network_format import NetworkError, Task
from track_range.ranging.networks.placement import Placement
from track_range.ranging.networks.recognition import check_task, format_of

_MAX_OUTPUT_SIDE = 8192


class _Network:
    """A network with its format; `source` says where the format is from."""

    def __init__(self, path: Path, runtime: Runtime | None, task: Task) -> None:
        self.session = OnnxNetwork(path, runtime)
        outputs = list(self.session.output_infos)
        self.source, self.format = format_of(path, list(self.session.input_infos), outputs)
        check_task(path, self.format, task)
        self.inputs = NetworkInputs(self.session, self.format)
        self._names = [one.name for one in outputs]
        self._check_outputs()

    @property
    def path(self) -> Path:
        """The file of the network."""
        return self.session.path

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user, such as a device that is not available."""
        return self.session.notes

    @property
    def is_metric(self) -> bool:
        """Whether its values are metres or pixels, and not right up to a factor."""
        return self.format.metric

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

    def _run(
        self, images: dict[str, Image], fx_px: float
    ) -> tuple[Placement, dict[str, npt.NDArray[Any]]]:
        image_hw = next(iter(images.values())).shape[:2]
        placement = self.inputs.placement((image_hw[0], image_hw[1]))
        inputs = self.inputs.blobs(images, placement, fx_px)
        outputs = self.session.run_inputs(inputs)
        return placement, dict(zip(self._names, outputs, strict=True))

    def _plane(self, outputs: dict[str, npt.NDArray[Any]], name: str | None) -> FloatArray32:
        """An output as (h, w): its first channel; NaN where it is not finite."""
        name = name or self._names[0]
        values = np.asarray(outputs[name], np.float32)
        plane = _first_plane(values)
        if plane is None or max(plane.shape) > _MAX_OUTPUT_SIDE:
            shape = shortened(str(values.shape), 60)
            raise NetworkError(
                f"{self.path}: expected an output {name} [batch, 1, height, width], got {shape}."
            )
        return np.where(np.isfinite(plane), plane, np.float32(np.nan))


def _first_plane(values: FloatArray32) -> FloatArray32 | None:
    """The first (h, w) of an output whose channels are first or last; None = it has none."""
    while values.ndim > 3:
        values = values[0]
    if values.ndim == 3:
        channels_last = values.shape[2] <= 3 < values.shape[0]
        values = values[..., 0] if channels_last else values[0]
    return values if values.ndim == 2 and values.size else None


class DepthNetwork(_Network):
    """A network that gives the depth of one image."""

    def measure(self, image: Image, fx_px: float) -> DenseMap:
        """Depths or inverse depths of an image (H, W, 3), BGR, of a camera with this focal length
        in pixels; NaN where the network gives none.
        """
        placement, outputs = self._run({"image": image}, fx_px)
        values = self._plane(outputs, self.format.output) * np.float32(self.format.scale)
        if self.format.focal_px is not None:
            ratio = fx_px * placement.focal_scale / self.format.focal_px
            values *= np.float32(ratio if self.format.gives == "depth" else 1 / ratio)
        values = placement.of_the_image(values)
        if self.format.metric or self.format.gives == "depth":
            values[~(values > 0)] = np.nan
        quantity: Quantity = "inverse_depth" if self.format.gives == "inverse_depth" else "depth"
        return DenseMap(values, quantity, placement.image_hw, self.format.metric)


class StereoNetwork(_Network):
    """A network that gives the disparities of a rectified pair."""

    def measure(self, left: Image, right: Image) -> DenseMap:
        """Disparities x_left - x_right in pixels of the left image (H, W, 3), BGR; NaN where the
        network gives none.
        """
        if left.shape != right.shape:
            raise NetworkError(
                f"{self.path}: expected two images of one size, got {left.shape} and {right.shape}."
            )
        placement, outputs = self._run({"left": left, "right": right}, float("nan"))
        values = self._plane(outputs, self.format.output)
        values = values * np.float32(self.format.scale / placement.scale_x)
        values = placement.of_the_image(values)
        values[~(values > 0)] = np.nan
        return DenseMap(values, "disparity", placement.image_hw, self.format.metric)


def open_depth_network(path: Path, runtime: Runtime | None = None) -> DepthNetwork:
    """The depth network in an ONNX file; NetworkError or ModelError if it is none."""
    return DepthNetwork(path, runtime, "depth")


def open_stereo_network(path: Path, runtime: Runtime | None = None) -> StereoNetwork:
    """The stereo network in an ONNX file; NetworkError or ModelError if it is none."""
    return StereoNetwork(path, runtime, "stereo")
