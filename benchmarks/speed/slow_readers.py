"""Slow readers of a live page: `python -m benchmarks.speed.slow_readers PORT N` until it is ended.

Each of N connections requests the stream and reads 1 kB per second; a refused or closed one is opened again a second
later.
"""

from __future__ import annotations

import socket
import sys
import time
from contextlib import suppress

_INTERVAL_S = 1.0
"""Seconds between reads of each connection."""

_N_BYTES = 1000
"""Bytes of one read."""

_REQUEST = b"GET /stream.mjpg HTTP/1.1\r\nHost: localhost\r\n\r\n"


def read_slowly(port: int, n_readers: int) -> None:
    """Read streams of the page at this port forever."""
    readers: list[socket.socket | None] = [None] * n_readers
    while True:
        for k in range(n_readers):
            readers[k] = _read(readers[k], port)
            time.sleep(_INTERVAL_S / n_readers)


def _read(reader: socket.socket | None, port: int) -> socket.socket | None:
    """Read from a connection, or open it; None = closed, to be opened the next time."""
    if reader is None:
        return _opened(port)
    try:
        if reader.recv(_N_BYTES):
            return reader
    except BlockingIOError:
        return reader
    except OSError:
        pass
    reader.close()
    return None


def _opened(port: int) -> socket.socket | None:
    reader = socket.socket()
    reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    with suppress(OSError):
        reader.connect(("127.0.0.1", port))
        reader.setblocking(False)
        reader.sendall(_REQUEST)
        return reader
    reader.close()
    return None


if __name__ == "__main__":
    read_slowly(int(sys.argv[1]), int(sys.argv[2]))
