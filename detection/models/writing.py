"""Writing model files: whole or not at all, and without the chatter of the libraries that convert them."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Iterator
from pathlib import Path

from track_range.detection.models.onnx_session import ModelError
from track_range.foundation.atomic_files import atomic_folder, describe


@contextlib.contextmanager
def silent_conversion(path: Path, verb: str) -> Iterator[None]:
    """Run a converter of the model at `path` without its prints, warnings and log lines.

    Raises:
        ModelError: whatever it raises, as one sentence: `path` cannot be `verb`, and why.
    """
    handler, disabled = logging.NullHandler(), logging.root.manager.disable
    logging.root.addHandler(handler)  # else logging's own functions would install one that prints
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    except Exception as error:  # onnx and onnxruntime raise dozens of unrelated types
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ModelError(f"{path}: cannot be {verb} ({reason}).") from error
    finally:
        logging.disable(disabled)
        logging.root.removeHandler(handler)


@contextlib.contextmanager
def written_whole(out: Path) -> Iterator[Path]:
    """A folder beside `out` to work in; the file of the same name left in it takes the place of `out` at the end.

    Raises:
        ModelError: there is no folder to write `out` into, or it cannot be written to.
    """
    if not out.parent.is_dir():
        raise ModelError(f"{out}: no such folder to write into.")
    try:
        with atomic_folder(out) as folder:
            yield folder
    except OSError as error:
        raise ModelError(f"{out}: cannot be written ({describe(error)}).") from error
