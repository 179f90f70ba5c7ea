"""Alignment from a drive alone: simulated pairs with a known error of disparity, and what a run would find of it.

Each seed is a drive of its own: scenarios and errors in turn. The look is that of a run (`find_alignment`): three
segments of 16 frames at most, of undisturbed pictures. `at the axis` compares the offset with its sigma; `in the
image` is the error that the correction leaves, root mean square across the image's width, against the residual that is
added to every sigma of stereo. Both sigmas are claims that the truth judges: 68 % within one, 95 % within two.
"""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace
from collections.abc import Generator, Sequence
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.inputs.simulated_drives import SimulatedDrive
from benchmarks.plain_tables import figure_text, plain_table
from track_range.simulation.camera.faults import Faults
from track_range.stereo.geometry.frames import Frame
from track_range.video.auto_alignment import find_alignment

SCENARIOS = ("town", "highway", "city", "cut-in")
OFFSETS_PX = (0.0, 0.3, -0.5, 0.8, 0.3, -0.5, 0.0, -0.2)
"""By how much disparities are larger than the rig tells."""

SEEDS = tuple(range(240, 252))
SECONDS = 4.9
"""As much as a run looks at of a drive that moves."""

JUDGED = ("median_px", "worst_px", "bias_px", "median_sigma_px", "within_1_sigma", "within_2_sigma")


def add_options(parser: ArgumentParser) -> None:
    """Options of the workload."""
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, metavar="N", help="each is a drive")


def measure(options: Namespace) -> dict[str, Any]:
    """Errors and claims of each drive and of all together."""
    drives = [_drive(seed) for seed in options.seeds]
    told = [row for row in drives if row["is_told"]]
    every: dict[str, Any] = {
        "drives": len(drives),
        "told": len(told),
        "axis": _judged(told, "error_px", "sigma_px"),
        "image": _judged(told, "left_px", "residual_px"),
    }
    _tell(drives, every)
    return {"drives": drives, "all": every}


def _drive(seed: int) -> dict[str, Any]:
    scenario, offset_px = SCENARIOS[seed % len(SCENARIOS)], OFFSETS_PX[seed % len(OFFSETS_PX)]
    drive = SimulatedDrive.of(scenario, seed=seed, seconds=SECONDS, faults=Faults(disparity_offset_px=offset_px))
    frames = drive.frames()
    began_s = time.process_time()
    found = find_alignment("auto", drive.renderer.rig, _shown(frames)).measured
    look_s = time.process_time() - began_s
    u = np.linspace(-1.0, 1.0, 101)
    left_px = offset_px + found.offset_px + found.bow_px * u**2
    return {
        "seed": seed,
        "scenario": scenario,
        "offset_px": offset_px,
        "is_told": found.is_measured,
        "found_px": -found.offset_px,
        "bow_px": -found.bow_px,
        "error_px": -(offset_px + found.offset_px),
        "sigma_px": found.offset_sigma_px,
        "left_px": float(np.sqrt((left_px**2).mean())),
        "residual_px": found.residual_px,
        "look_s": look_s,
    }


def _shown(frames: Sequence[Frame]) -> Generator[Frame, None, None]:
    yield from frames


def _judged(rows: Sequence[dict[str, Any]], error: str, sigma: str) -> dict[str, float | None]:
    if not rows:
        return dict.fromkeys(JUDGED)
    errors_px, sigmas_px = (np.array([row[key] for row in rows]) for key in (error, sigma))
    in_sigmas = np.abs(errors_px) / sigmas_px
    figures = (
        np.median(np.abs(errors_px)),
        np.abs(errors_px).max(),
        errors_px.mean(),
        np.median(sigmas_px),
        (in_sigmas <= 1).mean(),
        (in_sigmas <= 2).mean(),
    )
    return dict(zip(JUDGED, map(float, figures), strict=True))


def _tell(drives: Sequence[dict[str, Any]], every: dict[str, Any]) -> None:
    keys = ("offset_px", "found_px", "bow_px", "error_px", "sigma_px", "left_px", "residual_px", "look_s")
    headings = ("simulated", "found", "bow", "error", "sigma", "left", "residual", "look, s")
    table = plain_table("disparities too large by, px", "seed", "scenario", *headings, n_words=2)
    for row in drives:
        cells = (row[key] if row["is_told"] or key in ("offset_px", "look_s") else None for key in keys)
        table.add_row(str(row["seed"]), row["scenario"], *map(figure_text, cells))
    judged = plain_table("all that tell, px", "", "median", "worst", "bias", "claimed", "1 sigma %", "2 sigma %")
    for name, key in (("at the axis", "axis"), ("in the image", "image")):
        *errors_px, once, twice = every[key].values()
        shares = (figure_text(share, digits=0, times=100) for share in (once, twice))
        judged.add_row(name, *(figure_text(value, digits=3) for value in errors_px), *shares)
    Console().print(table, judged, f"{every['told']} of {every['drives']} drives tell something")
