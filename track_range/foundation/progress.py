"""Progress of long work, reported to whoever shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

StepProgress = Callable[[str], AbstractContextManager[Callable[[int, int | None], None]]]
"""Called with the name of the work; within the context, call with steps done and their number (None = unknown)."""


@contextmanager
def no_progress(_work: str) -> Iterator[Callable[[int, int | None], None]]:
    """Progress that nobody sees."""
    yield lambda _done, _total: None


FrameProgress = Callable[[int | None], AbstractContextManager[Callable[[], None]]]
"""Called with the number of frames (None = unknown); within the context, call once per frame."""


@contextmanager
def no_frame_progress(_n_frames: int | None) -> Iterator[Callable[[], None]]:
    """Progress that nobody sees."""
    yield lambda: None
