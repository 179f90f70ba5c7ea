"""The run folder: checkpoints with all that a run needs to go on, and results.csv; each written whole or not at all."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import torch

from track_range.detection.training.errors import CheckpointError
from track_range.foundation.atomic_files import atomic_path, describe, write_text

LAST, BEST, RESULTS = "last.pt", "best.pt", "results.csv"

_FORMAT = 1

_OPTION = {
    "model": "--model",
    "attention": "--attention",
    "classes": "--data (its names)",
    "anchors": "--anchors",
    "data": "--data",
    "teacher": "--teacher",
    "size_px": "--size",
    "n_epochs": "--epochs",
    "batch_size": "--batch",
    "seed": "--seed",
    "box_loss": "--box-loss",
    "precision": "--precision",
    "optimiser": "--optimiser",
    "learning_rate": "--learning-rate",
    "mosaic": "--mosaic",
    "min_gain": "--gain",
    "max_gain": "--gain",
}
"""What the command line calls what makes a run."""


def save_checkpoint(path: Path, content: Mapping[str, Any]) -> None:
    """Write a checkpoint of tensors and plain values; who is killed meanwhile leaves the old one.

    Raises:
        CheckpointError: it cannot be written.
    """
    try:
        with atomic_path(path) as partial:
            torch.save({"format": _FORMAT, **content}, partial)
    except RuntimeError as error:  # torch's word for a full disk
        raise CheckpointError(f"{path}: cannot be written (no space left, or the file is too large).") from error
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be written ({describe(error)}).") from error


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint; nothing in it is executed.

    Raises:
        CheckpointError: there is none, or it is none of ours.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: no such checkpoint.")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a dozen unrelated types for a broken file
        raise CheckpointError(f"{path}: not a checkpoint, or a damaged one ({type(error).__name__}).") from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise CheckpointError(f"{path}: not a checkpoint of `track-range train`.")
    return content


def check_same_run(path: Path, theirs: Mapping[str, Any], mine: Mapping[str, Any]) -> None:
    """Compare what makes a run in a checkpoint with what it should be.

    Raises:
        CheckpointError: they differ; the message names the first option that does.
    """
    for key, value in mine.items():
        if value != theirs.get(key):
            there, here = (str(each) if len(str(each)) < 60 else "..." for each in (theirs.get(key), value))
            raise CheckpointError(
                f"{path}: of another run: {_OPTION.get(key, key)} is {there} there and {here} here; give the "
                "options that it began with, or another --out (with --weights, to begin where that run is)."
            )


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other runs out of the folder meanwhile; the lock of a run that was killed does not count.

    Raises:
        CheckpointError: another run is writing there.
    """
    lock = folder / ".running"
    with suppress(OSError, ValueError):
        other = int(lock.read_text())
        if other != os.getpid() and _is_alive(other):
            raise CheckpointError(
                f"{folder}: another run (process {other}) is writing there; wait, or choose another --out."
            )
    with suppress(OSError):
        lock.write_text(str(os.getpid()))
    try:
        yield
    finally:
        with suppress(OSError):
            lock.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    """A process of that number runs; unknown, so no, where asking would end it (Windows)."""
    if os.name != "posix":
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def write_results(path: Path, history: Sequence[Mapping[str, float]]) -> None:
    """results.csv: a row per epoch, columns in the order of their first appearance, empty = not measured.

    Raises:
        CheckpointError: it cannot be written.
    """
    columns = list(dict.fromkeys(key for row in history for key in row))
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns, restval="")
    writer.writeheader()
    writer.writerows({key: f"{value:.6g}" for key, value in row.items()} for row in history)
    try:
        write_text(path, text.getvalue())
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be written ({describe(error)}).") from error
