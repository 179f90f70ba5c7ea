"""Reader of NumPy's .npy files; the header is checked before memory is allocated, and pickles are never loaded."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from track_range.foundation.files.input_files import open_regular, quoted, shortened

MAX_ARRAY_BYTES = 4_000_000_000
"""Size limit, bytes, of arrays: 2 million embeddings of 512 numbers."""

_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
"""Readers of the header by format version; version 3 is for structured arrays only."""


def read_array(path: Path, error: type[Exception], expected: str) -> npt.NDArray[Any]:
    """The array of numbers in a .npy file.

    Args:
        path: the file.
        error: class of the exceptions to raise.
        expected: noun phrase for the content, for messages.

    Raises:
        error: the file cannot be read, is another format (a zip, a pickle), or does not have as many numbers as its
            header announces.
    """
    with open_regular(path, error, expected, max_bytes=MAX_ARRAY_BYTES) as file:
        try:
            shape, dtype = _header(file)
            n_announced = math.prod(shape) * dtype.itemsize
            n_bytes = os.fstat(file.fileno()).st_size - file.seek(0, os.SEEK_CUR)
            if n_announced != n_bytes:
                raise ValueError(f"the header announces {_count(n_announced)} bytes, found {n_bytes}")
            file.seek(0)
            return np.lib.format.read_array(file, allow_pickle=False)
        except Exception as reason:  # the parser of the header raises a dozen unrelated types
            problem = shortened(str(reason).partition("\n")[0], 120)
            raise error(
                f"{path}: expected {expected} as an array of numbers (.npy), found an error: {problem}."
            ) from reason


def _header(file: BinaryIO) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of the array in a .npy file.

    Raises:
        ValueError: it is not an array of integers or floats; the parser raises other exceptions, too.
    """
    if file.read(6) != b"\x93NUMPY":
        raise ValueError("the file does not start as a .npy file")
    file.seek(0)
    version = np.lib.format.read_magic(file)
    if version not in _HEADER_READERS:
        raise ValueError(f"format version {version[0]}.{version[1]}")
    shape, _, dtype = _HEADER_READERS[version](file)
    if dtype.kind not in "iuf" or dtype.subdtype is not None:
        raise ValueError(f"values of the type {quoted(str(dtype), 40)}")
    if any(not isinstance(length, int) or length < 0 for length in shape):
        raise ValueError("a negative length")
    return shape, dtype


def _count(n: int) -> str:
    return str(n) if n < 10**15 else "over 10^15"
