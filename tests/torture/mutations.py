"""Mutations of files: bytes, texts, tables, structured values, and the kind of the file itself.

A mutation of content is a function of the content and a random generator; one of the file kind
replaces the file.
"""

from __future__ import annotations

import copy
import io
import json
import os
import re
import socket
import struct
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import yaml

Mutation = Callable[[bytes, Random], bytes]

HOSTILE_TEXTS = (
    *(
        "",
        "nan",
        "inf",
        "-inf",
        "1e400",
        "-1",
        "0",
        "1e-300",
        "9,66",
        "0x10",
        "1_000",
        "1.2.3",
        "None",
        "null",
        "true",
    ),
    *(
        str(2**31),
        str(2**63),
        str(2**70),
        "9" * 5000,
        "99999999",
        "-0.0",
        "abc",
        "é",
        "\0",
        "\u202e",
        "٣",
    ),
    *(
        "x" * 100_000,
        "'",
        '"',
        "%s",
        "{}",
        "../../etc/passwd",
        "/dev/zero",
        "=1+1",
        "[red]",
        ":smile:",
        "NaN,NaN",
    ),
    *("1;2", "1 2", "\t"),
)
"""Texts that replace a number or a word."""

HOSTILE_YAML = (
    *(
        "!!int abc",
        "!!bool maybe",
        "!!float x",
        "!!python/object/apply:os.system [ls]",
        "!!binary ///",
        "!!set {a, b}",
    ),
    *(
        "2001-99-99",
        "2001-01-01",
        "1:60:99",
        "0o9",
        "~",
        "*missing",
        "&a [*a]",
        "? a",
        "{a: 1, a: 2}",
        "- -",
        "|",
    ),
    *(
        ">-",
        "!!timestamp x",
        "<<: 1",
        "{<<: 1}",
        ".nan",
        "-.inf",
        "1e400",
        "0b2",
        "[" * 3000,
        "{a: " * 3000,
    ),
    *("9" * 5000, "[" * 3000 + "]" * 3000),
)
"""Texts that replace a YAML value."""

_ALIAS_BOMB = "bomb0: &b0 [x, x, x, x, x, x, x, x, x]\n" + "\n".join(
    f"bomb{i}: &b{i} [{', '.join([f'*b{i - 1}'] * 9)}]" for i in range(1, 9)
)
"""Nine levels of nine aliases: 3 GiB when expanded."""

_HOSTILE_VALUES: tuple[Any, ...] = (
    *(
        None,
        True,
        [],
        {},
        "",
        "abc",
        "1",
        -1,
        0,
        0.5,
        1e-300,
        1e300,
        float("nan"),
        float("inf"),
        2**31,
        2**63,
        2**70,
    ),
    *(
        [None],
        [[]],
        {"a": None},
        ["x"] * 50,
        [1] * 100_000,
        "x" * 100_000,
        "\ud7ff",
        "../../etc/passwd",
        "/dev/zero",
    ),
)

_TOKEN = re.compile(rb"[^\s,:;=\[\]{}\"']+")
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][-+]?\d+)?")


def flip_bits(content: bytes, random: Random) -> bytes:
    changed = bytearray(content or b"\0")
    for _ in range(random.randint(1, 8)):
        changed[random.randrange(len(changed))] ^= 1 << random.randrange(8)
    return bytes(changed)


def cut_end(content: bytes, random: Random) -> bytes:
    return content[: random.randrange(len(content) + 1)]


def cut_part(content: bytes, random: Random) -> bytes:
    first, last = _span(content, random)
    return content[:first] + content[last:]


def double_part(content: bytes, random: Random) -> bytes:
    first, last = _span(content, random)
    return content[:last] + content[first:]


def double_all(content: bytes, _: Random) -> bytes:
    return content + content


def zero_part(content: bytes, random: Random) -> bytes:
    first, last = _span(content, random)
    return content[:first] + bytes(last - first) + content[last:]


def insert_bytes(content: bytes, random: Random) -> bytes:
    place = random.randrange(len(content) + 1)
    return content[:place] + random.randbytes(random.randint(1, 64)) + content[place:]


def other_bytes(content: bytes, random: Random) -> bytes:
    """Random bytes, or the start of another kind of file."""
    starts = (
        b"",
        b"PK\3\4",
        b"\x89PNG\r\n\x1a\n",
        b"\x93NUMPY\1\0",
        b"%YAML:1.0\n---\n",
        b"\x80\4\x95",
        b"<html>",
    )
    return random.choice(starts) + random.randbytes(random.randint(1, 4000))


