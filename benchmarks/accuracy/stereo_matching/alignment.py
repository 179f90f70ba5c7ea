"""Alignment from a drive: estimated disparity corrections of simulated pairs with a known disparity error.

Each seed is a separate drive; scenarios and disparity errors alternate. The alignment is estimated as in a run
(`find_alignment`), from at most three segments of 16 frames without image noise. `at the axis` compares the error of
the offset with its sigma; `in the image` compares the error after correction, root mean square across the image width,
with the residual that is added to every sigma of stereo. For calibrated sigmas 68 % of the errors are within one, 95 %
within two.
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
from track_range.recording.pairs.auto_alignment import find_alignment
from track_range.simulation.settings import Faults
from track_range.stereo.geometry.frames import Frame

SCENARIOS = ("town", "highway", "city", "cut-in")
"""Scenarios of the drives, by seed."""

OFFSETS_PX = (0.0, 0.3, -0.5, 0.8, 0.3, -0.5, 0.0, -0.2)
"""Disparity errors in px of the simulated pairs, by seed; positive = disparities are too large."""

SEEDS = tuple(range(240, 252))
"""Default seeds, which no test uses."""

SECONDS = 4.9
"""Length in s of a drive, the time that a run uses for the alignment."""

FIGURES = ("median_px", "worst_px", "bias_px", "median_sigma_px", "within_1_sigma", "within_2_sigma")
"""Figures of errors relative to their sigmas."""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS, metavar="N", help="random seeds, one per drive")


def measure(options: Namespace) -> dict[str, Any]:
    """Errors and sigmas of each drive and of all drives; prints the tables."""
    drives = [_drive(seed) for seed in options.seeds]
    measured = [row for row in drives if row["is_measured"]]
    total: dict[str, Any] = {
        "drives": len(drives),
        "measured": len(measured),
        "axis": _figures(measured, "error_px", "sigma_px"),
        "image": _figures(measured, "remaining_px", "residual_px"),
    }
    _print_table(drives, total)
    return {"drives": drives, "all": total}


def _drive(seed: int) -> dict[str, Any]:
    scenario, offset_px = SCENARIOS[seed % len(SCENARIOS)], OFFSETS_PX[seed % len(OFFSETS_PX)]
    drive = SimulatedDrive.of(scenario, seed=seed, seconds=SECONDS, faults=Faults(disparity_offset_px=offset_px))
    frames = drive.frames()
    start_s = time.process_time()
    alignment = find_alignment("auto", drive.renderer.rig, _generator(frames)).measured
    alignment_s = time.process_time() - start_s
    u = np.linspace(-1.0, 1.0, 101)
    remaining_px = offset_px + alignment.error_px(u)
    return {
        "seed": seed,
        "scenario": scenario,
        "offset_px": offset_px,
        "is_measured": alignment.is_measured,
        "estimate_px": -alignment.offset_px,
        "curvature_px": -alignment.curvature_px,
        "error_px": -(offset_px + alignment.offset_px),
        "sigma_px": alignment.offset_sigma_px,
        "remaining_px": float(np.sqrt((remaining_px**2).mean())),
        "residual_px": alignment.residual_px,
        "alignment_s": alignment_s,
    }


def _generator(frames: Sequence[Frame]) -> Generator[Frame, None, None]:
    yield from frames


def _figures(rows: Sequence[dict[str, Any]], error: str, sigma: str) -> dict[str, float | None]:
    """`FIGURES` of the errors and sigmas under two keys of the rows; None = no rows."""
    if not rows:
        return dict.fromkeys(FIGURES)
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
    return dict(zip(FIGURES, map(float, figures), strict=True))


def _print_table(drives: Sequence[dict[str, Any]], total: dict[str, Any]) -> None:
    keys = (
        *("offset_px", "estimate_px", "curvature_px", "error_px", "sigma_px"),
        *("remaining_px", "residual_px", "alignment_s"),
    )
    headings = ("simulated", "estimate", "curvature", "error", "sigma", "remaining", "residual", "time, s")
    table = plain_table("disparity error, px", "seed", "scenario", *headings, n_words=2)
    for row in drives:
        cells = (row[key] if row["is_measured"] or key in ("offset_px", "alignment_s") else None for key in keys)
        table.add_row(str(row["seed"]), row["scenario"], *map(figure_text, cells))
    summary = plain_table(
        "drives with an estimate, px", "", "median", "worst", "bias", "sigma", "1 sigma %", "2 sigma %"
    )
    for name, key in (("at the axis", "axis"), ("in the image", "image")):
        *errors_px, once, twice = total[key].values()
        fractions = (figure_text(fraction, digits=0, times=100) for fraction in (once, twice))
        summary.add_row(name, *(figure_text(value, digits=3) for value in errors_px), *fractions)
    Console().print(table, summary, f"{total['measured']} of {total['drives']} drives give an estimate")
