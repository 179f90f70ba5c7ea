"""Interrupts wait for what belongs together, and are not lost."""

import signal

import pytest

from track_range.run.interrupts import (
    deaf_to_interrupts,
    first_interrupt_only,
    interrupts_put_off,
    termination_as_interrupt,
)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_waits_for_the_end_of_the_frame(number):
    done = []

    def frame():
        with interrupts_put_off():
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
@pytest.mark.parametrize("is_put_off", [False, True])
def test_only_the_first_interrupt_counts(first, is_put_off):
    done = []

    def run():
        with first_interrupt_only():
            try:
                if is_put_off:
                    with interrupts_put_off():
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


def test_an_error_of_the_frame_is_told_rather_than_the_interrupt():
    def frame():
        with interrupts_put_off():
            signal.raise_signal(signal.SIGTERM)
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk"):
        frame()


def test_what_was_ignored_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupts_put_off():
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_polite_kill_is_an_interrupt_and_ends_with_the_block():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), termination_as_interrupt():
        signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGTERM) == before


def test_nothing_interrupts_the_report():
    with deaf_to_interrupts():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
