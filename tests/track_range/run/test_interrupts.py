"""Interrupts are deferred to the end of a block, and not lost."""

import signal
import threading

import pytest

from track_range.run.interrupts import (
    defer_interrupts,
    ignore_interrupts,
    stop_on_interrupt,
)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_is_deferred_to_the_end_of_the_frame(number):
    done = []

    def frame():
        with defer_interrupts():
            signal.raise_signal(number)
            done.append("rows")
            signal.raise_signal(number)
            done.append("pictures")

    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt):
        frame()
    assert done == ["rows", "pictures"]
    assert signal.getsignal(number) == before


@pytest.mark.parametrize("first", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("is_deferred", [False, True])
def test_only_the_first_interrupt_counts(first, is_deferred):
    done = []

    def run():
        with stop_on_interrupt():
            try:
                if is_deferred:
                    with defer_interrupts():
                        signal.raise_signal(first)
                else:
                    signal.raise_signal(first)
            finally:
                signal.raise_signal(signal.SIGINT)
                signal.raise_signal(signal.SIGTERM)
                done.append("closed")

    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with pytest.raises(KeyboardInterrupt):
        run()
    assert done == ["closed"]
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_error_precedes_a_deferred_interrupt():
    def frame():
        with defer_interrupts():
            signal.raise_signal(signal.SIGTERM)
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk"):
        frame()


def test_ignored_signals_stay_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with defer_interrupts():
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_sigterm_is_an_interrupt_in_the_block():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), stop_on_interrupt():
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) == before


def test_ignored_interrupts():
    with ignore_interrupts():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)


def test_other_threads_have_no_signal_handlers():
    done = []

    def run():
        with stop_on_interrupt(), defer_interrupts(), ignore_interrupts():
            done.append("rows")

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert done == ["rows"]
