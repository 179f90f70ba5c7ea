"""Overlap: the next items of a stage are made in a thread while the caller works on this one.

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


def give_way() -> None:
    """Let the calling thread, and those that it starts, run only where more urgent ones leave room (Linux only).

    With fewer cores than busy threads, decoding and drawing would else take turns with inference, which all wait for.
    """
    if sys.platform == "linux":  # elsewhere a niceness belongs to the whole process
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)


@contextmanager
def short_switch_interval() -> Iterator[None]:
    """While inside, a thread that comes back from inference waits at most half a millisecond for Python's lock.

    The default, 5 ms, is a tenth of a frame.
    """
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)


def prefetch(items: Iterable[T], *, depth: int, gives_way: bool = False) -> Generator[T, None, None]:
    """The same items in the same order, made in a thread that is at most `depth` items ahead.

    The thread starts with the first item asked for. It ends, and closes `items` if that is a generator, when the items
    end, when they raise (the error reaches the caller in the items' place) or when the generator returned here is
    closed or collected; closing waits for the item that is just being made.

    Args:
        items: iterated in the thread alone.
        depth: items waiting or being made beyond the one that the caller holds, at least 1.
        gives_way: see `give_way`.

    Raises:
        ValueError: `depth` below 1.
    """
    if depth < 1:
        raise ValueError(f"depth: at least 1 wanted, {depth} got")
    return _consume(items, depth, gives_way)


def _consume(items: Iterable[T], depth: int, gives_way: bool) -> Generator[T, None, None]:
    belt: _Belt[T] = _Belt(depth)
    # A daemon, so that a caller who dies with the generator still in a traceback does not keep the program from ending.
    thread = threading.Thread(target=_produce, args=(items, belt, gives_way), name="prefetch", daemon=True)
    del items  # from here on they are the thread's alone
    thread.start()
    try:
        while belt.wait_for_item():
            yield belt.taken()
        if belt.error is not None:
            raise belt.error
    finally:
        belt.stop()
        if thread is not threading.current_thread():  # the garbage collector may close us inside our own thread
            thread.join()
        belt.error = None  # its traceback holds this frame, which holds the belt


def _produce(items: Iterable[T], belt: _Belt[T], gives_way: bool) -> None:
    error: BaseException | None = None
    try:
        if gives_way:
            give_way()
        _fill(items, belt)
    except BaseException as raised:  # whatever it is, the caller must see it
        error = raised
    belt.finish(error)


def _fill(items: Iterable[T], belt: _Belt[T]) -> None:
    source = iter(items)
    try:
        while belt.wait_for_room():
            try:
                item = next(source)
            except StopIteration:
                return
            belt.put(item)
            del item  # the caller's alone now: an image must not live on in this frame
    finally:
        if isinstance(source, Generator):
            source.close()


class _Belt(Generic[T]):
    """A bounded queue that either end can leave; queue.Queue has no such thing before Python 3.13."""

    def __init__(self, depth: int) -> None:
        self.error: BaseException | None = None
        self._depth = depth
        self._items: deque[T] = deque()
        self._is_finished = False
        self._is_stopped = False
        self._changed = threading.Condition()  # its lock is re-entrant: the collector may call stop() inside put()

    def wait_for_room(self) -> bool:
        """Producer: wait until an item may be made; False = nobody wants any more."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_stopped or len(self._items) < self._depth)
            return not self._is_stopped

    def put(self, item: T) -> None:
        with self._changed:
            if not self._is_stopped:
                self._items.append(item)
                self._changed.notify_all()

    def finish(self, error: BaseException | None) -> None:
        """Producer: nothing more comes."""
        with self._changed:
            self.error, self._is_finished = error, True
            self._changed.notify_all()

    def wait_for_item(self) -> bool:
        """Consumer: wait for an item; False = there are no more."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_finished or bool(self._items))
            return bool(self._items)

    def taken(self) -> T:
        """Consumer: the oldest item, of which there is one."""
        with self._changed:
            self._changed.notify_all()
            return self._items.popleft()

    def stop(self) -> None:
        """Consumer: want no more items."""
        with self._changed:
            self._is_stopped = True
            self._items.clear()
            self._changed.notify_all()
