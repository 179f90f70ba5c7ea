"""Tests of atomic file writing."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from track_range.foundation.files.atomic_files import (
    atomic_folder,
    atomic_path,
    write_bytes,
    write_text,
)


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_write_text_leaves_no_temporary_file(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "one")
    write_text(tmp_path / "a.txt", "two\r\n")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a.txt": b"two\r\n"}


def test_atomic_path_replaces_the_file_at_the_end(tmp_path: Path) -> None:
    file = tmp_path / "a.onnx"
    file.write_text("old")
    with atomic_path(file) as partial:
        assert (partial.parent, partial.suffix) == (tmp_path, ".onnx")
        partial.write_text("new")
        assert file.read_text() == "old"
    assert contents(tmp_path) == {"a.onnx": "new"}


def test_atomic_path_after_an_error(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "old")
    writing = atomic_path(tmp_path / "a.txt")
    writing.__enter__().write_text("half")
    writing.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert contents(tmp_path) == {"a.txt": "old"}


def test_atomic_path_without_a_written_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), atomic_path(tmp_path / "a.txt"):
        pass


def test_atomic_folder_moves_one_file(tmp_path: Path) -> None:
    with atomic_folder(tmp_path / "a.onnx") as folder:
        (folder / "prepared.onnx").write_text("intermediate")
        (folder / "a.onnx").write_text("result")
    assert contents(tmp_path) == {"a.onnx": "result"}


def test_atomic_folder_after_an_error(tmp_path: Path) -> None:
    writing = atomic_folder(tmp_path / "a.onnx")
    (writing.__enter__() / "a.onnx").write_text("half")
    writing.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert contents(tmp_path) == {}


def test_pipe_is_written_in_place(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with os.fdopen(os.open(pipe, os.O_RDONLY | os.O_NONBLOCK), "rb") as reader:
        write_bytes(pipe, b"words")
        assert reader.read() == b"words"
    assert pipe.is_fifo()


def test_symbolic_link_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    write_text(tmp_path / "link", "words")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "words"


def test_folder_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        write_text(tmp_path / "folder", "words")
    assert list(tmp_path.iterdir()) == [tmp_path / "folder"]


def test_pipe_without_reader(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="pipe"):
        write_bytes(tmp_path / "pipe", b"words")
