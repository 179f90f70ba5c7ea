"""Ctrl-C and polite kills while a run has something to lose."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def termination_as_interrupt() -> Iterator[None]:
    """While inside, a polite kill (SIGTERM) ends the run as Ctrl-C does: files are closed first."""

    def interrupt(number: int, at: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def interrupts_put_off() -> Iterator[None]:
    """While inside, Ctrl-C and SIGTERM wait: what belongs together (a frame's rows, pictures and count) is done first.

    Raises:
        KeyboardInterrupt: one came; raised at the end.
    """
    came: list[int] = []

    def note(number: int, at: FrameType | None) -> None:
        came.append(number)

    heeded = [number for number in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, note) for number in heeded}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        raise KeyboardInterrupt


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """While inside, Ctrl-C and SIGTERM are ignored: the summary and the report take a second, and are worth it."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
