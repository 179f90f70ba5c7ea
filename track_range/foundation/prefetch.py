"""prefetch: computes the next items of a stage in a thread while the caller processes the current
one.

    items -> thread -> [ at most `depth` items ] -> caller

Stages that release the GIL (decoding, inference, encoding) then run in parallel, and the time per
frame is the time of the slowest stage instead of the sum of all stages.
"""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Generator, Iterable
from typing import Generic, TypeVar

import cv2
import numpy as np

T = TypeVar("T")
_NICENESS = 15  # of low-priority threads (0..19); a thirtieth of the weight of an ordinary thread


def lower_thread_priority() -> None:
    """Lower the priority of this thread and its child threads (Linux only), so that inference goes
    first.
    """
    if sys.platform == "linux":  # on other systems niceness applies to the whole process
        # starts OpenCV's threads, which serve the whole process and would otherwise have the
        # priority of this one
        cv2.cvtColor(np.zeros((512, 512, 3), np.uint8), cv2.COLOR_BGR2GRAY)
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)


def prefetch(
    items: Iterable[T], *, depth: int, low_priority: bool = False, name: str = "prefetch"
) -> Generator[T, None, None]:
    """Yield the items in order, computed in a thread that is at most `depth` items ahead.

    The thread starts when the first item is requested. It ends, and closes `items` if that is a
    generator, when the items end, when they raise (the error is raised in the caller), or when the
    returned generator is closed or garbage-collected; closing waits for the item in progress.

    `depth` is the number of items queued or in progress, besides the item that the caller holds;
    ValueError below 1. For `low_priority` see `lower_thread_priority`; `name` is the thread's name,
    for profilers.
    """
    if depth < 1:
        raise ValueError(f"depth: expected at least 1, got {depth}")
    return _consume(items, depth, low_priority, name)


def _consume(
    items: Iterable[T], depth: int, low_priority: bool, name: str
) -> Generator[T, None, None]:
    queue: ClosableQueue[T] = ClosableQueue(depth)
    # A daemon thread, so that the program can end while a traceback still refers to the generator.
    thread = threading.Thread(
        target=_produce, args=(items, queue, low_priority), name=name, daemon=True
    )
    del items  # now referenced only by the thread
    thread.start()
    try:
        while queue.wait_for_item():
            yield queue.get()
        if queue.error is not None:
            raise queue.error
    finally:
        queue.close()
        # the garbage collector may close the generator inside the thread
        if thread is not threading.current_thread():
            thread.join()
        queue.error = None  # breaks a reference cycle: error -> traceback -> this frame -> queue


def _produce(items: Iterable[T], queue: ClosableQueue[T], low_priority: bool) -> None:
    error: BaseException | None = None
    try:
        if low_priority:
            lower_thread_priority()
        source = iter(items)
        try:
            while queue.wait_for_room():
                try:
                    item = next(source)
                except StopIteration:
                    break
                queue.put(item)
                del item  # so that this frame does not keep an image alive
        finally:
            if isinstance(source, Generator):
                source.close()
    except BaseException as raised:  # every error is raised in the caller
        error = raised
    queue.finish(error)


class ClosableQueue(Generic[T]):
    """Bounded queue that producer and consumer can end (`queue.Queue.shutdown` requires Python
    3.13).
    """

    def __init__(self, depth: int) -> None:
        self.error: BaseException | None = None
        self._depth = depth
        self._items: deque[T] = deque()
        self._is_finished = False
        self._is_closed = False
        # re-entrant: the garbage collector may call close() inside put()
        self._changed = threading.Condition()

    def wait_for_room(self) -> bool:
        """Producer: wait until there is room for an item; False = the queue was closed."""
        with self._changed:
            while not self._is_closed and len(self._items) >= self._depth:
                self._changed.wait()
            return not self._is_closed

    def put(self, item: T) -> None:
        """Producer: add an item, unless the queue was closed."""
        with self._changed:
            if not self._is_closed:
                self._items.append(item)
                self._changed.notify_all()

    def finish(self, error: BaseException | None) -> None:
        """Producer: mark the end of the items, with the error that caused it, if any."""
        with self._changed:
            self.error, self._is_finished = error, True
            self._changed.notify_all()

    def wait_for_item(self) -> bool:
        """Consumer: wait for an item; False = there are no more items."""
        with self._changed:
            while not self._is_finished and not self._items:
                self._changed.wait()
            return bool(self._items)

    def get(self) -> T:
        """Consumer: remove and return the oldest item; the queue must not be empty."""
        with self._changed:
            self._changed.notify_all()
            return self._items.popleft()

    def close(self) -> None:
        """Consumer: close the queue and discard its items."""
        with self._changed:
            self._is_closed = True
            self._items.clear()
            self._changed.notify_all()
