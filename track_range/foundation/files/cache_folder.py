"""Cache folder of track-range: the only place outside a run's output folder that is written to."""

import os
from pathlib import Path

from platformdirs import user_cache_path


def cache_folder() -> Path | None:
    """Folder of files that can be created again: $TRACK_RANGE_CACHE, else `track-range` in the
    platform's caches.

    None = the user has no home folder. The folder may not exist yet.
    """
    try:
        if given := os.environ.get("TRACK_RANGE_CACHE"):
            return Path(given).expanduser()
        folder = user_cache_path("track-range", appauthor=False, opinion=False)
    except RuntimeError:
        return None
    return folder if folder.is_absolute() else None  # without a home folder, "~" stays in the path


def set_matplotlib_folder() -> None:
    """Store matplotlib's list of fonts in our cache, unless MPLCONFIGDIR is set; call before its
    import.
    """
    if folder := cache_folder():
        os.environ.setdefault("MPLCONFIGDIR", str(folder / "matplotlib"))
