"""ReidModel: appearance embeddings from a re-identification network (ONNX), such as OSNet (Zhou et al., ICCV 2019).

    crop -> resized to the network's input -> RGB, (value / 255 - mean) / standard deviation -> unit-norm features

Resizing does not keep the aspect ratio. Mean and standard deviation are ImageNet's, with which
torchreid and FastReID train. Crops are processed in batches.
"""

from pathlib import Path

import cv2
import numpy as np

from track_range.detection.detections import Descriptors
from track_range.detection.models.onnx_session import ModelError, OnnxSession, Runtime
from track_range.foundation.arrays import FloatArray, FloatArray32, Image, check_shape
from track_range.tracking.appearance.embeddings import has_appearance
from track_range.tracking.appearance.gallery import unit_rows

OPEN_INPUT_HW = (256, 128)  # for a network with a dynamic input size: the usual one for people

_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
# mean and sigma of ImageNet's red, green and blue, 0..1
_STD = np.array([0.229, 0.224, 0.225], np.float32)
_MAX_BATCH = 8  # crops; on a CPU, OSNet takes 3.0 ms per crop with 8, 7.7 ms with 32


class ReidModel:
    """Computes appearance embeddings with a re-identification network.

    The default `max_cosine_distance` was chosen for OSNet x0.25 on KITTI 0003 and 0005 and
    simulated drives: 0 to 10 % of the pairs of the same object are rejected, 0 to 16 % of different
    objects accepted.
    """

    def __init__(
        self, model: Path, runtime: Runtime | None = None, *, max_cosine_distance: float = 0.27
    ) -> None:
        """Load the network and run it once; ModelError if it is missing, or is not a
        re-identification network.
        """
        self.max_cosine_distance = max_cosine_distance
        self._session = OnnxSession(model, runtime)
        self.notes = self._session.notes
        batch, channels, height, width = self._session.input_shape
        if channels != 3:
            raise ModelError(
                f"{model}: expected one input [batch, 3, height, width], found "
                f"{_shape_text(self._session.input_shape)}; use a re-identification network."
            )
        # to which crops are resized
        self.input_hw = (height or OPEN_INPUT_HW[0], width or OPEN_INPUT_HW[1])
        self._fixed_batch = batch
        # Two images reveal a network that declares a dynamic batch size but mixes up its rows.
        self.n_values = self._run(np.zeros((batch or 2, 3, *self.input_hw), np.float32)).shape[1]

    def embed(self, image: Image, xyxy_px: FloatArray) -> Descriptors:
        """(N, D) unit-norm embeddings of the boxes (N, 4) in `image`, (H, W, 3) uint8 BGR; zeros =
        unknown.

        Raises ModelError: the network fails; ValueError: the image is not (H, W, 3).
        """
        check_shape("image", image, (None, None, 3))
        embedding = np.zeros((len(xyxy_px), self.n_values), np.float32)
        usable = np.flatnonzero(has_appearance(image, xyxy_px))
        step = self._fixed_batch or _MAX_BATCH
        for start in range(0, len(usable), step):
            rows = usable[start : start + step]
            blob = np.zeros((self._fixed_batch or len(rows), 3, *self.input_hw), np.float32)
            # a fixed batch is padded with zeros
            for target, box in zip(blob, xyxy_px[rows], strict=False):
                _write_crop(image, box, target)
            embedding[rows] = unit_rows(self._run(blob)[: len(rows)])
        return embedding

    def _run(self, blob: FloatArray32) -> FloatArray32:
        """(batch, D) features of crops (batch, 3, height, width)."""
        outputs = self._session.run(blob)
        if (
            len(outputs) != 1
            or outputs[0].ndim != 2
            or len(outputs[0]) != len(blob)
            or not outputs[0].size
        ):
            shapes = ", ".join(_shape_text(output.shape) for output in outputs)
            raise ModelError(
                f"{self._session.path}: expected one output [batch, values] for {len(blob)} crops, "
                f"found {shapes}; use a re-identification network, not a detector."
            )
        return outputs[0]


def _write_crop(image: Image, box: FloatArray, target: FloatArray32) -> None:
    """Write the part of the box (4,) inside the image into `target` (3, height, width),
    normalised.
    """
    height, width = image.shape[:2]
    # The pixels with their centres in the box; pixel i runs from i - 0.5 to i + 0.5.
    x1, y1, x2, y2 = np.rint(np.clip(box + 0.5, 0, [width, height, width, height])).astype(np.int64)
    crop = image[y1:y2, x1:x2]
    is_shrunk = crop.shape[0] >= target.shape[1]
    interpolation = cv2.INTER_AREA if is_shrunk else cv2.INTER_LINEAR
    resized = cv2.resize(crop, (target.shape[2], target.shape[1]), interpolation=interpolation)
    rgb = resized[..., ::-1].astype(np.float32) / 255.0
    target[:] = ((rgb - _MEAN) / _STD).transpose(2, 0, 1)


def _shape_text(shape: tuple[int | None, ...]) -> str:
    """A shape for messages, such as [any, 3, 256, 128]."""
    return "[" + ", ".join("any" if side is None else str(side) for side in shape) + "]"
