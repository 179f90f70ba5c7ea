"""Slow readers of a live page: `python -m benchmarks.speed.slow_readers PORT N` until it is ended.

Each of N connections requests the stream and reads 1 kB per second; a refused or closed one is opened again a second
later.
"""

from __future__ import annotations

import socket
import sys
import time

REQUEST = b"GET /stream.mjpg HTTP/1.1\r\nHost: localhost\r\n\r\n"


def read_slowly(port: int, n_readers: int) -> None:
    """Read streams of the page at this port forever."""
    readers: list[socket.socket | None] = [None] * n_readers
    while True:
        for k in range(n_readers):
            readers[k] = _opened(port) if (reader := readers[k]) is None else _read(reader)
            time.sleep(1.0 / n_readers)


def _read(reader: socket.socket) -> socket.socket | None:
    """Read from a connection; None = closed, to be opened the next time."""
    try:
        if reader.recv(1000):
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
    try:
        reader.connect(("127.0.0.1", port))
        reader.setblocking(False)
        reader.sendall(REQUEST)
    except OSError:
        reader.close()
        return None
    return reader


if __name__ == "__main__":
    read_slowly(int(sys.argv[1]), int(sys.argv[2]))
