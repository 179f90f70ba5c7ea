"""Collision warnings: lead times, false alarms, closing speeds and probabilities, on simulated and real drives.

Parts (`--only`):
    rendered   drives of Euro NCAP's shapes and their twins with the packaged detector, stereo and one camera
    hours      hours of harmless driving without images, with the errors of `benchmarks/boxes`
    curve      false alarms per hour against the lead time for mono, stereo and fused; a threshold for each point
    real       warnings on recordings (`TRACK_RANGE_DATA`), where there is no collision
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.accuracy.collision_warnings.box_hours import (
    HARMLESS as HARMLESS_HOURS,
)
from benchmarks.accuracy.collision_warnings.box_hours import (
    METHODS,
    N_ERRORS,
    THRESHOLDS,
    SceneFigures,
    alarm_figures,
    closing_figures,
    drive_figures,
    reliability,
)
from benchmarks.accuracy.collision_warnings.curve_figure import draw_curve, draw_reliability, write_curve
from benchmarks.accuracy.collision_warnings.rendered import is_collision, is_in_time, real_warnings, rendered_figures
from benchmarks.accuracy.collision_warnings.scene_drives import HARMLESS_S, scene_drives
from benchmarks.accuracy.collision_warnings.stored_results import StoredResults
from benchmarks.inputs.conflict_drives import COLLISIONS, HARMLESS, default_cache
from benchmarks.inputs.drives import REAL_DATA
from benchmarks.plain_tables import plain_table

PARTS = ("rendered", "hours", "curve", "real")
"""Parts of the benchmark."""

SEEDS = tuple(range(100, 107))
"""Seeds of the rendered drives; thresholds are tuned on seeds below 100."""

LEAD_S = 2.1
"""Smallest lead of a hit, s: time to react and to brake to a standstill from 50 km/h, as in ISO 15623."""

DASHCAM_FOCAL_PX = 1150.0
"""Focal length of the dashcam clips, px: assumed, for an angle of view of about 58 degrees at 1280 px."""

N_COLLISION_SEEDS = 8
"""Number of scenes of each collision scenario without images."""

BOX_COLLISIONS = tuple(name for name in COLLISIONS if name != "cut-in")
"""Collision scenarios of the curve: those in which the contact happens."""


def add_options(parser: ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument("--only", nargs="+", default=list(PARTS), choices=PARTS, help="parts to measure")
    parser.add_argument("--cache", type=Path, default=default_cache(), metavar="DIR", help="folder of rendered drives")
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=list(SEEDS), metavar="N", help="seeds of rendered drives"
    )
    parser.add_argument("--width", type=int, default=1240, metavar="PX", help="width of rendered images")
    parser.add_argument("--hours", type=float, default=10.0, metavar="H", help="hours of harmless driving")
    parser.add_argument("--first-seed", type=int, default=100, metavar="N", help="first seed of drives without images")
    parser.add_argument(
        "--errors", type=int, default=N_ERRORS, metavar="N", help="drives with different errors per scene"
    )
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="number of processes")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="SVG file for the curve")
    parser.add_argument("--reliability-figure", type=Path, metavar="FILE", help="SVG file for the reliability diagram")
    parser.add_argument("--report-curve", type=Path, metavar="FILE", help="JSON file of the curve for the report")
    parser.add_argument(
        "--parts",
        type=Path,
        metavar="FILE",
        help="file of finished cases, from which an interrupted benchmark continues",
    )


def measure(options: Namespace) -> dict[str, Any]:
    """Figures of the selected parts; prints their tables."""
    options.stored = StoredResults(options.parts)
    functions = {"rendered": _rendered, "hours": _hours, "curve": _curve, "real": _real}
    return {part: functions[part](options) for part in PARTS if part in options.only}


def _rendered(options: Namespace) -> dict[str, Any]:
    """Hits with `LEAD_S` and false alarms by scenario, for stereo and one camera."""
    figures: dict[str, Any] = {}
    table = plain_table(
        f"rendered drives: first warning at least {LEAD_S} s before the contact", "scenario", "stereo", "mono"
    )
    for mode in ("stereo", "mono"):
        measured = partial(_rendered_drive, options.cache, mode == "stereo", options.width)
        cases = [(name, seed) for name in (*COLLISIONS, *HARMLESS) for seed in options.seeds]
        label = f"rendered {mode} {options.width}"
        drives = list(options.stored.mapped(label, measured, cases, options.jobs))
        figures[mode] = {
            "by_scenario": {
                name: _scenario_figures([drive for drive in drives if drive["scenario"] == name])
                for name in (*COLLISIONS, *HARMLESS)
            },
            "closing": closing_figures(
                np.concatenate([np.array(drive["closing"], np.float64).reshape(-1, 5) for drive in drives])
            ),
        }
    for name in (*COLLISIONS, *HARMLESS):
        table.add_row(name, *(_summary(name, figures[mode]["by_scenario"][name]) for mode in ("stereo", "mono")))
    Console().print(table)
    _print_closing({mode: figures[mode]["closing"] for mode in figures})
    return figures


def _rendered_drive(cache: Path, is_stereo: bool, width_px: int, case: tuple[str, int]) -> dict[str, Any]:
    return rendered_figures(cache, *case, is_stereo=is_stereo, width_px=width_px)


def _scenario_figures(drives: Sequence[dict[str, Any]]) -> dict[str, Any]:
    leads = [row["lead_s"] for drive in drives for row in drive["contacts"]]
    return {
        "drives": len(drives),
        "hits": sum(is_in_time(drive, LEAD_S) for drive in drives),
        "leads_s": leads,
        "false_alarms": sum(len(drive["false_warnings"]) for drive in drives),
        "false_warnings": [{"seed": drive["seed"], **row} for drive in drives for row in drive["false_warnings"]],
    }


def _summary(scenario: str, figures: dict[str, Any]) -> str:
    false = f"{figures['false_alarms']} false alarms"
    return f"{figures['hits']} of {figures['drives']}, {false}" if is_collision(scenario) else false


def _hours(options: Namespace) -> dict[str, Any]:
    """False alarms per hour of harmless driving."""
    n_scenes = int(np.ceil(options.hours * 3600 / HARMLESS_S / options.errors / len(HARMLESS_HOURS)))
    cases = [(name, options.first_seed + k) for k in range(n_scenes) for name in HARMLESS_HOURS]
    scenes = _scenes(options, cases, ("fused", "mono"), ())
    figures = {methods: alarm_figures(scenes[methods]) for methods in scenes}
    table = plain_table("harmless driving without images", "methods", "hours", "false alarms", "per hour")
    for name, row in figures.items():
        table.add_row(name, f"{row['hours']:.1f}", str(row["false_alarms"]), f"{row['false_alarms_per_hour']:.2f}")
    Console().print(table)
    return figures


def _scenes(
    options: Namespace, cases: Sequence[tuple[str, int]], methods: Sequence[str], thresholds: Sequence[float]
) -> dict[str, list[SceneFigures]]:
    """Figures of the scenes of all cases by method."""
    label = f"{'+'.join(methods)} x{options.errors} {','.join(map(str, thresholds))}"
    measured = partial(_box_drives, methods, options.errors, thresholds)
    results = list(options.stored.mapped(label, measured, cases, options.jobs))
    return {name: [SceneFigures.of_json(result[name]) for result in results] for name in methods}


def _curve(options: Namespace) -> dict[str, Any]:
    """False alarms per hour and lead times for each threshold; closing speeds and reliability at the default one."""
    cases = [(name, options.first_seed + k) for k in range(N_COLLISION_SEEDS) for name in BOX_COLLISIONS]
    n_harmless = max(round(options.hours * 3600 / HARMLESS_S / options.errors / len(HARMLESS_HOURS)), 1)
    cases += [(name, options.first_seed + k) for k in range(n_harmless) for name in HARMLESS_HOURS]
    by_method = _scenes(options, cases, tuple(METHODS), THRESHOLDS)
    figures: dict[str, Any] = {}
    for methods, scenes in by_method.items():
        figures[methods] = {
            "points": [
                {"threshold": threshold, **_point(scenes, number)} for number, threshold in enumerate(THRESHOLDS)
            ],
            "default": _point(scenes, len(THRESHOLDS)),
            "closing": closing_figures(np.concatenate([scene.closing for scene in scenes])),
            "reliability": reliability(np.sum([scene.probability for scene in scenes], axis=0)),
        }
    table = plain_table(
        "threshold: false alarms per hour / median lead, s / % warned 2.1 s before", "threshold", *METHODS
    )
    for number, threshold in enumerate((*THRESHOLDS, "default")):
        rows = [(part["points"][number] if threshold != "default" else part["default"]) for part in figures.values()]
        table.add_row(str(threshold), *(_point_text(row) for row in rows))
    Console().print(table)
    _print_closing({methods: figures[methods]["closing"] for methods in METHODS})
    _print_reliability({methods: figures[methods]["reliability"] for methods in METHODS})
    if options.figure:
        draw_curve(figures, options.figure, lead_s=LEAD_S)
    if options.reliability_figure:
        draw_reliability(figures, options.reliability_figure)
    if options.report_curve:
        row = figures["fused"]["default"]
        protocol = (
            f"Simulated drives: {row['hours']:g} h of harmless driving in {len(HARMLESS_HOURS)} scenarios and "
            f"{row['contacts']} drives that end in a contact, with the errors of the packaged detector and of stereo."
        )
        write_curve(options.report_curve, figures, protocol)
    return figures


def _point_text(row: dict[str, Any]) -> str:
    return f"{row['false_alarms_per_hour']} / {row['median_lead_s']} / {100 * row['fraction_with_2_1_s']:.0f}"


def _point(scenes: Sequence[SceneFigures], number: int) -> dict[str, Any]:
    """Lead times on collisions, and false alarms of harmless drives, of one threshold."""
    hits = alarm_figures([scene for scene in scenes if scene.scenario in BOX_COLLISIONS], number)
    false = alarm_figures([scene for scene in scenes if scene.scenario not in BOX_COLLISIONS], number)
    return {
        **{name: hits[name] for name in ("contacts", "median_lead_s", "lead_10_pct_s", "fraction_with_2_1_s")},
        **{name: false[name] for name in ("hours", "false_alarms", "false_alarms_per_hour")},
    }


def _box_drives(
    methods: Sequence[str], n_errors: int, thresholds: Sequence[float], case: tuple[str, int]
) -> dict[str, Any]:
    """Figures of the drives of one scene by method; the drives and their tracks are computed once."""
    scene = scene_drives(*case, n_errors)
    return {name: asdict(drive_figures(scene, methods=name, thresholds=thresholds)) for name in methods}


def _real(options: Namespace) -> dict[str, Any]:
    """Warnings on recordings without collisions."""
    figures: dict[str, Any] = {}
    for name in ("0003", "0005"):
        folder = REAL_DATA / "kitti_stereo" / name
        if folder.is_dir():
            events = real_warnings(videos=(folder / "left.mp4", folder / "right.mp4"))
            figures[f"KITTI {name}"] = [f"{event.kind} at {event.warning_s:.1f} s" for event in events]
    for path in sorted((REAL_DATA / "dashcam").glob("*.mp4")):
        events = real_warnings(videos=(path,), focal_px=DASHCAM_FOCAL_PX)
        figures[path.stem] = [f"{event.kind} at {event.warning_s:.1f} s" for event in events]
    table = plain_table("real drives", "recording", "warnings")
    for name, warnings in figures.items():
        table.add_row(name, ", ".join(warnings) or "none")
    Console().print(table)
    return figures


def _print_closing(by_method: dict[str, dict[str, dict[str, Any]]]) -> None:
    table = plain_table("closing speed at 10-40 m: median absolute error, m/s", "class", *by_method)
    for name in dict.fromkeys(name for figures in by_method.values() for name in figures):
        cells = [figures[name]["median_abs_mps"] if name in figures else None for figures in by_method.values()]
        table.add_row(name, *("-" if cell is None else f"{cell:.2f}" for cell in cells))
    Console().print(table)


def _print_reliability(by_method: dict[str, dict[str, Any]]) -> None:
    table = plain_table("probability of contact: predicted, observed (tracks and frames)", "bin", *by_method)
    for number in range(max(len(part["bins"]) for part in by_method.values())):
        bins = [part["bins"][number] if number < len(part["bins"]) else None for part in by_method.values()]
        table.add_row(
            str(number + 1),
            *("-" if row is None else f"{row['predicted']:.2f}, {row['observed']:.2f} ({row['n']})" for row in bins),
        )
    for name, title in (("error_below_0.1", "error below 0.1"), ("error_above_0.1", "error above 0.1")):
        values = [part[name] for part in by_method.values()]
        table.add_row(title, *("-" if value is None else f"{value:.3f}" for value in values))
    Console().print(table)
