"""The run folder: checkpoints from which a run can be resumed, and results.csv, all written
atomically.
"""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import UnionType
from typing import Any

import torch
from torch import Tensor

from track_range.detection.training.errors import CheckpointError
from track_range.foundation.files.atomic_files import atomic_path, describe, writable, write_text
from track_range.foundation.files.output_files import OutputError

LAST, BEST, RESULTS = "last.pt", "best.pt", "results.csv"
_FORMAT = 1

_OPTION = {  # command line option by the key of a run's identity, for messages
    "model": "--model", "attention": "--attention", "classes": "--data (its names)", "anchors": "--anchors",
    "data": "--data", "teacher": "--teacher", "size_px": "--size", "n_epochs": "--epochs",
    "n_last_epochs": "--last-epochs", "n_int8_epochs": "--int8-epochs", "batch_size": "--batch", "seed": "--seed",
    "box_loss": "--box-loss", "precision": "--precision", "optimiser": "--optimiser",
    "learning_rate": "--learning-rate", "mosaic": "--mosaic", "min_gain": "--gain", "max_gain": "--gain",
}  # fmt: skip
_DEFAULT = {"n_last_epochs": 0, "n_int8_epochs": 0}  # of checkpoints older than these settings


def save_checkpoint(path: Path, content: Mapping[str, Any]) -> None:
    """Write a checkpoint of tensors and plain values atomically; CheckpointError if it cannot be
    written.
    """
    try:
        with atomic_path(path) as file:
            torch.save({"format": _FORMAT, **content}, file)
    except RuntimeError as error:  # raised by torch if the disk is full
        raise CheckpointError(
            f"{path}: cannot be written (no space left, or the file is too large)."
        ) from error
    except OSError as error:
        raise CheckpointError(f"{path}: cannot be written ({describe(error)}).") from error


def load_checkpoint(path: Path) -> dict[str, Any]:
    """The content of a checkpoint, without executing code; CheckpointError if it is damaged or no
    checkpoint.
    """
    if not path.is_file():
        raise CheckpointError(f"{path}: no such checkpoint.")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises a dozen unrelated types for a broken file
        raise CheckpointError(
            f"{path}: this is no intact checkpoint ({type(error).__name__})."
        ) from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise CheckpointError(f"{path}: expected a checkpoint of `track-range train`.")
    content = {"identity": None, "average": None, "feature_loss": {}} | content
    wrong = [
        key for key, is_valid in _IS_VALID.items() if key in content and not is_valid(content[key])
    ]
    if wrong:
        raise CheckpointError(f"{path}: damaged checkpoint (unusable {', '.join(wrong)}).")
    return content


def load_mean(paths: Sequence[Path]) -> dict[str, Any]:
    """The content of the first checkpoint, with the mean of the averaged weights of all
    checkpoints.

    The mean of checkpoints of one run, or of runs that started from the same weights, is often
    better than each of them (Izmailov et al., "Averaging Weights Leads to Wider Optima and Better
    Generalization", UAI 2018); the mean of runs from different random weights is useless.
    CheckpointError: the checkpoints belong to different networks.
    """
    first, *others = contents = [load_checkpoint(path) for path in paths]
    before = _network_of(first)
    for path, other in zip(paths[1:], others, strict=True):
        after = _network_of(other)
        for part in before | after:
            old, new = before.get(part, "none"), after.get(part, "none")
            if old != new:
                raise CheckpointError(
                    f"{path}: expected {part} {old} as in {paths[0]}, got {new}; several --weights can be averaged "
                    "only if they have the same network and the same classes."
                )
    if len(contents) > 1:
        try:
            parts = {
                name: torch.stack([other["average"][name] for other in contents])
                for name in first["average"]
            }
            mean = {
                name: part.mean(0) if part.is_floating_point() else part[0]
                for name, part in parts.items()
            }
            first["average"] = mean
        except RuntimeError as error:
            raise CheckpointError(
                f"{paths[0]}: its weights cannot be averaged ({type(error).__name__})."
            ) from error
    return first


def _network_of(content: Mapping[str, Any]) -> dict[str, str]:
    identity = content["identity"]
    parts = {
        "model": str(identity.get("model", "unknown")),
        "classes": ", ".join(identity["classes"]),
    }
    return parts | {
        f"weights {name} of shape": str(tuple(value.shape))
        for name, value in content["average"].items()
    }


def _is_dictionary(value: object, of: type | UnionType) -> bool:
    return isinstance(value, dict) and all(
        isinstance(k, str) and isinstance(v, of) for k, v in value.items()
    )


def _is_identity(value: object) -> bool:
    classes = value.get("classes") if isinstance(value, dict) else None
    return (
        _is_dictionary(value, object)
        and isinstance(classes, list)
        and all(isinstance(n, str) for n in classes)
    )


# check of the structure of a part of a checkpoint, by key
_IS_VALID: Mapping[str, Callable[[object], bool]] = {
    "identity": _is_identity,
    "history": lambda value: (
        isinstance(value, list) and all(_is_dictionary(row, int | float) for row in value)
    ),
    **dict.fromkeys(("network", "average", "feature_loss"), partial(_is_dictionary, of=Tensor)),
}


def check_same_run(path: Path, saved: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """Raise CheckpointError, with the first option that differs, if a checkpoint belongs to another
    run.
    """
    for key, value in expected.items():
        before = saved.get(key, _DEFAULT.get(key))
        if value != before:
            old, new = (str(part) if len(str(part)) < 60 else "..." for part in (before, value))
            raise CheckpointError(
                f"{path}: expected {_OPTION.get(key, key)} {new}, got a run with {old}; use the options of that run "
                "or another --out (with --weights to start from its weights)."
            )


def check_start(out: Path, *, resume: bool, weights: Sequence[Path], files: Sequence[str]) -> None:
    """Check the run folder and the checkpoints of `--weights` before images are read.

    OutputError: the folder contains a run that is not to be resumed, or one of its `files` would be
    overwritten. CheckpointError: a checkpoint is missing or damaged.
    """
    if resume:
        load_checkpoint(out / LAST)
        if (out / BEST).exists():
            load_checkpoint(out / BEST)
        return
    if (out / LAST).exists():
        raise OutputError(
            f"{out}: this folder already contains a run; continue it with --resume, or choose another --out."
        )
    for name in (BEST, RESULTS, *files):
        if (out / name).exists():
            raise OutputError(
                f"{out / name}: this file would be overwritten; choose another --out."
            )
    if weights:
        load_mean(weights)


def write_results(path: Path, history: Sequence[Mapping[str, float]]) -> None:
    """Write results.csv: one row per epoch, columns in the order of their first appearance, empty =
    not measured.
    """
    columns = list(dict.fromkeys(key for row in history for key in row))
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns, restval="")
    writer.writeheader()
    writer.writerows({key: f"{value:.6g}" for key, value in row.items()} for row in history)
    with writable(path, CheckpointError):
        write_text(path, text.getvalue())
