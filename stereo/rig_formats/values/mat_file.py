"""MATLAB's .mat files of version 5 to 7: numbers, texts, structs, cells and the structs of saved objects.

    header of 128 bytes, then elements: (type, size in bytes, content); matrices are elements of elements
    matrix = flags with its class, dimensions, name, content by class; a compressed element is one in zlib's format

Objects such as `stereoParameters` are saved as structs in a nested file, the last element (MAT-File Format, MathWorks,
2023; the nested file is undocumented). Sizes are checked before memory is allocated: the content of a compressed
element and the depth are limited, and no array is larger than the bytes of the file.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

MARK = b"MATLAB 5.0 MAT-file"  # begin of the header
_MAX_BYTES = 64_000_000  # of all elements after decompression
_MAX_DEPTH = 16  # of nested structs and cells
_MAX_VALUES = 20_000  # fields and cells of a file
_TYPES = {  # of numbers
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8", 16: "u1", 17: "u2",
}  # fmt: skip
_MATRIX, _COMPRESSED = 14, 15  # types of elements
_CELL, _STRUCT, _OBJECT, _TEXT, _SPARSE, _OPAQUE = 1, 2, 3, 4, 5, 17  # classes of matrices


class MatFile:
    """Content of a .mat file; raises ValueError and struct.error for damaged content."""

    def __init__(self, content: bytes) -> None:
        self._order = "<" if content[126:128] == b"IM" else ">"
        self._n_bytes = self._n_values = 0
        # variables by name: arrays, texts, lists of cells, dicts of structs
        self.values: dict[str, Any] = {}
        # structs of saved objects, in the order of the objects
        self.objects: list[dict[str, Any]] = []
        for kind, element in self._elements(content[128:]):
            if kind == _COMPRESSED:
                (_, element), *_ = self._elements(self._decompressed(element))
            name, value = self._matrix(element, 0)
            if name:
                self.values[name] = value
            elif isinstance(value, np.ndarray) and value.dtype == np.uint8:  # the nested file
                for _, nested in self._elements(value.tobytes("F")[8:]):
                    self._find_structs(self._matrix(nested, 0)[1])

    def _decompressed(self, element: bytes) -> bytes:
        stream = zlib.decompressobj()
        content = stream.decompress(element, _MAX_BYTES - self._n_bytes + 1)
        self._n_bytes += len(content)
        if self._n_bytes > _MAX_BYTES:
            raise ValueError(f"more than {_MAX_BYTES // 1_000_000} MB after decompression")
        return content

    def _elements(self, content: bytes) -> Iterator[tuple[int, bytes]]:
        """(type, content) of each element."""
        place = 0
        while place + 8 <= len(content):
            kind, size = struct.unpack_from(self._order + "II", content, place)
            self._n_values += 1
            if self._n_values > _MAX_VALUES:
                raise ValueError(f"more than {_MAX_VALUES} values")
            if kind >> 16:  # at most 4 bytes, which follow in the place of the size
                yield kind & 0xFFFF, content[place + 4 : place + 4 + min(kind >> 16, 4)]
                place += 8
                continue
            if size > len(content) - place - 8:
                raise ValueError("an element that is longer than the file")
            yield kind, content[place + 8 : place + 8 + size]
            place += 8 + size + (0 if kind == _COMPRESSED else -size % 8)

    def _matrix(self, content: bytes, depth: int) -> tuple[str, Any]:
        """Name and value of a matrix; "" and None for an empty matrix."""
        if depth > _MAX_DEPTH:
            raise ValueError(f"more than {_MAX_DEPTH} nested values")
        if not content:
            return "", None
        elements = list(self._elements(content))
        kind = struct.unpack(self._order + "I", elements[0][1][:4])[0] & 0xFF
        if kind == _OPAQUE:
            inner = [
                self._matrix(element, depth + 1)[1]
                for type_, element in elements[1:]
                if type_ == _MATRIX
            ]
            return elements[1][1].decode("latin1"), inner[0] if inner else None
        shape = np.frombuffer(elements[1][1], self._order + "i4")
        name = elements[2][1].decode("latin1")
        rest = elements[3:]
        if kind == _CELL:
            return name, [self._matrix(element, depth + 1)[1] for _, element in rest]
        if kind in (_STRUCT, _OBJECT):
            return name, self._struct(rest[1:] if kind == _OBJECT else rest, depth)
        if kind == _SPARSE or not rest or rest[0][0] not in _TYPES:
            return name, None
        number_type, stored = rest[0]
        numbers = np.frombuffer(stored, self._order + _TYPES[number_type])
        if kind == _TEXT:
            return name, "".join(map(chr, numbers[:200].tolist()))
        is_complete = numbers.size == math.prod(shape.tolist())
        return name, numbers.reshape(shape[::-1]).T if is_complete else numbers

    def _struct(self, elements: list[tuple[int, bytes]], depth: int) -> Any:
        """The fields of a struct by name; a list of such mappings for an array of structs."""
        length = max(struct.unpack(self._order + "i", elements[0][1][:4])[0], 1)
        names = [
            elements[1][1][i : i + length].split(b"\0")[0].decode("latin1")
            for i in range(0, len(elements[1][1]), length)
        ]
        values = [self._matrix(element, depth + 1)[1] for _, element in elements[2:]]
        structs = [
            dict(zip(names, values[i:], strict=False))
            for i in range(0, len(values), max(len(names), 1))
        ]
        return structs[0] if len(structs) == 1 else structs

    def _find_structs(self, value: object) -> None:
        """Collect the structs with numbers of cameras and pairs."""
        if isinstance(value, list):
            parts = value
        elif isinstance(value, dict):
            if "RadialDistortion" in value or "RotationOfCamera2" in value:
                self.objects.append(value)
                return
            parts = list(value.values())
        else:
            return
        for part in parts:
            self._find_structs(part)