def change_number(content: bytes, random: Random) -> bytes:
    return _replace(content, _NUMBER, random.choice(HOSTILE_TEXTS).encode(), random)


def change_word(content: bytes, random: Random) -> bytes:
    return _replace(content, _TOKEN, random.choice(HOSTILE_TEXTS).encode(), random)


def change_lines(content: bytes, random: Random) -> bytes:
    """Lines removed, doubled, exchanged or joined."""
    lines = content.splitlines(keepends=True) or [b""]
    i, j = random.randrange(len(lines)), random.randrange(len(lines))
    match random.randrange(5):
        case 0:
            del lines[i]
        case 1:
            lines.insert(j, lines[i])
        case 2:
            lines[i], lines[j] = lines[j], lines[i]
        case 3:
            lines[i] = lines[i].rstrip(b"\r\n")
        case _:
            lines[i] = b"  " + lines[i]
    return b"".join(lines)


def change_encoding(content: bytes, random: Random) -> bytes:
    """The text in another encoding, with other line ends, a byte order mark, or a character that is
    no UTF-8."""
    text = content.decode("utf-8", "replace")
    return random.choice(
        (
            text.encode("utf-16"),
            text.encode("utf-32"),
            b"\xef\xbb\xbf" + content,
            content.replace(b"\n", b"\r\n"),
            content.replace(b"\n", b"\r"),
            content.replace(b"\n", b""),
            content + b"\xe9\n",
            content.replace(b".", b","),
            b"\0" + content,
            content.upper(),
        )
    )


def long_line(content: bytes, random: Random) -> bytes:
    lines = content.splitlines(keepends=True)
    lines.insert(
        random.randrange(len(lines) + 1),
        random.choice((b"x", b"1,", b"[", b"- ", b" ")) * 200_000 + b"\n",
    )
    return b"".join(lines)


def change_field(content: bytes, random: Random) -> bytes:
    rows, separator = _table(content)
    row = random.choice(rows)
    row[random.randrange(len(row))] = random.choice(HOSTILE_TEXTS).encode()
    return _joined(rows, separator)


def change_column(content: bytes, random: Random) -> bytes:
    rows, separator = _table(content)
    column, value = random.randrange(len(rows[0])), random.choice(HOSTILE_TEXTS[:-10]).encode()
    for row in rows[1:]:
        row[min(column, len(row) - 1)] = value
    return _joined(rows, separator)


def change_fields(content: bytes, random: Random) -> bytes:
    """Fields added, removed or exchanged, in one row or in all."""
    rows, separator = _table(content)
    chosen = rows if random.random() < 0.3 else [random.choice(rows)]
    kind, i, j = random.randrange(5), random.randrange(len(rows[0])), random.randrange(len(rows[0]))
    for row in chosen:
        match kind:
            case 0:
                row += [b"1"] * random.choice((1, 3, 100))
            case 1:
                del row[min(i, len(row) - 1) :]
            case 2:
                row.insert(i, b"")
            case 3:
                row[:] = [row[min(j, len(row) - 1)], *row[1:]]
            case _:
                del row[min(i, len(row) - 1)]
    return _joined(rows, separator)


def decimal_commas(content: bytes, random: Random) -> bytes:
    """A comma instead of the decimal point, in one number or in all."""
    numbers = list(re.finditer(rb"(?<=\d)\.(?=\d)", content))
    if not numbers:
        return content + b",5"
    chosen = numbers if random.random() < 0.5 else [random.choice(numbers)]
    changed = bytearray(content)
    for number in chosen:
        changed[number.start()] = ord(",")
    return bytes(changed)


def change_yaml_text(content: bytes, random: Random) -> bytes:
    """A hostile YAML text instead of the value of a key, or in the first line."""
    value = random.choice(HOSTILE_YAML).encode()
    if random.random() < 0.2:
        return value + b"\n" + content
    return _replace(content, re.compile(rb"(?<=: ).+|(?<=- ).+"), value, random)


def add_alias_bomb(content: bytes, random: Random) -> bytes:
    """The content with nested aliases: all in separate keys, or as the value of one of its keys."""
    if random.random() < 0.5:
        return _ALIAS_BOMB.encode() + b"\n" + content
    return _replace(
        _ALIAS_BOMB.encode() + b"\n" + content, re.compile(rb"(?<=: )[\w.].*"), b"*b8", random
    )


