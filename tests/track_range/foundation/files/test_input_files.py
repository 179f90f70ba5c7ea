"""Reading of regular files: what is refused before it is read, encodings, and lengths of values in
messages."""

import os
import socket
from pathlib import Path

import pytest

from track_range.foundation.files import input_files
from track_range.foundation.files.input_files import (
    check_regular,
    first_line,
    printable,
    quoted,
    read_bytes,
    read_text,
    real_path,
    shortened,
)


class FileError(Exception):
    """Error class passed to the readers in these tests."""


def fifo(path):
    os.mkfifo(path)


def loop(path):
    path.symlink_to(path.name)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (fifo, "named pipe"),
        (loop, "loop"),
        (lambda path: path.mkdir(), "folder"),
        (lambda path: path.symlink_to("/dev/zero"), "device"),
        (lambda path: None, "no such file"),
        (lambda path: path.write_bytes(b"123456"), "at most 5 bytes"),
    ],
)
def test_what_is_not_a_small_regular_file(tmp_path, make, word):
    path = tmp_path / "in.txt"
    make(path)
    for read in (check_regular, read_bytes, read_text):
        with pytest.raises(FileError, match=rf"in\.txt: .*{word}") as error:
            read(path, FileError, "rows", max_bytes=5)
        assert len(str(error.value).replace(str(path), "")) < 200


def test_links_are_followed(tmp_path):
    (tmp_path / "file").write_text("text")
    (tmp_path / "link").symlink_to("file")
    assert read_text(tmp_path / "link", FileError, "rows") == "text"


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("a,b\n".encode("utf-16"), "UTF-8, found UTF-16"),
        ("a,b\n".encode("utf-16-le"), "line 1: .*null"),
        (b"a\nb\n\xff", "line 3: .*encoding"),
        (b"a\n\0", "line 2: .*null"),
        (b"PK\x03\x04\x14\0", "ZIP archive; unpack"),
        (b"\x1f\x8b\x08\0", "gzip"),
    ],
)
def test_other_encodings(tmp_path, content, word):
    path = tmp_path / "in.txt"
    path.write_bytes(content)
    for read in (first_line, read_text):
        with pytest.raises(FileError, match=rf"in\.txt.*{word}"):
            read(path, FileError, "rows")


def test_a_huge_binary_file_is_not_read(tmp_path):
    path = tmp_path / "zeros"
    with path.open("wb") as file:
        file.truncate(10**12)  # a sparse file: no memory of this size exists
    with pytest.raises(FileError, match="null"):
        read_text(path, FileError, "rows", max_bytes=2 * 10**12)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_ends_and_byte_order_mark(tmp_path, end):
    path = tmp_path / "in.txt"
    path.write_bytes(f"\ufeff{end}  {end}ä{end}b".encode())
    assert read_text(path, FileError, "rows") == "\n  \nä\nb"
    assert first_line(path, FileError, "rows") == "ä"


def test_first_line_of_a_long_file(tmp_path):
    path = tmp_path / "in.txt"
    # the limit of 65536 bytes cuts a character in two
    path.write_bytes(b"x" + "ä".encode() * 50_000)
    assert first_line(path, FileError, "rows") == "x" + "ä" * 32_767
    path.write_bytes(b"")
    assert first_line(path, FileError, "rows") == ""


def test_values_in_messages_are_short_and_printable():
    assert quoted("a\nb") == r"'a\nb'"
    assert len(quoted("x" * 100)) == len(quoted(["x"] * 100)) == 60
    assert shortened("a\x07b") == "a?b"
    assert shortened("x" * 61) == "x" * 57 + "..."


def test_names_that_no_file_can_have(tmp_path):
    with pytest.raises(FileError, match="an invalid file name"):
        read_text(tmp_path / "a\0b", FileError, "rows")
    with pytest.raises(FileError, match="long"):
        read_text(tmp_path / ("x" * 300), FileError, "rows")


def test_socket(tmp_path):
    path = Path(os.path.relpath(tmp_path / "s"))  # names of sockets have at most 108 characters
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        with pytest.raises(FileError, match="socket"):
            read_text(path, FileError, "rows")


@pytest.mark.skipif(not os.path.exists("/proc/self/stat"), reason="no /proc")
def test_size_limit_of_file_without_size():
    with pytest.raises(FileError, match="at most 5"):
        read_bytes(Path("/proc/self/stat"), FileError, "rows", max_bytes=5)


def test_file_without_data_at_present(tmp_path):
    """Reading of some files in /proc waits for data; so does that of a pipe."""
    os.mkfifo(tmp_path / "pipe")
    reader = os.fdopen(os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK), "rb")
    writer = os.open(tmp_path / "pipe", os.O_WRONLY)
    with reader, pytest.raises(BlockingIOError):
        input_files._read(reader, 10)
    os.close(writer)


def test_real_path_of_a_loop(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "link").symlink_to(tmp_path)
    assert real_path(tmp_path / "link" / "a") == tmp_path.resolve() / "a"
    assert real_path(tmp_path / "loop").name == "loop"


def test_printable():
    assert printable("a\nb\x1b[31m:\u00fc") == "a?b?[31m:\u00fc"
