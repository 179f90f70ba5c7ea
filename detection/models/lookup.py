"""Which model a word means, and where models live: the user's own files, those packaged here, those downloaded."""

from __future__ import annotations

import difflib
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from track_range.detection.models.catalogue import CATALOGUE, CatalogueEntry, entry_named
from track_range.detection.models.onnx_session import ModelError

PACKAGED_FOLDER = Path(__file__).parents[1] / "weights"
"""Models that come with track-range itself."""

DEFAULT_MODEL = "road"
"""The packaged detector of road users that is taken where none is named."""

_FILE_SUFFIXES = frozenset({".onnx", ".weights", ".cfg", ".pt", ".pth", ".engine", ".tflite"})

Origin = Literal["file", "packaged", "cached", "catalogue"]


@dataclass(frozen=True, slots=True)
class FoundModel:
    """Which model a word stands for.

    Attributes:
        path: the ONNX file; with origin "catalogue" it is not there yet, but will be once pulled.
        origin: the user's own file, packaged with track-range, in the cache folder, or to be downloaded.
        entry: the catalogue's entry of that name; None = it has none, as a user's own file has none.
    """

    path: Path
    origin: Origin
    entry: CatalogueEntry | None


@dataclass(frozen=True, slots=True)
class ModelRow:
    """One line of `track-range models list`, in words; '' = nothing to say."""

    name: str
    input: str
    size: str
    licence: str
    source: str
    state: str


def models_folder(environ: Mapping[str, str] = os.environ, *, platform: str = sys.platform) -> Path:
    """Where downloaded models live: `models` in $TRACK_RANGE_CACHE, else in the platform's folder for caches.

    Raises:
        ModelError: the user has no home folder.
    """
    if own := environ.get("TRACK_RANGE_CACHE"):
        return Path(own).expanduser() / "models"
    xdg, local = environ.get("XDG_CACHE_HOME", ""), environ.get("LOCALAPPDATA", "")
    if platform == "win32":
        caches = Path(local) if local else _home() / "AppData" / "Local"
    elif platform == "darwin":
        caches = _home() / "Library" / "Caches"
    else:  # the XDG specification: a relative path is to be ignored
        caches = Path(xdg) if Path(xdg).is_absolute() else _home() / ".cache"
    return caches / "track-range" / "models"


def _home() -> Path:
    try:
        return Path.home()
    except RuntimeError as error:
        raise ModelError("no home folder to keep models in: set TRACK_RANGE_CACHE to a folder.") from error


def find_model(name_or_path: str | Path, *, cache: Path | None = None, packaged: Path = PACKAGED_FOLDER) -> FoundModel:
    """What `--detector WORD` means: an existing file, else a packaged, a cached or a catalogue model, in that order.

    Args:
        name_or_path: as the user writes it.
        cache: folder of downloaded models; None = `models_folder()`.
        packaged: folder of the models that come with track-range.

    Raises:
        ModelError: nothing has that name; the message says which names come near.
    """
    word, path = str(name_or_path), Path(name_or_path)
    if path.is_file():
        return FoundModel(path, "file", None)
    if path.name != word or path.suffix.lower() in _FILE_SUFFIXES:
        raise ModelError(_no_such_file(path))
    entry = entry_named(word)
    name = word.strip() if entry is None else entry.name
    folders: tuple[tuple[Path, Origin], ...] = ((packaged, "packaged"), (cache or models_folder(), "cached"))
    for folder, origin in folders:
        if (model := folder / f"{name}.onnx").is_file():
            return FoundModel(model, origin, entry)
    if entry is None:
        raise ModelError(_no_such_name(word, _names_in(folder for folder, _ in folders)))
    return FoundModel(model, "catalogue", entry)


def model_rows(*, cache: Path | None = None, packaged: Path = PACKAGED_FOLDER) -> list[ModelRow]:
    """Everything that `--detector NAME` can name: packaged, catalogued, and what else lies in the cache folder."""
    folder = cache or models_folder()
    rows = [_packaged_row(packaged / f"{name}.onnx") for name in _names_in([packaged])]
    for entry in CATALOGUE:
        state = "here" if (folder / f"{entry.name}.onnx").is_file() else "to be fetched"
        size = f"{entry.size_bytes / 1e6:.1f} MB"
        rows.append(ModelRow(entry.name, entry.input, size, entry.licence.name, entry.project, state))
    known = {entry.name for entry in CATALOGUE}
    return rows + [_row_of_file(name, "in the cache folder") for name in _names_in([folder]) if name not in known]


def _packaged_row(file: Path) -> ModelRow:
    """A model of our own: its card is the README beside it."""
    size = f"{file.stat().st_size / 1e6:.1f} MB"
    return ModelRow(file.stem, "open", size, "Apache-2.0", "track-range", "packaged")


def _row_of_file(name: str, state: str) -> ModelRow:
    return ModelRow(name, "", "", "", "", state)


def _names_in(folders: Iterable[Path]) -> list[str]:
    """Names of the ONNX files in the folders, in order, each once; a folder may be absent."""
    return list(dict.fromkeys(file.stem for folder in folders for file in sorted(folder.glob("*.onnx"))))


def _no_such_file(path: Path) -> str:
    return f"{path}: no such model file; `track-range models list` names those that can be fetched."


def _no_such_name(word: str, there: Sequence[str]) -> str:
    names = list(dict.fromkeys([*there, *(entry.name for entry in CATALOGUE)]))
    near = difflib.get_close_matches(word.lower(), names, n=2, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(names)}."
    return f"{word}: no such model file, and no model of that name: {hint} See `track-range models list`."
