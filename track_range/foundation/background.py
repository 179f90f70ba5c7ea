"""Background: calls that run beside the frames of a drive, and when their results are used.

    InThreads       whoever needs a result waits for it: equal frames give equal results
    InProcess       nobody waits: a result is used with the first frame after it is known

Estimates of an alignment or a focal length take up to a second of Python and small arrays, in which
a thread would hold the GIL for most of the time, so that each step beside it would wait.

parent: `submit` -> queue -> writing thread -> pipe -> child: `serve` -> pipe -> reading thread -> future
"""

from __future__ import annotations

import os
import pickle
import queue
import subprocess
import sys
import threading
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import (
    Any,
    BinaryIO,
    Concatenate,
    Generic,
    NamedTuple,
    ParamSpec,
    TypeAlias,
    TypeVar,
    cast,
)

from track_range.foundation.errors import Note

_P = ParamSpec("_P")
_T = TypeVar("_T")
_R = TypeVar("_R")

_NICENESS = 10  # of the process; a tenth of the weight of an ordinary one
_SERVE = (
    "import sys; sys.path[:] = sys.argv[1:]; "
    "from track_range.foundation.background import serve; serve()"
)
_NOT_STARTED = Note(
    "A process beside the steps cannot be started ({}): the alignment of a pair and a focal length "
    "are estimated in a thread, beside which steps take longer.",
    "no-background-process",
    "warning",
)
_ENDED = Note(
    "The process beside the steps ended (status {}): an alignment, a focal length and a check of "
    "the pair that it had not finished stay unknown. Create the pipeline again, or with "
    "deterministic=True, which needs no process.",
    "background-process-ended",
    "error",
)


class BackgroundObject(ABC, Generic[_T]):
    """An object that is used in the background only, by calls of its methods in their order."""

    background: Background  # in which it is used

    @abstractmethod
    def call(
        self, method: Callable[Concatenate[_T, _P], _R], *arguments: _P.args, **keywords: _P.kwargs
    ) -> Future[_R]:
        """Call a method, or another function of a module, with the object as first argument."""


