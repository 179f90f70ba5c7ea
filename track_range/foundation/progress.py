"""Types of the callbacks that report the progress of long tasks."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

StepProgress = Callable[[str], AbstractContextManager[Callable[[int, int | None], None]]]
"""Called with the name of a task; the context manager yields a function of (steps done, total steps
or None)."""


@contextmanager
def no_progress(_task: str) -> Iterator[Callable[[int, int | None], None]]:
    """A `StepProgress` that shows nothing."""
    yield lambda _done, _total: None


FrameProgress = Callable[[int | None], AbstractContextManager[Callable[[], None]]]
"""Called with the number of frames (None = unknown); the context manager yields a function to call
once per frame."""


@contextmanager
def no_frame_progress(_n_frames: int | None) -> Iterator[Callable[[], None]]:
    """A `FrameProgress` that shows nothing."""
    yield lambda: None