def change_yaml_value(content: bytes, random: Random) -> bytes:
    """A hostile value instead of one in a YAML document, a key removed, or one added."""
    # OpenCV's first line is no YAML
    start = content.find(b"---\n") + 4 if content.startswith(b"%YAML") else 0
    value = _changed(_load_yaml(content[start:]), random)
    return content[:start] + yaml.safe_dump(value, sort_keys=False, allow_unicode=True).encode(
        "utf-8", "replace"
    )


def change_json_value(content: bytes, random: Random) -> bytes:
    """A hostile value instead of one in a JSON document, a key removed, or one added."""
    return json.dumps(_changed(json.loads(content), random)).encode()


def change_json_text(content: bytes, random: Random) -> bytes:
    """A hostile text instead of a JSON number or text."""
    texts = (
        *HOSTILE_TEXTS,
        "[" * 3000,
        '{"a":' * 3000,
        "NaN",
        "-Infinity",
        r'"\ud800"',
        "1e999",
        "{}",
        '"\t"',
    )
    pattern = re.compile(rb"(?<=: )[^\s,]+|\"[^\"]*\"|-?[\d.]+")
    return _replace(content, pattern, random.choice(texts).encode(), random)


def change_npy_header(content: bytes, random: Random) -> bytes:
    """A numpy file with another type, shape or order in its header."""
    header_bytes = struct.unpack_from("<H", content, 8)[0]
    descr = random.choice(
        ("<f8", "|O", "<U9999999", "<f4", "<i8", "<c16", "|V8", "<M8[s]", "[('a','<f4')]")
    )
    shape = random.choice(
        (
            "(3,)",
            "(-1, 4)",
            "(1099511627776, 138)",
            "(4294967296, 4294967296)",
            "()",
            "(0, 138)",
            "(2, 2, 2)",
            "(1,)",
        )
    )
    header = (
        f"{{'descr': '{descr}', 'fortran_order': {random.choice(('True', 'False', '1'))}, 'shape': "
        f"{shape}, }}"
    )
    encoded = header.encode().ljust(-(10 + len(header)) % 64 + len(header) - 1) + b"\n"
    return content[:8] + struct.pack("<H", len(encoded)) + encoded + content[10 + header_bytes :]


def change_png_size(content: bytes, random: Random) -> bytes:
    import zlib

    if not content.startswith(b"\x89PNG"):
        return flip_bits(content, random)
    sizes = [random.choice((0, 1, 16, 4096, 30_000, 65_536, 2**31 - 1)) for _ in range(2)]
    header = struct.pack(">II", *sizes) + content[24:29]
    return content[:16] + header + struct.pack(">I", zlib.crc32(b"IHDR" + header)) + content[33:]


def change_onnx(content: bytes, random: Random) -> bytes:
    """An ONNX model with another input, operator, output, version, metadata value or weight."""
    import onnx

    model = onnx.load(io.BytesIO(content))
    random.choice(
        (_change_onnx_input, _change_onnx_graph, _change_onnx_metadata, _change_onnx_weight)
    )(model, random)
    return bytes(model.SerializeToString())


def _change_onnx_input(model: Any, random: Random) -> None:
    kind = model.graph.input[0].type.tensor_type
    if random.random() < 0.2:
        kind.elem_type = random.choice((0, 2, 7, 8, 10, 11, 99))
    elif random.random() < 0.5:
        random.choice(kind.shape.dim).dim_value = random.choice((0, -1, 1, 7, 65_536, 2**31, 2**62))
    else:
        kind.shape.dim[2].dim_value = kind.shape.dim[3].dim_value = random.choice(
            (0, 1, 31, 8192, 65_536, 2**31)
        )


def _change_onnx_graph(model: Any, random: Random) -> None:
    match random.randrange(3):
        case 0:
            random.choice(model.graph.node).op_type = random.choice(
                ("Nothing", "", "Loop", "If", "Identity")
            )
        case 1:
            del model.graph.output[:]
        case _:
            model.opset_import[0].version = random.choice((0, -1, 1, 99, 2**31))


def _change_onnx_metadata(model: Any, random: Random) -> None:
    keys = ("names", "anchors", "letterbox", "size", "family", "divisor", "scale_x_y", "colours")
    values = (
        *HOSTILE_TEXTS,
        "{0: 'car'}",
        "[" * 3000,
        "__import__('os').getpid()",
        "[[1,2]]",
        "9" * 5000,
    )
    model.metadata_props.add(key=random.choice(keys), value=random.choice(values))


