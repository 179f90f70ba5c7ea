"""A disk that becomes full."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

resource = pytest.importorskip("resource", reason="file size limits need POSIX")


@contextmanager
def file_size_limit(n_bytes: int) -> Iterator[None]:
    """Context in which writing beyond this size of a file fails (EFBIG), after a short write up to
    it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
