"""Writes track_range/run/option_types.py, the types of the keyword arguments of `Run` and
`Pipeline`.

python .ci/run_options.py [--check]
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic.fields import FieldInfo

from track_range.foundation.schemas.options import choices_of, is_file, is_list, value_type
from track_range.run.options.settings import PipelineOptions, RunSettings

FILE = Path(__file__).parents[1] / "track_range/run/option_types.py"

HEAD = '''"""Keyword arguments of `Run` and `Pipeline`, for type checkers.

Written by `.ci/run_options.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict

if TYPE_CHECKING:
    from rich.console import Console

    from track_range.detection.detector import ObjectDetector
    from track_range.stereo.geometry.mounting import Mounting
    from track_range.stereo.geometry.rig import StereoRig
    from track_range.tracking.registry import ObjectTracker


class PipelineKeywords(TypedDict, total=False):
    """Options of detection, tracking and ranging by keyword; None = not given."""

'''

RUN_HEAD = '''

class RunKeywords(PipelineKeywords, total=False):
    """Options of a run by keyword; None = not given."""

'''

ALSO = {
    "detector": "ObjectDetector",
    "tracker": "ObjectTracker",
    "min_score": "float",
    "size": "int",
    "size_px": "int",
    "ego_speed": "float",
    "names": "Sequence[str]",
    "mount": "Mounting",
    "rig": "StereoRig",
}
"""What else Python gives for an option."""


def main() -> None:
    """Write the file, or exit with an error if it differs."""
    types = {
        keyword: _type(name)
        for keyword, name in RunSettings.keywords().items()
        if name not in ("mono", "stereo")
    }
    lines = {
        keyword: f"    {keyword}: {kind}\n"
        for keyword, kind in {**types, "progress": "bool | Console"}.items()
    }
    shared = [
        keyword for keyword in PipelineOptions.keywords() if keyword not in ("align", "detections")
    ]
    of_run = [keyword for keyword in lines if keyword not in shared]
    text = "".join(
        [HEAD, *(lines[name] for name in shared), RUN_HEAD, *(lines[name] for name in of_run)]
    )
    ruff = [sys.executable, "-m", "ruff", "format", "--line-length", "100", "-"]
    text = subprocess.run(ruff, input=text, capture_output=True, text=True, check=True).stdout
    if "--check" not in sys.argv:
        FILE.write_text(text, encoding="utf-8")
    elif text != FILE.read_text(encoding="utf-8"):
        raise SystemExit(
            f"{FILE}: differs from the options of RunSettings; run `python .ci/run_options.py`."
        )


def _type(name: str) -> str:
    """Type of the values of an option."""
    field = RunSettings.model_fields[name]
    kinds = [_kind(field), ALSO.get(name, ""), "None"]
    return " | ".join(kind for kind in kinds if kind)


def _kind(field: FieldInfo) -> str:
    kind: Any = value_type(field)
    if choices := choices_of(field):
        return f"Literal[{', '.join(map(json.dumps, choices))}]"
    if is_file(field):
        return "str | Path | Sequence[str | Path]" if is_list(field) else "str | Path"
    if is_list(field):
        return f"str | Sequence[{get_args(kind)[0].__name__}]"
    return "Mapping[str, Any]" if get_origin(kind) is dict else str(kind.__name__)


if __name__ == "__main__":
    main()