def _change_onnx_weight(model: Any, random: Random) -> None:
    """Change the size of a weight, or refer to a file outside the model."""
    import onnx

    weight = random.choice(model.graph.initializer)
    if random.random() < 0.5:
        weight.dims[:] = [random.choice((-1, 0, 2**31, 2**40)) for _ in weight.dims]
    else:
        weight.ClearField("raw_data")
        weight.data_location = onnx.TensorProto.EXTERNAL
        weight.external_data.add(
            key="location", value=random.choice(("/etc/passwd", "../x", "no.bin", "/dev/zero"))
        )


ANY = (flip_bits, cut_end, cut_part, double_part, insert_bytes, other_bytes)
BYTES = (*ANY, double_all, zero_part)
TEXT = (*ANY, *[change_number, change_word] * 2, change_lines, change_encoding, long_line)
TABLE = (*TEXT, *[change_field] * 3, *[change_column, change_fields] * 2, decimal_commas)
YAML = (*TEXT, *[change_yaml_text, change_yaml_value] * 3, add_alias_bomb)
JSON = (*TEXT, *[change_json_value] * 3, *[change_json_text] * 2)
ONNX = (*BYTES, *[change_onnx] * 12)
NPY = (*BYTES, *[change_npy_header] * 6)
PNG = (*BYTES, *[change_png_size] * 4)


def make_fifo(path: Path) -> None:
    os.mkfifo(path)


def make_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def make_link_loop(path: Path) -> None:
    path.symlink_to(path.name)


def make_folder(path: Path) -> None:
    path.mkdir()


def make_empty(path: Path) -> None:
    path.touch()


def make_dangling_link(path: Path) -> None:
    path.symlink_to("no-such-file")


def make_sparse(path: Path) -> None:
    """A file of 8 GB of zeros without blocks on the disk."""
    with path.open("wb") as file:
        file.truncate(8 << 30)


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as endpoint:
        descriptor = os.open(path.parent, os.O_RDONLY)
        try:
            # a socket's path is limited to 108 characters
            endpoint.bind(f"/proc/self/fd/{descriptor}/{path.name}")
        finally:
            os.close(descriptor)


def make_missing(path: Path) -> None:
    """No file."""


FILE_KINDS: tuple[Callable[[Path], None], ...] = (
    *(
        make_fifo,
        make_device,
        make_link_loop,
        make_folder,
        make_empty,
        make_dangling_link,
        make_sparse,
        make_socket,
    ),
    make_missing,
)
"""What is put in the place of a file."""


def _span(content: bytes, random: Random) -> tuple[int, int]:
    """First and last byte of a part, usually a short one."""
    first = random.randrange(len(content) + 1)
    n_bytes = int(len(content) ** random.random())
    return first, min(first + n_bytes, len(content))


def _replace(content: bytes, pattern: re.Pattern[bytes], value: bytes, random: Random) -> bytes:
    places = list(pattern.finditer(content))
    if not places:
        return content + value
    place = random.choice(places)
    return content[: place.start()] + value + content[place.end() :]


def _table(content: bytes) -> tuple[list[list[bytes]], bytes]:
    lines = content.splitlines() or [b"1"]
    separator = b"," if b"," in lines[0] else b" "
    return [line.split(separator) for line in lines], separator


def _joined(rows: list[list[bytes]], separator: bytes) -> bytes:
    return b"\n".join(separator.join(row) for row in rows) + b"\n"


def _load_yaml(content: bytes) -> Any:
    plain = re.sub(rb"!!opencv-matrix", b"", content)
    return yaml.safe_load(plain)


def _changed(document: Any, random: Random) -> Any:
    """A copy of a document with one hostile change."""
    document = copy.deepcopy(document)
    holder: Any = random.choice(
        [part for part in _parts(document) if isinstance(part, dict | list) and part]
    )
    key = random.choice(list(holder)) if isinstance(holder, dict) else random.randrange(len(holder))
    change = random.random()
    if change < 0.15:
        del holder[key]
    elif change > 0.3:
        holder[key] = copy.deepcopy(random.choice(_HOSTILE_VALUES))
    elif isinstance(holder, dict):
        holder[random.choice(("", "x", key, 1, None))] = copy.deepcopy(
            random.choice(_HOSTILE_VALUES)
        )
    else:
        holder.append(copy.deepcopy(holder[key]))
    return document


def _parts(document: Any) -> list[Any]:
    children = (
        document.values()
        if isinstance(document, dict)
        else document
        if isinstance(document, list)
        else ()
    )
    return [document, *(part for child in children for part in _parts(child))]
