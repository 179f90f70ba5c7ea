"""Darknet's weights file: a header, then the float32 numbers of every convolution in the cfg's order.

    int32 major, minor, revision; how many images were seen: uint64 from version 0.2 on, uint32 before
    per convolution: bias[F], with batch norm also scale[F], mean[F], variance[F], then weights[F, C / groups, k, k]

All little-endian. Batch norm becomes part of the convolution, in float64:

    a = scale / sqrt(variance + 0.00001)        weights' = a weights        bias' = bias - a mean

as in AlexeyAB's `fuse_conv_batchnorm` (network.c), with whose program YOLOv4 was trained. Redmon's first program has
sqrt(variance) + 0.000001, and OpenCV sqrt(variance + 0.000001): only channels that hardly vary can tell.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.darknet.layers import Convolution, Network
from track_range.detection.models.onnx_session import ModelError
from track_range.foundation.arrays import FloatArray32

_EPSILON = 0.00001
_VERSION_BYTES = 12
_BYTES_PER_VALUE = 4


def read_convolutions(path: Path, network: Network) -> Iterator[tuple[FloatArray32, FloatArray32]]:
    """Weights (F, C / groups, k, k) and bias (F,) of each convolution of `network`, batch norm folded in.

    Raises:
        ModelError: the file cannot be read, or holds more or fewer numbers than the network wants, or some that are
            not finite.
    """
    values = _values(path, network.n_values)
    start = 0
    for index, layer in enumerate(network.layers):
        if isinstance(layer.operation, Convolution):
            end = start + layer.operation.n_values
            with np.errstate(all="ignore"):  # what overflows is told below
                weights, bias = _folded(layer.operation, values[start:end].astype(np.float64))
            if not (np.isfinite(weights).all() and np.isfinite(bias).all()):
                raise ModelError(
                    f"{path}: the weights of layer {index} are not finite; the training went astray, or the file is "
                    "not of this cfg."
                )
            yield weights, bias
            start = end


def _values(path: Path, n_wanted: int) -> npt.NDArray[np.float32]:
    """All numbers after the header, which must be as many as wanted."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read ({error.strerror}).") from error
    version = np.frombuffer(content[:_VERSION_BYTES].ljust(_VERSION_BYTES, b"\0"), "<i4")
    header_bytes = _VERSION_BYTES + (8 if version[0] * 10 + version[1] >= 2 else 4)
    n_found, rest_bytes = divmod(len(content) - header_bytes, _BYTES_PER_VALUE)
    if len(content) < header_bytes:
        raise ModelError(f"{path}: {len(content)} bytes are no Darknet weights; the header alone has {header_bytes}.")
    if n_found != n_wanted or rest_bytes:
        rest = f" and {rest_bytes} bytes" if rest_bytes else ""
        fault = "too short" if n_found < n_wanted else "too long"
        raise ModelError(
            f"{path}: {fault}: the cfg wants {n_wanted:,} numbers, the file holds {n_found:,}{rest}; download or copy "
            "it again, or give the cfg that it was trained with."
        )
    return np.frombuffer(content, "<f4", offset=header_bytes)


def _folded(operation: Convolution, values: npt.NDArray[np.float64]) -> tuple[FloatArray32, FloatArray32]:
    """Weights and bias of one convolution from its part of the file."""
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
