"""Reader of NumPy's .npy files; pickles are never loaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.foundation.files.input_files import open_regular, quoted, shortened

MAX_ARRAY_BYTES = 4_000_000_000  # size limit, bytes, of arrays: 2 million embeddings of 512 numbers


def read_array(path: Path, error: type[Exception], expected: str) -> npt.NDArray[Any]:
    """The array of numbers in a .npy file.

    Raises `error` if the file cannot be read, is another format (a zip, a pickle), or does not have as many numbers as
    its header announces; `expected` is the noun phrase for its content in the message.
    """
    with open_regular(path, error, expected, max_bytes=MAX_ARRAY_BYTES) as file:
        try:
            array = np.lib.format.read_array(file, allow_pickle=False)
            if array.dtype.kind not in "iuf":
                raise ValueError(f"values of the type {quoted(str(array.dtype), 40)}")
            if file.read(1):
                raise ValueError(f"more than the {array.nbytes} bytes that the header announces")
            return array
        except Exception as reason:  # the parser of the header raises a dozen unrelated types
            problem = shortened(str(reason).partition("\n")[0], 120)
            raise error(
                f"{path}: expected {expected} as an array of numbers (.npy), found an error: {problem}."
            ) from reason