class Background(ABC):
    """Runs calls of functions of modules, whose arguments and results can be pickled."""

    @abstractmethod
    def submit(
        self, function: Callable[_P, _R], *arguments: _P.args, **keywords: _P.kwargs
    ) -> Future[_R]:
        """Call a function."""

    @abstractmethod
    def create(
        self, make: Callable[_P, _T], *arguments: _P.args, **keywords: _P.kwargs
    ) -> BackgroundObject[_T]:
        """Make an object that is used in the background only."""

    @abstractmethod
    def is_ready(self, future: Future[Any]) -> bool:
        """Whether a result is to be used now."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        return ()

    def close(self) -> None:  # noqa: B027 - threads end with their calls
        """End the calls in progress."""


class InThreads(Background):
    """Calls run in threads; `waits` = whoever needs a result waits for it."""

    def __init__(self, *, waits: bool = True) -> None:
        self._waits = waits

    def submit(
        self, function: Callable[_P, _R], *arguments: _P.args, **keywords: _P.kwargs
    ) -> Future[_R]:
        """Call a function in a new thread."""
        thread = ThreadPoolExecutor(1, thread_name_prefix="background")
        future = thread.submit(function, *arguments, **keywords)
        thread.shutdown(wait=False)
        return future

    def create(
        self, make: Callable[_P, _T], *arguments: _P.args, **keywords: _P.kwargs
    ) -> BackgroundObject[_T]:
        """Make an object for one thread."""
        return _ObjectOfThread(self, make(*arguments, **keywords))

    def is_ready(self, future: Future[Any]) -> bool:
        """Whether the result is known, or waited for."""
        return self._waits or future.done()


class _ObjectOfThread(BackgroundObject[_T]):
    def __init__(self, background: Background, target: _T) -> None:
        self.background, self._target = background, target
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="background")

    def call(
        self, method: Callable[Concatenate[_T, _P], _R], *arguments: _P.args, **keywords: _P.kwargs
    ) -> Future[_R]:
        return self._thread.submit(method, self._target, *arguments, **keywords)


class _Message(NamedTuple):
    """One call: of a function, or, with the number of a kept object, of its maker or a method."""

    number: int  # of the call
    kept: int | None
    function: Callable[..., Any] | None  # None = the object is forgotten
    arguments: tuple[Any, ...]
    keywords: dict[str, Any]


_Messages: TypeAlias = "queue.SimpleQueue[_Message | None]"  # None = no more


class InProcess(Background):
    """Calls run one after the other in a process of low priority, and nobody waits for them.

    The process starts with the first call, and ends with this object, or with the program. Where
    none can be started, the calls run in threads.
    """

    def __init__(self) -> None:
        self._threads = InThreads(waits=False)
        self._reset()

    def _reset(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._messages: _Messages = queue.SimpleQueue()
        self._futures: dict[int, Future[Any]] = {}
        self._n_calls = self._n_kept = 0
        self._end: Callable[[], object] | None = None
        self._why_not = ""  # why no process can be started

    def submit(
        self, function: Callable[_P, _R], *arguments: _P.args, **keywords: _P.kwargs
    ) -> Future[_R]:
        """Call a function in the process."""
        if not self._is_started():
            return self._threads.submit(function, *arguments, **keywords)
        return self.send(None, function, arguments, keywords)

    def create(
        self, make: Callable[_P, _T], *arguments: _P.args, **keywords: _P.kwargs
    ) -> BackgroundObject[_T]:
        """Make an object in the process; an error of it is that of its calls."""
        if not self._is_started():
            return self._threads.create(make, *arguments, **keywords)
        self._n_kept += 1
        kept = _ObjectOfProcess[_T](self, self._n_kept)
        self.send(self._n_kept, make, arguments, keywords)
        weakref.finalize(kept, self._messages.put, _Message(0, self._n_kept, None, (), {}))
        return kept

    def is_ready(self, future: Future[Any]) -> bool:
        """Whether the result is known."""
        return future.done()

    @property
    def notes(self) -> tuple[str, ...]:
        """Message about a process that ended by itself, or cannot be started."""
        if self._why_not:
            return (_NOT_STARTED.format(self._why_not),)
        status = None if self._process is None else self._process.poll()
        return () if status is None else (_ENDED.format(status),)

    def close(self) -> None:
        """End the process, and its calls without a result; another call starts another one."""
        if self._end is not None:
            self._end()
        self._reset()

    def send(
        self,
        kept: int | None,
        function: Callable[..., Any],
        arguments: tuple[Any, ...],
        keywords: dict[str, Any],
    ) -> Future[Any]:
        """Call a function, with the number of a kept object its maker or one of its methods."""
        future: Future[Any] = Future()
        self._n_calls += 1
        self._futures[self._n_calls] = future
        self._messages.put(_Message(self._n_calls, kept, function, arguments, keywords))
        return future

    def _is_started(self) -> bool:
        """Whether the process is started, which this does if it can."""
        if self._end is None and not self._why_not:
            try:
                self._start()
            except OSError as error:
                self._why_not = error.strerror or str(error)
        return self._end is not None

    def _start(self) -> None:
        # one thread for the libraries that read these variables, as for OpenCV in `serve`
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        of_windows = ("BELOW_NORMAL_PRIORITY_CLASS", "CREATE_NEW_PROCESS_GROUP")
        self._process = process = subprocess.Popen(
            [sys.executable, "-c", _SERVE, *sys.path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **one_thread},
            # the parent handles Ctrl+C for both
            start_new_session=True,
            creationflags=sum(getattr(subprocess, name, 0) for name in of_windows),
        )
        self._end = weakref.finalize(self, _end, process, self._messages)
        works = (
            partial(_write, cast(BinaryIO, process.stdin), self._messages, self._futures),
            partial(_read, process, self._futures),
        )
        for work in works:
            threading.Thread(target=work, name="background", daemon=True).start()


def _write(pipe: BinaryIO, messages: _Messages, futures: dict[int, Future[Any]]) -> None:
    """Send the messages to the process; what cannot be pickled is the error of its call."""
    with suppress(OSError), pipe:  # a process that ended reads nothing
        while (message := messages.get()) is not None:
            try:
                call = pickle.dumps(message[2:], pickle.HIGHEST_PROTOCOL)
            except Exception as error:
                futures.pop(message.number).set_exception(error)
                continue
            pickle.dump((message.number, message.kept, call), pipe, pickle.HIGHEST_PROTOCOL)
            pipe.flush()


def _read(process: subprocess.Popen[bytes], futures: dict[int, Future[Any]]) -> None:
    """Receive the results from the process, until it ends."""
    # a process that ended in the middle of an answer, or whose answers make no sense
    with (
        cast(BinaryIO, process.stdout) as pipe,
        suppress(EOFError, OSError, ValueError, pickle.UnpicklingError),
    ):
        while True:
            number, is_error, data = pickle.load(pipe)  # noqa: S301 - of our own process
            future = futures.pop(number)
            try:
                value = pickle.loads(data)  # noqa: S301 - of our own process
            except Exception as error:
                value, is_error = error, True
            if is_error:
                future.set_exception(value)
            else:
                future.set_result(value)
    process.kill()  # so that its end is known, see `InProcess.notes`


def _end(process: subprocess.Popen[bytes], messages: _Messages) -> None:
    messages.put(None)
    process.kill()
    process.wait()


class _ObjectOfProcess(BackgroundObject[_T]):
    def __init__(self, process: InProcess, number: int) -> None:
        self.background: Background = process
        self._process, self._number = process, number

    def call(
        self, method: Callable[Concatenate[_T, _P], _R], *arguments: _P.args, **keywords: _P.kwargs
    ) -> Future[_R]:
        return self._process.send(self._number, method, arguments, keywords)


def beside_steps() -> Background:
    """The background of steps that never wait; in threads where no other process can be started."""
    has_python = bool(sys.executable) and not getattr(sys, "frozen", False)
    return InProcess() if has_python else InThreads(waits=False)


def serve() -> None:
    """The life of the process of `InProcess`: answers calls until its input ends."""
    # what a library prints does not belong to the answers
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    import cv2  # with the low priority, since this takes a while

    cv2.setNumThreads(1)
    kept: dict[int, Any] = {}
    with suppress(EOFError, BrokenPipeError):  # the parent is gone
        while True:
            number, key, call = pickle.load(sys.stdin.buffer)  # noqa: S301 - of our parent
            is_error, value = _answer(key, call, kept)
            try:
                data = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
            except Exception as error:
                is_error, data = True, pickle.dumps(TypeError(f"{type(value).__name__}: {error}"))
            if number:
                pickle.dump((number, is_error, data), answers, pickle.HIGHEST_PROTOCOL)
                answers.flush()


def _answer(key: int | None, call: bytes, kept: dict[int, Any]) -> tuple[bool, Any]:
    """Whether a pickled call fails, and its error or its result."""
    try:
        function, arguments, keywords = pickle.loads(call)  # noqa: S301 - of our parent
        if key is None:
            return False, function(*arguments, **keywords)
        if function is None:
            kept.pop(key, None)
            return False, None
        if key in kept:
            return False, function(kept[key], *arguments, **keywords)
        kept[key] = function(*arguments, **keywords)
    except Exception as error:  # the caller decides what it means
        return True, error
    return False, None
