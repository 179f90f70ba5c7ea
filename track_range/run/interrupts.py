"""Ctrl-C and polite kills while a run has something to lose."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType

_BOTH = (signal.SIGINT, signal.SIGTERM)

_Handler = Callable[[int, FrameType | None], None] | signal.Handlers


@contextmanager
def termination_as_interrupt() -> Iterator[None]:
    """While inside, a polite kill (SIGTERM) ends the run as Ctrl-C does: files are closed first."""

    def interrupt(number: int, at: FrameType | None) -> None:
        raise KeyboardInterrupt

    with _handled((signal.SIGTERM,), interrupt):
        yield


@contextmanager
def first_interrupt_only() -> Iterator[None]:
    """While inside, the first Ctrl-C or SIGTERM raises KeyboardInterrupt; later ones are ignored.

    What the first one lets end in order (threads, videos, the summary), an impatient second one would tear apart.
    """
    heeded = _heeded()

    def interrupt(number: int, at: FrameType | None) -> None:
        for each in heeded:
            signal.signal(each, signal.SIG_IGN)
        raise KeyboardInterrupt

    with _handled(heeded, interrupt):
        yield


@contextmanager
def interrupts_put_off() -> Iterator[None]:
    """While inside, Ctrl-C and SIGTERM wait: what belongs together (a frame's rows, pictures and count) is done first.

    Raises:
        KeyboardInterrupt: one came; raised at the end.
    """
    came: list[int] = []

    def note(number: int, at: FrameType | None) -> None:
        came.append(number)

    with _handled(_heeded(), note):
        yield
    if came:
        handler = signal.getsignal(came[0])
        if callable(handler):
            handler(came[0], None)  # so that it knows
        raise KeyboardInterrupt


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """While inside, Ctrl-C and SIGTERM are ignored: the summary and the report take a second, and are worth it."""
    with _handled(_BOTH, signal.SIG_IGN):
        yield


def _heeded() -> list[signal.Signals]:
    """Those that are not ignored already, as in the background of a shell or under nohup."""
    return [number for number in _BOTH if signal.getsignal(number) != signal.SIG_IGN]


@contextmanager
def _handled(numbers: Iterable[signal.Signals], handler: _Handler) -> Iterator[None]:
    """While inside, these signals have this handler; then again the one that they had."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
