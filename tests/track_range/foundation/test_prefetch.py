from __future__ import annotations

import gc
import itertools
import os
import subprocess
import sys
import threading
import weakref
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from track_range.foundation.prefetch import prefetch

PROJECT = Path(__file__).resolve().parents[3]
WAIT_S = 20.0  # long enough for any machine; exceeded only if something hangs


def prefetch_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "prefetch"]


class Source:
    """Numbers from 0 on; records how many were requested and whether it was closed."""

    def __init__(self, end: int | None = None, error_at: int | None = None) -> None:
        self.n_made = 0
        self.made = threading.Semaphore(0)
        self.closed = threading.Event()
        self.thread: threading.Thread | None = None
        self._end, self._error_at = end, error_at

    def items(self) -> Iterator[int]:
        self.thread = threading.current_thread()
        try:
            for number in itertools.count() if self._end is None else range(self._end):
                if number == self._error_at:
                    raise LookupError(f"item {number}")
                self.n_made += 1
                self.made.release()
                yield number
        finally:
            self.closed.set()


@given(items=st.lists(st.integers() | st.none()), depth=st.integers(1, 5))
@settings(deadline=None, max_examples=50)
def test_items_in_order(items: list[int | None], depth: int) -> None:
    assert list(prefetch(items, depth=depth)) == items
    assert not prefetch_threads()


def test_chained_stages_keep_order() -> None:
    doubled = (2 * number for number in prefetch(range(200), depth=3))
    assert list(prefetch(doubled, depth=2)) == list(range(0, 400, 2))
    assert not prefetch_threads()


@pytest.mark.parametrize("depth", [1, 4])
def test_thread_is_at_most_depth_ahead(depth: int) -> None:
    source = Source()
    ahead = prefetch(source.items(), depth=depth)
    for n_taken in range(1, 30):
        assert next(ahead) == n_taken - 1
        assert source.n_made <= n_taken + depth
    ahead.close()


def test_thread_runs_ahead() -> None:
    source = Source()
    ahead = prefetch(source.items(), depth=4)
    next(ahead)
    for _ in range(5):  # the consumed item and four more, without a request
        assert source.made.acquire(timeout=WAIT_S)
    assert source.n_made == 5
    assert source.thread is not threading.current_thread()
    ahead.close()


def test_nothing_runs_before_the_first_request() -> None:
    source = Source()
    ahead = prefetch(source.items(), depth=2)
    assert not prefetch_threads()
    ahead.close()
    assert source.n_made == 0


@pytest.mark.parametrize("depth", [1, 3])
def test_error_is_raised_in_the_caller(depth: int) -> None:
    source = Source(error_at=5)
    ahead = prefetch(source.items(), depth=depth)
    assert list(itertools.islice(ahead, 5)) == [0, 1, 2, 3, 4]
    with pytest.raises(LookupError, match="item 5") as raised:
        next(ahead)
    # the traceback contains the origin
    assert any(entry.name == "items" for entry in raised.traceback)
    assert next(ahead, "over") == "over"
    assert not prefetch_threads()


def test_iterable_that_fails_at_iter() -> None:
    with pytest.raises(TypeError, match="not iterable"):
        list(prefetch(5, depth=1))  # type: ignore[arg-type]
    assert not prefetch_threads()


def test_system_exit_is_raised_in_the_caller() -> None:
    def leaving() -> Iterator[int]:
        yield 1
        raise SystemExit(3)

    ahead = prefetch(leaving(), depth=1)
    assert next(ahead) == 1
    with pytest.raises(SystemExit):
        next(ahead)


@pytest.mark.parametrize("n_taken", [1, 7])
def test_closing_early_ends_the_thread_and_the_source(n_taken: int) -> None:
    source = Source()
    ahead = prefetch(source.items(), depth=2)
    for _ in range(n_taken):
        next(ahead)
    ahead.close()  # whether the queue is full or not
    assert source.closed.is_set()
    assert not prefetch_threads()


def test_leaving_a_loop_ends_the_thread() -> None:
    source = Source()
    for number in prefetch(source.items(), depth=3):
        if number == 4:
            break
    gc.collect()
    assert source.closed.wait(WAIT_S)
    assert not prefetch_threads()


def test_garbage_collection_ends_the_thread() -> None:
    source = Source()
    ahead = prefetch(source.items(), depth=3)
    next(ahead)
    del ahead
    gc.collect()
    assert source.closed.wait(WAIT_S)
    assert not prefetch_threads()


def test_closing_a_chain_ends_every_thread() -> None:
    source = Source()
    inner = prefetch(source.items(), depth=2)
    outer = prefetch((number + 1 for number in inner), depth=2)
    assert next(outer) == 1
    assert len(prefetch_threads()) == 2
    outer.close()
    inner.close()
    assert source.closed.is_set()
    assert not prefetch_threads()


def test_error_of_the_caller_ends_the_thread() -> None:
    source = Source()

    def consume() -> None:
        for number in prefetch(source.items(), depth=2):
            raise ValueError(number)

    with pytest.raises(ValueError, match="0"):
        consume()
    gc.collect()
    assert source.closed.wait(WAIT_S)


def test_consumed_items_are_released() -> None:
    class Big:
        pass

    ahead = prefetch((Big() for _ in range(10)), depth=1)
    held = [weakref.ref(next(ahead)) for _ in range(5)]
    ahead.close()
    gc.collect()
    assert [ref() for ref in held] == [None] * 5


def test_thread_does_not_block_the_end_of_the_program() -> None:
    ahead = prefetch(itertools.count(), depth=1)
    next(ahead)
    assert all(thread.daemon for thread in prefetch_threads())
    ahead.close()


@pytest.mark.parametrize("depth", [0, -1])
def test_depth_below_one(depth: int) -> None:
    with pytest.raises(ValueError, match="depth"):
        prefetch([], depth=depth)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has a niceness of each thread")
def test_only_the_thread_gets_a_lower_priority() -> None:
    code = """if True:
        import os, threading
        import cv2, numpy as np
        from track_range.foundation.prefetch import lower_thread_priority

        def work():
            lower_thread_priority()
            cv2.resize(np.zeros((999, 999, 3), np.uint8), (2000, 2000))  # in OpenCV's threads
            print(*(os.getpriority(os.PRIO_PROCESS, int(task)) for task in os.listdir("/proc/self/task")))

        cv2.setNumThreads(2)
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    """
    printed = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=PROJECT
    )
    niceness = [int(text) for text in printed.stdout.split()]
    before = os.getpriority(os.PRIO_PROCESS, 0)
    assert len(niceness) > 2
    assert sorted(niceness)[:-1] == [before] * (len(niceness) - 1)
    assert max(niceness) > before
