"""Lookup of models by name or path: the user's files, packaged models, and models in the
catalogue.
"""

import difflib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

from track_range.detection.catalogue.entries import CATALOGUE, CatalogueEntry, entry_named
from track_range.detection.models.onnx_session import ModelError
from track_range.foundation.files.cache_folder import cache_folder
from track_range.foundation.files.input_files import shortened

# of the models that are part of track-range
PACKAGED_FOLDER = Path(__file__).parents[1] / "weights"
DEFAULT_MODEL = "road"  # the packaged detector of road users
# of paths, not names
_FILE_SUFFIXES = frozenset({".onnx", ".weights", ".cfg", ".pt", ".pth", ".engine", ".tflite"})
Origin = Literal["file", "packaged", "cached", "catalogue"]


@dataclass(frozen=True, slots=True)
class ModelLocation:
    """Result of `find_model`."""

    path: Path  # the ONNX file; with origin "catalogue", where `pull` will put it
    # user's file, packaged with track-range, in the cache folder, or to be downloaded
    origin: Origin
    entry: CatalogueEntry | None  # the catalogue entry with that name; None if there is none


class ModelRow(NamedTuple):
    """One row of the table of `track-range models list`; '' = unknown."""

    name: str
    input: str
    size: str
    licence: str
    source: str
    state: str


def models_folder() -> Path:
    """Folder of downloaded models: $TRACK_RANGE_CACHE/models, else in the cache folder; ModelError
    without a home.
    """
    folder = cache_folder()
    if folder is None:
        raise ModelError(
            "there is no home folder for downloaded models; set TRACK_RANGE_CACHE to a folder."
        )
    return folder / "models"


def find_model(
    name_or_path: str | Path, *, cache: Path | None = None, packaged: Path = PACKAGED_FOLDER
) -> ModelLocation:
    """The model of `--detector NAME`: an existing file, else a packaged, cached or catalogue model,
    in that order.

    `cache` is the folder of downloaded models, by default `models_folder()`. ModelError, with
    similar names, if there is no such model.
    """
    text, path = str(name_or_path), Path(name_or_path)
    if os.path.isfile(path):  # unlike Path.is_file, False for a name that is too long
        return ModelLocation(path, "file", None)
    if path.name != text or path.suffix.lower() in _FILE_SUFFIXES:
        raise ModelError(
            f"{path}: no such model file; `track-range models list` lists the models that can be "
            "downloaded."
        )
    entry = entry_named(text)
    name = text.strip() if entry is None else entry.name
    folders: tuple[tuple[Path, Origin], ...] = (
        (packaged, "packaged"),
        (cache or models_folder(), "cached"),
    )
    for folder, origin in folders:
        if os.path.isfile(model := folder / f"{name}.onnx"):
            return ModelLocation(model, origin, entry)
    if entry is None:
        known = list(
            dict.fromkeys(
                [*_names_in(folder for folder, _ in folders), *(e.name for e in CATALOGUE)]
            )
        )
        near = difflib.get_close_matches(text[:60].lower(), known, n=2, cutoff=0.5)
        hint = (
            f"did you mean {' or '.join(near)}?" if near else f"known models: {', '.join(known)}."
        )
        raise ModelError(
            f"{shortened(text)}: there is no model file or model of this name; {hint} See "
            "`track-range models list`."
        )
    return ModelLocation(model, "catalogue", entry)


def model_rows(*, cache: Path | None = None, packaged: Path = PACKAGED_FOLDER) -> list[ModelRow]:
    """Rows of all models that `--detector NAME` accepts: packaged, catalogue, and other models in
    the cache folder.
    """
    folder = cache or models_folder()
    rows = []
    for name in _names_in([packaged]):  # the README in the folder is the model card
        size = f"{(packaged / f'{name}.onnx').stat().st_size / 1e6:.1f} MB"
        rows.append(ModelRow(name, "variable", size, "Apache-2.0", "track-range", "packaged"))
    for entry in CATALOGUE:
        state = "downloaded" if (folder / f"{entry.name}.onnx").is_file() else "not downloaded"
        size = f"{entry.size_bytes / 1e6:.1f} MB"
        rows.append(
            ModelRow(entry.name, entry.input, size, entry.licence.name, entry.project, state)
        )
    known = {entry.name for entry in CATALOGUE}
    others = (name for name in _names_in([folder]) if name not in known)
    return [*rows, *(ModelRow(name, "", "", "", "", "in the cache folder") for name in others)]


def _names_in(folders: Iterable[Path]) -> list[str]:
    """Names without suffix of the ONNX files in the folders, without duplicates; folders may be
    missing.
    """
    return list(
        dict.fromkeys(file.stem for folder in folders for file in sorted(folder.glob("*.onnx")))
    )
