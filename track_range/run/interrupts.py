"""Handling of Ctrl-C and SIGTERM while files are being written.

with stop_on_interrupt():               the first signal raises KeyboardInterrupt, later ones are ignored
    for frame in frames:
        with defer_interrupts():        a signal waits for the end of the block
            write rows, pictures, counts
    with ignore_interrupts():           write the summary

Python runs signal handlers in the main thread only; in other threads these blocks do nothing.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType

_Handler = Callable[[int, FrameType | None], None] | signal.Handlers


@contextmanager
def stop_on_interrupt() -> Iterator[None]:
    """Context in which the first Ctrl-C or SIGTERM raises KeyboardInterrupt; later ones are
    ignored.
    """
    handled = _active_signals()

    def stop(number: int, at: FrameType | None) -> None:
        for signal_number in handled:
            signal.signal(signal_number, signal.SIG_IGN)
        raise KeyboardInterrupt

    with _handled_signals(handled, stop):
        yield


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Context in which Ctrl-C and SIGTERM are deferred: they raise KeyboardInterrupt at the end of
    the block.
    """
    received: list[int] = []
    with _handled_signals(_active_signals(), lambda number, at: received.append(number)):
        yield
    if received:
        handler = signal.getsignal(received[0])
        if callable(handler):
            handler(received[0], None)  # `stop_on_interrupt` then ignores later ones
        raise KeyboardInterrupt


def ignore_interrupts() -> AbstractContextManager[None]:
    """Context in which Ctrl-C and SIGTERM are ignored."""
    return _handled_signals((signal.SIGINT, signal.SIGTERM), signal.SIG_IGN)


def _active_signals() -> list[signal.Signals]:
    """SIGINT and SIGTERM, without signals that are already ignored (background job of a shell,
    nohup).
    """
    return [
        number
        for number in (signal.SIGINT, signal.SIGTERM)
        if signal.getsignal(number) != signal.SIG_IGN
    ]


@contextmanager
def _handled_signals(numbers: Iterable[signal.Signals], handler: _Handler) -> Iterator[None]:
    """Context in which `handler` handles the signals; their previous handlers are restored
    afterwards.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, previous_handler in previous.items():
            signal.signal(number, previous_handler)
