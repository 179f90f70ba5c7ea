"""Writing of model files: atomically, and without the output of the libraries that convert them."""

import contextlib
import io
import logging
import warnings
from collections.abc import Iterator
from pathlib import Path

from track_range.detection.models.onnx_session import ModelError
from track_range.foundation.files.atomic_files import atomic_folder, writable


@contextlib.contextmanager
def conversion_errors(path: Path, verb: str) -> Iterator[None]:
    """Context of a converter of the model at `path`; its exceptions become a ModelError, "`path`:
    cannot be `verb`".
    """
    try:
        yield
    except Exception as error:  # onnx and onnxruntime raise dozens of unrelated types
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ModelError(f"{path}: cannot be {verb} ({reason}).") from error


@contextlib.contextmanager
def silent_conversion(path: Path, verb: str) -> Iterator[None]:
    """`conversion_errors` of a converter; all prints, warnings and log lines of the process are
    discarded.
    """
    handler, disabled = logging.NullHandler(), logging.root.manager.disable
    # otherwise logging.warning() would install a handler that prints
    logging.root.addHandler(handler)
    logging.disable(logging.CRITICAL)
    try:
        with (
            conversion_errors(path, verb),
            warnings.catch_warnings(),
            contextlib.redirect_stdout(io.StringIO()),
        ):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(disabled)
        logging.root.removeHandler(handler)


@contextlib.contextmanager
def atomic_output(out: Path) -> Iterator[Path]:
    """Context of a temporary folder; at the end, its file with the name of `out` replaces `out`,
    else ModelError.
    """
    if not out.parent.is_dir():
        raise ModelError(f"{out}: expected an existing folder, {out.parent} does not exist.")
    with writable(out, ModelError), atomic_folder(out) as folder:
        yield folder
