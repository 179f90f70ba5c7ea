from __future__ import annotations

import platform
import weakref

import pytest

from track_range.fleet.engine.worker import resident_bytes, return_free_memory


class Frame:
    """An object that refers to itself, as PyAV's frames do."""

    def __init__(self) -> None:
        self.owner = self


BLOCK_BYTES, N_BLOCKS = 4096, 20_000


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc returns memory on request")
def test_free_memory_is_returned() -> None:
    blocks = [b"x" * BLOCK_BYTES for _ in range(N_BLOCKS)]
    last = blocks.pop()  # in use at the top of the heap, which then cannot shrink
    del blocks
    before = resident_bytes()
    return_free_memory()
    assert before - resident_bytes() > BLOCK_BYTES * N_BLOCKS / 2
    assert len(last) == BLOCK_BYTES


def test_objects_that_refer_to_themselves_are_freed() -> None:
    frame = Frame()
    reference = weakref.ref(frame)
    del frame
    return_free_memory()
    assert reference() is None
