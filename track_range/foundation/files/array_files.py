"""Reader of NumPy's .npy files; sizes are checked before memory is allocated, and pickles are never
loaded.
"""

import math
import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from track_range.foundation.files.input_files import open_regular, quoted, shortened

MAX_ARRAY_BYTES = 4_000_000_000  # size limit, bytes, of arrays: 2 million embeddings of 512 numbers
_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_array(path: Path, error: type[Exception], expected: str) -> npt.NDArray[Any]:
    """The array of numbers in a .npy file.

    Raises `error` if the file cannot be read, is another format (a zip, a pickle), or does not have
    as many numbers as its header announces; `expected` is the noun phrase for its content in the
    message.
    """
    with open_regular(path, error, expected, max_bytes=MAX_ARRAY_BYTES) as file:
        try:
            return parse_array(file, os.fstat(file.fileno()).st_size)
        except Exception as reason:  # the parser of the header raises a dozen unrelated types
            problem = shortened(str(reason).partition("\n")[0], 120)
            raise error(
                f"{path}: expected {expected} as an array of numbers (.npy), found an error: "
                f"{problem}."
            ) from reason


def parse_array(file: BinaryIO, size_bytes: int) -> npt.NDArray[Any]:
    """The array of numbers in a .npy file of `size_bytes`; raises ValueError and other exceptions
    for invalid files.
    """
    version = np.lib.format.read_magic(file)
    if version not in _HEADER_READERS:  # version 3 is for structured arrays only
        raise ValueError(f"format version {version[0]}.{version[1]}")
    shape, _, dtype = _HEADER_READERS[version](file)
    if dtype.kind not in "iuf":
        raise ValueError(f"values of the type {quoted(str(dtype), 40)}")
    n_announced, n_bytes = math.prod(shape) * dtype.itemsize, size_bytes - file.seek(0, 1)
    if n_announced != n_bytes:
        raise ValueError(f"the header announces {n_announced} bytes, found {n_bytes}")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)
