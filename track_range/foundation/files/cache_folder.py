"""Cache folder of track-range: the only place outside of a run's output folder that is written to."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from pathlib import Path


def cache_folder(environ: Mapping[str, str] = os.environ, *, platform: str = sys.platform) -> Path | None:
    """Folder of files that can be created again: $TRACK_RANGE_CACHE, else `track-range` in the platform's caches.

    None = the user has no home folder. The folder may not exist yet.
    """
    try:
        if folder := environ.get("TRACK_RANGE_CACHE"):
            return Path(folder).expanduser()
        xdg, local = environ.get("XDG_CACHE_HOME", ""), environ.get("LOCALAPPDATA", "")
        if platform == "win32":
            caches = Path(local) if local else Path.home() / "AppData" / "Local"
        elif platform == "darwin":
            caches = Path.home() / "Library" / "Caches"
        else:  # by the XDG specification, relative paths are ignored
            caches = Path(xdg) if Path(xdg).is_absolute() else Path.home() / ".cache"
    except RuntimeError:
        return None
    return caches / "track-range"


def set_matplotlib_folder() -> None:
    """Make matplotlib store its list of fonts in our cache folder, unless the user has set MPLCONFIGDIR.

    Has to be called before matplotlib is imported.
    """
    if folder := cache_folder():
        os.environ.setdefault("MPLCONFIGDIR", str(folder / "matplotlib"))
