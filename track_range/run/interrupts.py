"""Ctrl-C and SIGTERM while files are being written.

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
    """While inside, the first Ctrl-C or SIGTERM raises KeyboardInterrupt; later ones are ignored.

    The first one lets threads, videos and the summary end in order, which a second one would cut short.
    """
    handled = _signals_heeded()

    def stop(number: int, at: FrameType | None) -> None:
        for signal_number in handled:
            signal.signal(signal_number, signal.SIG_IGN)
        raise KeyboardInterrupt

    with _handled_signals(handled, stop):
        yield


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """While inside, Ctrl-C and SIGTERM wait, so that what belongs together is finished.

    Raises:
        KeyboardInterrupt: at the end of the block, if there was one.
    """
    received: list[int] = []
    with _handled_signals(_signals_heeded(), lambda number, at: received.append(number)):
        yield
    if received:
        handler = signal.getsignal(received[0])
        if callable(handler):
            handler(received[0], None)  # `stop_on_interrupt` then ignores later ones
        raise KeyboardInterrupt


def ignore_interrupts() -> AbstractContextManager[None]:
    """While inside, Ctrl-C and SIGTERM are ignored."""
    return _handled_signals((signal.SIGINT, signal.SIGTERM), signal.SIG_IGN)


def _signals_heeded() -> list[signal.Signals]:
    """SIGINT and SIGTERM, as far as they are not ignored already, as in the background of a shell or under nohup."""
    return [number for number in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(number) != signal.SIG_IGN]


@contextmanager
def _handled_signals(numbers: Iterable[signal.Signals], handler: _Handler) -> Iterator[None]:
    """While inside, these signals have this handler; afterwards the previous one."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in previous.items():
            signal.signal(number, earlier)
