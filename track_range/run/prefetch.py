"""prefetch: the next items of a stage are made in a thread while the caller works on this one.

    items -> thread -> [ at most `depth` items ] -> caller

Stages that leave Python's lock (decoding, inference, encoding) then run beside each other, and the time of a frame is
that of the slowest stage, not the sum of all.
"""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

T = TypeVar("T")

_SWITCH_INTERVAL_S = 0.0005
_NICENESS = 15  # of 19: a thirtieth of the weight of an ordinary thread


def lower_thread_priority() -> None:
    """Lower the priority of the calling thread and of those that it starts (Linux only).

    With fewer cores than busy threads, decoding and drawing would else take turns with inference, which all wait for.
    """
    if sys.platform == "linux":  # elsewhere a niceness belongs to the whole process
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)


class _SwitchInterval:
    """The interpreter's switch interval, short while at least one run needs it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._n_users, self._default_s = 0, 0.0

    def acquire(self) -> None:
        with self._lock:
            if not self._n_users:
                self._default_s = sys.getswitchinterval()
                sys.setswitchinterval(_SWITCH_INTERVAL_S)
            self._n_users += 1

    def release(self) -> None:
        with self._lock:
            self._n_users -= 1
            if not self._n_users:
                sys.setswitchinterval(self._default_s)


_switch_interval = _SwitchInterval()


@contextmanager
def short_switch_interval() -> Iterator[None]:
    """Within this context a thread that comes back from inference waits at most 0.5 ms for Python's lock.

    The default, 5 ms, is a tenth of a frame. It is restored when the last of several runs has ended.
    """
    _switch_interval.acquire()
    try:
        yield
    finally:
        _switch_interval.release()


def prefetch(items: Iterable[T], *, depth: int, low_priority: bool = False) -> Generator[T, None, None]:
    """The same items in the same order, made in a thread that is at most `depth` items ahead.

    The thread starts with the first item asked for. It ends, and closes `items` if that is a generator, when the items
    end, when they raise (the error reaches the caller in the items' place) or when the generator returned here is
    closed or collected; closing waits for the item that is just being made.

    Args:
        items: iterated in the thread alone.
        depth: items waiting or being made beyond the one that the caller holds, at least 1.
        low_priority: see `lower_thread_priority`.

    Raises:
        ValueError: `depth` below 1.
    """
    if depth < 1:
        raise ValueError(f"depth: expected at least 1, got {depth}")
    return _consume(items, depth, low_priority)


def _consume(items: Iterable[T], depth: int, low_priority: bool) -> Generator[T, None, None]:
    queue: ClosableQueue[T] = ClosableQueue(depth)
    # A daemon, so that a caller who dies with the generator still in a traceback does not keep the program from ending.
    thread = threading.Thread(target=_produce, args=(items, queue, low_priority), name="prefetch", daemon=True)
    del items  # from here on they are the thread's alone
    thread.start()
    try:
        while queue.wait_for_item():
            yield queue.get()
        if queue.error is not None:
            raise queue.error
    finally:
        queue.close()
        if thread is not threading.current_thread():  # the garbage collector may close us inside our own thread
            thread.join()
        queue.error = None  # its traceback holds this frame, which holds the queue


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
                del item  # the caller's alone now: an image must not live on in this frame
        finally:
            if isinstance(source, Generator):
                source.close()
    except BaseException as raised:  # whatever it is, the caller must see it
        error = raised
    queue.finish(error)


class ClosableQueue(Generic[T]):
    """A bounded queue that producer and consumer can end; `queue.Queue.shutdown` exists from Python 3.13 on only."""

    def __init__(self, depth: int) -> None:
        self.error: BaseException | None = None
        self._depth = depth
        self._items: deque[T] = deque()
        self._is_finished = False
        self._is_closed = False
        self._changed = threading.Condition()  # its lock is re-entrant: the collector may call close() inside put()

    def wait_for_room(self) -> bool:
        """Producer: wait until an item may be made; False = the consumer takes no more."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_closed or len(self._items) < self._depth)
            return not self._is_closed

    def put(self, item: T) -> None:
        """Producer: add an item, unless the consumer takes no more."""
        with self._changed:
            if not self._is_closed:
                self._items.append(item)
                self._changed.notify_all()

    def finish(self, error: BaseException | None) -> None:
        """Producer: there are no more items, because of an error or not."""
        with self._changed:
            self.error, self._is_finished = error, True
            self._changed.notify_all()

    def wait_for_item(self) -> bool:
        """Consumer: wait for an item; False = there are no more."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_finished or bool(self._items))
            return bool(self._items)

    def get(self) -> T:
        """Consumer: the oldest item, of which there is one."""
        with self._changed:
            self._changed.notify_all()
            return self._items.popleft()

    def close(self) -> None:
        """Consumer: take no more items."""
        with self._changed:
            self._is_closed = True
            self._items.clear()
            self._changed.notify_all()
