"""Calls beside the frames of a drive: in threads, with waiting, and in a process, without."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future, wait
from typing import Any

import numpy as np
import pytest

from track_range.foundation.arrays import FloatArray
from track_range.foundation.background import Background, InProcess, InThreads, beside_steps
from track_range.foundation.robust_statistics import median_of
from track_range.stereo.geometry.frames import Frame

_MOST_S = 60.0


class Sum:
    """Adds numbers, and prints, as a library might."""

    def __init__(self, start: float) -> None:
        self.total = start

    def add(self, number: float, *, times: int = 1) -> float:
        sys.stdout.write("some text")
        self.total += times * number
        return self.total


class TwoReasonsError(Exception):
    """Its pickle has one argument, and it needs two."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first}, {second}")


def refused_twice() -> None:
    raise TwoReasonsError("not today", "not tomorrow")


def lambda_result() -> Any:
    return lambda: None


def pid() -> int:
    return os.getpid()


def refused(text: str) -> None:
    raise ValueError(text)


def width_of_right(frame: Frame) -> int:
    return 0 if frame.right is None else frame.right.shape[1]


class LazyImage:
    """An image that cannot be pickled, since it is computed where it is read."""

    shape = (2, 7)

    def __init__(self) -> None:
        self.read = lambda: np.zeros(self.shape, np.uint8)

    def __getitem__(self, window: tuple[slice, slice]) -> Any:
        return self.read()[window]


def known(future: Future[Any]) -> Any:
    wait([future], _MOST_S)
    return future.result(0.0)


@pytest.fixture(params=[InThreads, InProcess])
def background(request: pytest.FixtureRequest) -> Iterator[Background]:
    made: Background = request.param()
    yield made
    made.close()


def test_functions_and_kept_objects(background: Background) -> None:
    total = background.create(Sum, 10.0)
    other = background.create(Sum, 100.0)
    futures = [
        total.call(Sum.add, 1.0),
        other.call(Sum.add, 1.0),
        total.call(Sum.add, 2.0, times=3),
        background.submit(median_of, np.array([3.0, 1.0, 2.0])),
    ]
    assert [known(future) for future in futures] == [11.0, 101.0, 17.0, 2.0]
    assert all(background.is_ready(future) for future in futures)
    assert background.notes == ()


def test_errors_belong_to_their_calls(background: Background) -> None:
    with pytest.raises(ValueError, match="not today"):
        known(background.submit(refused, "not today"))
    assert known(background.submit(pid)) > 0


def test_what_cannot_be_sent_is_the_error_of_its_call() -> None:
    background = InProcess()
    for function in (refused_twice, lambda_result):
        with pytest.raises((TypeError, AttributeError)):
            known(background.submit(function))
    broken = background.create(Sum, "no number")
    with pytest.raises(TypeError):
        known(broken.call(Sum.add, 1.0))
    assert known(background.submit(pid)) > 0
    assert background.notes == ()
    background.close()


def test_calls_run_in_threads_where_no_process_can_be_started(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "executable", "/no/python")
    background = beside_steps()
    assert known(background.submit(pid)) == os.getpid()
    assert known(background.create(Sum, 10.0).call(Sum.add, 1.0)) == 11.0
    (note,) = background.notes
    assert "cannot be started (No such file or directory)" in note
    background.close()


def test_a_process_starts_again_after_it_was_closed() -> None:
    background = InProcess()
    first = known(background.submit(pid))
    background.close()
    assert known(background.submit(pid)) != first
    background.close()


def test_a_thread_is_waited_for_and_a_process_is_not() -> None:
    threads, process = InThreads(), InProcess()
    unknown: Future[FloatArray] = Future()
    assert threads.is_ready(unknown)
    assert not InThreads(waits=False).is_ready(unknown)
    assert not process.is_ready(process.submit(pid))
    process.close()


def test_frames_are_sent_with_all_of_their_right_image() -> None:
    background = InProcess()
    frame = Frame(0, 0.0, np.zeros((2, 7), np.uint8), LazyImage())
    assert known(background.submit(width_of_right, frame)) == 7
    with pytest.raises(Exception, match="pickle"):
        known(background.submit(median_of, lambda: None))  # type: ignore[arg-type]
    background.close()


def test_a_process_that_ends_is_told_and_nothing_waits() -> None:
    background = beside_steps()
    child = known(background.submit(pid))
    assert child != os.getpid()
    os.kill(child, signal.SIGKILL)
    for _ in range(100):
        if background.notes:
            break
        time.sleep(0.1)
    (note,) = background.notes
    assert f"status {-signal.SIGKILL}" in note
    assert not background.is_ready(background.submit(pid))
    background.close()
    background.close()


def test_a_process_ends_with_its_owner() -> None:
    background = InProcess()
    child = known(background.submit(pid))
    del background
    for _ in range(100):
        try:
            os.kill(child, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    pytest.fail("the process is still running")
