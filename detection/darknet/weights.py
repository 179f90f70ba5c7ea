"""Reader of Darknet's weights files: a header and the float32 values of every convolution in the cfg's order.

    int32 major, minor, revision; number of training images: uint64 from version 0.2, uint32 before
    per convolution: bias[F], with batch norm also scale[F], mean[F], variance[F], then weights[F, C / groups, k, k]

All values are little-endian. Batch norm is folded into the convolution, in float64:

    a = scale / sqrt(variance + epsilon)        weights' = a weights        bias' = bias - a mean

with epsilon = 0.00001 as in AlexeyAB's `fuse_conv_batchnorm` (network.c), with which YOLOv4 was trained. Redmon's
Darknet uses sqrt(variance) + 0.000001 and OpenCV sqrt(variance + 0.000001); the difference matters only for channels
with a tiny variance.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.darknet.layers import Convolution, Network
from track_range.detection.models.onnx_session import ModelError
from track_range.foundation.arrays import FloatArray32
from track_range.foundation.files.input_files import open_regular, readable

_EPSILON = 0.00001

_VERSION_BYTES = 12  # three version numbers at the start of the file
_MAX_VERSION = 999  # Darknet transposes the weights of files with larger ones

_BYTES_PER_VALUE = 4


def read_convolutions(path: Path, network: Network) -> Iterator[tuple[FloatArray32, FloatArray32]]:
    """Weights (F, C / groups, k, k) and bias (F,) of each convolution of `network`, including its batch norm.

    ModelError if the file cannot be read, has another number of values than the network, or values that are not finite.
    """
    values = _values(path, network.n_values)
    start = 0
    for index, layer in enumerate(network.layers):
        if isinstance(layer.operation, Convolution):
            end = start + layer.operation.n_values
            with np.errstate(all="ignore"):  # overflow is reported below
                weights, bias = _folded(layer.operation, values[start:end].astype(np.float64))
            if not (np.isfinite(weights).all() and np.isfinite(bias).all()):
                raise ModelError(
                    f"{path}: the weights of layer {index} are not finite; the training diverged, or the file does not "
                    "belong to this cfg."
                )
            yield weights, bias
            start = end


def _values(path: Path, n_expected: int) -> npt.NDArray[np.float32]:
    with open_regular(path, ModelError, "Darknet weights") as file, readable(path, ModelError):
        n_bytes = os.fstat(file.fileno()).st_size
        version = np.frombuffer(file.read(_VERSION_BYTES).ljust(_VERSION_BYTES, b"\0"), "<i4").tolist()
        if not all(0 <= part <= _MAX_VERSION for part in version):
            raise ModelError(
                f"{path}: expected Darknet weights, whose first numbers are a version such as 0, 2, 5, got "
                f"{', '.join(map(str, version))}; download or copy the file again."
            )
        header_bytes = _VERSION_BYTES + (8 if version[0] * 10 + version[1] >= 2 else 4)
        if n_bytes < header_bytes:
            raise ModelError(
                f"{path}: expected Darknet weights with a header of {header_bytes} bytes, got {n_bytes} bytes."
            )
        n_values, rest_bytes = divmod(n_bytes - header_bytes, _BYTES_PER_VALUE)
        if n_values != n_expected or rest_bytes:
            rest = f" and {rest_bytes} bytes" if rest_bytes else ""
            raise ModelError(
                f"{path}: expected {n_expected:,} values for this cfg, got {n_values:,}{rest}; download or copy the "
                "file again, or specify the cfg that it was trained with."
            )
        file.seek(header_bytes)
        return np.frombuffer(file.read(n_values * _BYTES_PER_VALUE), "<f4")


def _folded(operation: Convolution, values: npt.NDArray[np.float64]) -> tuple[FloatArray32, FloatArray32]:
    n_filters = operation.n_filters
    columns, weights = np.split(values, [operation.n_values - operation.n_weights])
    bias, *norm = columns.reshape(-1, n_filters)
    shape = (n_filters, operation.n_channels // operation.groups, operation.size, operation.size)
    weights = weights.reshape(shape)
    if norm:
        scale, mean, variance = norm
        factor = scale / np.sqrt(variance + _EPSILON)
        weights, bias = weights * factor[:, None, None, None], bias - factor * mean
    return weights.astype(np.float32), bias.astype(np.float32)
