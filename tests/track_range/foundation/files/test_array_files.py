"""Reading of .npy files: only arrays of numbers of the announced size, and without allocating the
announced memory."""

import contextlib
import io
import pickle
import tracemalloc
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.foundation.files.array_files import read_array


class ArrayError(Exception):
    """Error class passed to the reader in these tests."""


def npy(array):
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def header(text, version=1):
    body = text.encode().ljust(117) + b"\n"
    return (
        b"\x93NUMPY"
        + bytes([version, 0])
        + len(body).to_bytes(2 if version == 1 else 4, "little")
        + body
    )


def zipped():
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("a.npy", npy(np.zeros(3)))
    return stream.getvalue()


def test_arrays_of_numbers(tmp_path):
    for array in (
        np.arange(6.0).reshape(2, 3),
        np.arange(3, dtype=np.int16),
        np.zeros((0, 4), np.float32),
    ):
        (tmp_path / "a.npy").write_bytes(npy(array))
        np.testing.assert_array_equal(read_array(tmp_path / "a.npy", ArrayError, "numbers"), array)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "magic"),
        (zipped(), "magic"),
        (pickle.dumps([1.0]), "magic"),
        (npy(np.zeros(3)) + b"0", "24 bytes, found 25"),
        (npy(np.zeros(3))[:-1], "24 bytes, found 23"),
        (npy(np.array(["a"])), "type"),
        (npy(np.zeros(2, [("a", "f8")])), "type"),
        (
            header("{'descr': '|O', 'fortran_order': False, 'shape': (1,)}") + pickle.dumps([1]),
            "type",
        ),
        (header("{'descr': '<f8', 'fortran_order': False, 'shape': (2**40,)}"), "error"),
        (
            header("{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776,)}"),
            "8796093022208 bytes, found 0",
        ),
        (
            header("{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000, 10000000000)}"),
            "8" + 20 * "0" + " bytes",
        ),
        (
            header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, -3)}"),
            "24 bytes, found 0",
        ),
        (header("{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}", version=9), "version"),
        (header("[" * 110), "error"),
    ],
)
def test_other_files(tmp_path, content, word):
    path = tmp_path / "a.npy"
    path.write_bytes(content)
    with pytest.raises(ArrayError, match=rf"a\.npy: .*{word}") as error:
        read_array(path, ArrayError, "numbers")
    assert len(str(error.value).replace(str(path), "")) <= 300


def test_announced_memory_is_not_allocated(tmp_path):
    path = tmp_path / "a.npy"
    path.write_bytes(
        header("{'descr': '<f8', 'fortran_order': False, 'shape': (100000000,)}") + bytes(8)
    )
    tracemalloc.start()
    try:
        with pytest.raises(ArrayError, match="800000000 bytes, found 8"):
            read_array(path, ArrayError, "numbers")
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_negative_lengths_of_the_right_size(tmp_path):
    path = tmp_path / "a.npy"
    path.write_bytes(
        header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, -3)}") + bytes(24)
    )
    with pytest.raises(ArrayError, match="error"):
        read_array(path, ArrayError, "numbers")


@settings(deadline=None, max_examples=30)
@given(position=st.integers(0, 127), value=st.integers(0, 255))
def test_damaged_headers(tmp_path_factory, position, value):
    path = tmp_path_factory.getbasetemp() / "damaged.npy"
    content = bytearray(npy(np.arange(6.0)))
    content[position] = value
    path.write_bytes(content)
    with contextlib.suppress(ArrayError):  # any other exception fails
        assert read_array(path, ArrayError, "numbers").size == 6
