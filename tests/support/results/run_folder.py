"""The folder of a run with a car whose distance is known."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import yaml

from track_range.results.rows.columns import column_names

N_FRAMES = 6


def write_run(folder: Path, **run: Any) -> Path:
    """A run with a static car 20 m ahead and 4 m long: its rear is at 18 m, and fused measures 18.9
    m, 5 % too much."""
    folder.mkdir(parents=True)
    (folder / "truth.txt").write_text(
        "".join(
            f"{frame} 1 Car 0 0 0 280 140 360 220 1.5 1.7 4.0 0.0 0.75 20.0 {-math.pi / 2:.8f}\n"
            for frame in range(N_FRAMES)
        )
    )
    with (folder / "tracks.csv").open("w", newline="") as file:
        rows = csv.DictWriter(file, column_names(), restval="")
        rows.writeheader()
        for frame in range(N_FRAMES):
            box = {"x1_px": 280, "y1_px": 140, "x2_px": 360, "y2_px": 220}
            ranged = {"fused_m": 18.9, "fused_sigma_m": 0.5}
            time = {"frame": frame, "time_s": frame / 10}
            rows.writerow(
                {
                    **time,
                    "track_id": 1,
                    "class": "car",
                    "score": 0.9,
                    "observed": 1,
                    **box,
                    **ranged,
                }
            )
    settings = {
        "track_range_settings": 1,
        "run": {
            "mono": "drive.mp4",
            "truth": str(folder / "truth.txt"),
            "out": str(folder),
            "classes": [],
            **run,
        },
        "found": {
            "rig": None,
            "focal_px": 1000.0,
            "principal_point_px": [320.0, 180.0],
            "image_size_px": [640, 360],
            "versions": {"numpy": "2"},
        },
    }
    (folder / "settings.yaml").write_text(yaml.safe_dump(settings))
    (folder / "overlay.mp4").write_bytes(b"a film")
    summary = {
        "frames": 9,
        "methods": {},
        "files": {"overlay": "overlay.mp4"},
        "notes": ["a note"],
        "truth": "t",
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder
