"""Time and calls of each stage of a frame, and what a call costs.

`StageProbe` takes the place of the clock of a pipeline, which tells it the stage in progress.
Functions within a stage are told apart by wrapping them. Times are of frames in which nothing is
counted; calls are counted in other frames, which take many times as long. Stages that work in
some frames only count with the mean over blocks of frames.
"""

from __future__ import annotations

import dis
import statistics
import sys
import time
import timeit
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache, wraps
from itertools import chain
from types import BuiltinFunctionType, CodeType, FrameType
from typing import Any, NamedTuple

import numpy as np

from benchmarks.speed.processor_time import functions_at
from track_range.pipeline.clock import StageClock

# Operators that the interpreter did not adapt to Python's own numbers and containers after some
# calls: those of arrays, and few others (divisions and mixed types).
_OPERATORS = ("BINARY_OP", "COMPARE_OP", "BINARY_SUBSCR", "STORE_SUBSCR", "UNARY_")
_ADAPTS = ("", "_ADAPTIVE", "NEGATIVE", "INVERT")

CALLS, ARRAYS = "calls", "array operations"
N_BLOCK = 10  # frames of a block: within it times are averaged, and of the blocks is the median


class StageProbe(StageClock):
    """Processor time of the stages of one thread, and the calls in them; a stage within another one
    counts only for itself.
    """

    def __init__(self) -> None:
        super().__init__()
        self.times_s: list[dict[str, float]] = []  # by frame and stage
        self.counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self._frame_s: defaultdict[str, float] = defaultdict(float)
        self._stages: list[str] = ["between the stages"]
        self._since_s = 0.0
        self._counts_now = False

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the with-block as a stage."""
        self._switch()
        self._stages.append(name)
        try:
            yield
        finally:
            self._switch()
            self._stages.pop()

    def _switch(self) -> None:
        now_s = time.thread_time()
        self._frame_s[self._stages[-1]] += now_s - self._since_s
        self._since_s = now_s

    @contextmanager
    def frame(self, *, counts: bool = False) -> Iterator[None]:
        """Count the with-block as a frame: its times, or its calls.

        No trace function, as that of a debugger or of coverage, is active in it: it takes time, and
        the interpreter adapts no operators under one.
        """
        self._frame_s.clear()
        trace_function = sys.gettrace()
        sys.settrace(None)
        if counts:
            self._start_counting()
        self._since_s = time.thread_time()
        try:
            yield
            self._switch()
        finally:
            if counts:
                _stop_counting()
            sys.settrace(trace_function)
        if not counts:
            self.times_s.append(dict(self._frame_s))

    @contextmanager
    def wrapped(self, stages: Mapping[str, Sequence[str]]) -> Iterator[None]:
        """Make stages of functions in the with-block, by paths as in `processor_time.STEPS`."""
        with ExitStack() as stack:
            for name, paths in stages.items():
                for owner, function in chain.from_iterable(map(functions_at, paths)):
                    stack.callback(setattr, owner, function.__name__, function)
                    setattr(owner, function.__name__, self._as_stage(function, name))
            yield

    def _as_stage(self, function: Callable[..., Any], name: str) -> Callable[..., Any]:
        @wraps(function)
        def staged(*args: Any, **kwargs: Any) -> Any:
            with self.stage(name):
                return function(*args, **kwargs)

        return staged

    def _count(self, kind: str) -> None:
        self.counts[self._stages[-1]][kind] += 1

    def _start_counting(self) -> None:
        for module in (np, np.linalg):
            for name, function in list(vars(module).items()):
                if _is_array_function(function):
                    setattr(module, name, _Counted(function, self._count))
        sys.setprofile(self._profile)
        sys.settrace(self._trace)

    def _profile(self, frame: FrameType, event: str, function: Any) -> None:
        """Count a call of a function of C."""
        if event == "c_call" and frame.f_code.co_filename != __file__:
            is_array = isinstance(function.__self__, np.ndarray | np.ufunc) or (
                function.__module__ in ("numpy", "cv2")
            )
            self._count(ARRAYS if is_array else CALLS)

    def _trace(self, frame: FrameType, event: str, _: Any) -> Any:
        """Count a call of a function of Python, and operators of arrays in it."""
        if frame.f_code.co_filename == __file__:
            return None
        self._count(CALLS)
        places = _array_operators(frame.f_code)
        frame.f_trace_lines, frame.f_trace_opcodes = False, True

        def trace_opcode(frame: FrameType, event: str, _: Any) -> Any:
            if event == "opcode" and frame.f_lasti in places:
                self._count(ARRAYS)
            return trace_opcode

        return trace_opcode

    def figures(self, n_counted: int) -> dict[str, dict[str, float]]:
        """Milliseconds, calls and operations of arrays per frame, and the share of the interpreter
        of each stage, and of all.
        """
        call_s, array_s = cost_of_call_s(), cost_of_array_s()
        rows: dict[str, dict[str, float]] = {}
        starts = range(0, len(self.times_s), N_BLOCK)
        blocks = [self.times_s[start : start + N_BLOCK] for start in starts]
        for name in dict.fromkeys(chain.from_iterable(self.times_s)):
            counts = self.counts[name]
            means_s = [statistics.mean(at.get(name, 0.0) for at in block) for block in blocks]
            rows[name] = {
                "ms": 1e3 * statistics.median(means_s),
                CALLS: counts[CALLS] / n_counted,
                ARRAYS: counts[ARRAYS] / n_counted,
            }
        rows["sum"] = {key: sum(row[key] for row in rows.values()) for key in ("ms", CALLS, ARRAYS)}
        for row in rows.values():
            interpreter_ms = 1e3 * (row[CALLS] * call_s + row[ARRAYS] * array_s)
            row["interpreter_pct"] = 100 * interpreter_ms / row["ms"] if row["ms"] else 0.0
        return rows


class _Counted:
    """A function of NumPy that counts its calls."""

    def __init__(self, function: Any, count: Callable[[str], None]) -> None:
        self.function, self._count = function, count

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        self._count(ARRAYS)
        return self.function(*args, **kwargs)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.function, name)


def _is_array_function(function: Any) -> bool:
    """Whether a function of NumPy is one of C; those of Python call such functions."""
    implementation = getattr(function, "_implementation", function)
    return isinstance(implementation, np.ufunc | BuiltinFunctionType)


def _stop_counting() -> None:
    sys.settrace(None)
    sys.setprofile(None)
    for module in (np, np.linalg):
        for name, function in list(vars(module).items()):
            if isinstance(function, _Counted):
                setattr(module, name, function.function)


@cache
def _array_operators(code: CodeType) -> frozenset[int]:
    """Places in the code of operators that are probably of arrays."""
    return frozenset(
        instruction.offset
        for instruction in dis.get_instructions(code, adaptive=True)
        for operator in _OPERATORS
        if instruction.opname.startswith(operator)
        and instruction.opname.removeprefix(operator) in _ADAPTS
    )


def cost_of_call_s() -> float:
    """Mean processor time of calls of functions that do nearly nothing."""
    names = {"f": lambda a, b: a, "point": NamedTuple("Point", [("x", float), ("y", float)])}
    calls = ("f(1, 2)", "f(1, b=2)", "len('a')", "point(1.0, 2.0)", "isinstance(1, float)")
    return statistics.mean(_seconds(call, names) for call in calls)


def cost_of_array_s() -> float:
    """Mean processor time of operations on arrays of four numbers: nearly no arithmetic."""
    names = {"np": np, "a": np.ones(4), "b": np.arange(4.0)}
    operations = ("a + b", "a < b", "b[1:]", "np.maximum(a, b)", "np.where(a, b, a)", "b.sum()")
    return statistics.mean(_seconds(operation, names) for operation in operations)


def _seconds(statement: str, names: dict[str, Any]) -> float:
    n = 10_000
    timer = timeit.Timer(statement, globals=names, timer=time.thread_time)
    return statistics.median(timer.repeat(9, n)) / n
