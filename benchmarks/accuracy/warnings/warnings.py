"""Collision warnings: lead times, false alarms, closing speeds and probabilities, on simulated and
real drives.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.warnings.warning_drives import (
    HARMLESS_HOURS,
    HARMLESS_S,
    METHODS,
    N_ERRORS,
    THRESHOLDS,
    SceneFigures,
    alarm_figures,
    closing_figures,
    drive_figures,
    real_warnings,
    reliability,
    rendered_figures,
    scene_drives,
)
from benchmarks.harness import Figures, StoredResults, option, workload
from benchmarks.inputs.drives import CACHE_OPTION, COLLISIONS, HARMLESS, REAL_DATA

PARTS = ("rendered", "hours", "curve", "real")
# seeds of the rendered drives; thresholds are tuned on seeds below 100
SEEDS = tuple(range(100, 107))
# smallest lead of a hit, s: time to react and to brake to a standstill from 50 km/h, as in ISO
# 15623
LEAD_S = 2.1

DASHCAM_FOCAL_PX = 1150.0
"""Focal length of the dashcam clips, px: assumed, for an angle of view of about 58 degrees at 1280
px."""

N_COLLISION_SEEDS = 8  # scenes of each collision scenario without images

BOX_COLLISIONS = tuple(name for name in COLLISIONS if name != "cut-in")
"""Collision scenarios of the curve: those in which the contact happens."""

COLOURS = {"mono": "#cf7410", "stereo": "#1f77b4", "fused": "#2a8c3c"}

TITLES = {"mono": "one camera", "stereo": "two cameras, stereo only", "fused": "two cameras"}
"""Name of each method for users."""

_GREY = "#7a7f87"  # text and axes: readable on light and dark pages
# columns of a point of the curve
COLUMNS = ("false_alarms_per_hour", "median_lead_s", "fraction_with_2_1_s")


@workload(
    option("--only", default=PARTS, choices=PARTS, help="parts to measure"),
    CACHE_OPTION,
    option("--seeds", default=SEEDS, metavar="N", help="seeds of rendered drives"),
    option("--width", default=1240, metavar="PX", help="width of rendered images"),
    option("--hours", default=10.0, metavar="H", help="hours of harmless driving"),
    option(
        "--first-seed",
        "--seed",
        default=100,
        metavar="N",
        help="first seed of drives without images",
    ),
    option(
        "--errors", default=N_ERRORS, metavar="N", help="drives with different errors per scene"
    ),
    option("--jobs", default=1, metavar="N", help="number of processes"),
    option("--figure", type=Path, metavar="FILE", help="SVG file for the curve"),
    option(
        "--reliability-figure",
        type=Path,
        metavar="FILE",
        help="SVG file for the reliability diagram",
    ),
    option(
        "--parts",
        type=Path,
        metavar="FILE",
        help="file of cases, from which an interrupted benchmark continues",
    ),
)
def warnings(options: Namespace) -> Figures:
    options.stored = StoredResults(options.parts)
    functions = {"rendered": _rendered, "hours": _hours, "curve": _curve, "real": _real}
    return {part: functions[part](options) for part in PARTS if part in options.only}


def _rendered(options: Namespace) -> Figures:
    figures: Figures = {}
    for mode in ("stereo", "mono"):
        measured = partial(_rendered_drive, options.cache, mode == "stereo", options.width)
        cases = [(name, seed) for name in (*COLLISIONS, *HARMLESS) for seed in options.seeds]
        drives = list(
            options.stored.mapped(f"rendered {mode} {options.width}", measured, cases, options.jobs)
        )
        figures[mode] = {}
        for name in (*COLLISIONS, *HARMLESS):
            rows = [drive for drive in drives if drive["scenario"] == name]
            leads = [
                [row["lead_s"] for row in drive["contacts"] if row["lead_s"] is not None]
                for drive in rows
            ]
            figures[mode][name] = {
                "drives": len(rows),
                "hits": sum(any(lead_s >= LEAD_S for lead_s in lead) for lead in leads)
                if name in COLLISIONS
                else None,
                "false_alarms": sum(len(drive["false_warnings"]) for drive in rows),
                "leads_s": [row["lead_s"] for drive in rows for row in drive["contacts"]],
                "false_warnings": [
                    {"seed": drive["seed"], **row}
                    for drive in rows
                    for row in drive["false_warnings"]
                ],
            }
        closing = [np.array(drive["closing"], np.float64).reshape(-1, 5) for drive in drives]
        figures[f"closing speed at 10-40 m, {mode}"] = closing_figures(np.concatenate(closing))
    return figures


def _rendered_drive(cache: Path, is_stereo: bool, width_px: int, case: tuple[str, int]) -> Figures:
    return rendered_figures(cache, *case, is_stereo=is_stereo, width_px=width_px)


def _hours(options: Namespace) -> Figures:
    n_scenes = int(
        np.ceil(options.hours * 3600 / HARMLESS_S / options.errors / len(HARMLESS_HOURS))
    )
    cases = [(name, options.first_seed + k) for k in range(n_scenes) for name in HARMLESS_HOURS]
    scenes = _scenes(options, cases, ("fused", "mono"), ())
    return {methods: alarm_figures(scenes[methods]) for methods in scenes}


def _scenes(
    options: Namespace,
    cases: Sequence[tuple[str, int]],
    methods: Sequence[str],
    thresholds: Sequence[float],
) -> dict[str, list[SceneFigures]]:
    label = f"{'+'.join(methods)} x{options.errors} {','.join(map(str, thresholds))}"
    measured = partial(_box_drives, methods, options.errors, thresholds)
    results = list(options.stored.mapped(label, measured, cases, options.jobs))
    return {name: [SceneFigures.of_json(result[name]) for result in results] for name in methods}


def _curve(options: Namespace) -> Figures:
    cases = [
        (name, options.first_seed + k) for k in range(N_COLLISION_SEEDS) for name in BOX_COLLISIONS
    ]
    n_harmless = max(
        round(options.hours * 3600 / HARMLESS_S / options.errors / len(HARMLESS_HOURS)), 1
    )
    cases += [(name, options.first_seed + k) for k in range(n_harmless) for name in HARMLESS_HOURS]
    by_method = _scenes(options, cases, tuple(METHODS), THRESHOLDS)
    figures: Figures = {}
    for methods, scenes in by_method.items():
        figures[methods] = {
            "points": [
                {"threshold": limit, **_point(scenes, number)}
                for number, limit in enumerate(THRESHOLDS)
            ],
            "default": _point(scenes, len(THRESHOLDS)),
            "closing": closing_figures(np.concatenate([scene.closing for scene in scenes])),
            "reliability": reliability(np.sum([scene.probability for scene in scenes], axis=0)),
        }
    if options.figure:
        draw_curve(figures, options.figure, lead_s=LEAD_S)
    if options.reliability_figure:
        draw_reliability(figures, options.reliability_figure)
    return figures


def _point(scenes: Sequence[SceneFigures], number: int) -> Figures:
    """Lead times on collisions, and false alarms of harmless drives, of one threshold."""
    hits = alarm_figures([scene for scene in scenes if scene.scenario in BOX_COLLISIONS], number)
    false = alarm_figures(
        [scene for scene in scenes if scene.scenario not in BOX_COLLISIONS], number
    )
    return {
        **{
            name: hits[name]
            for name in (
                *("contacts", "median_lead_s", "lead_10_pct_s", "fraction_with_2_1_s"),
                "by_scenario",
            )
        },
        **{
            name: false[name]
            for name in (
                *("hours", "false_alarms", "false_alarms_per_hour", "false_alarms_per_hour_95"),
                "false_alarms_by_scenario",
            )
        },
    }


def _box_drives(
    methods: Sequence[str], n_errors: int, thresholds: Sequence[float], case: tuple[str, int]
) -> Figures:
    """Figures of the drives of one scene by method; the drives and their tracks are computed
    once.
    """
    scene = scene_drives(*case, n_errors)
    return {
        name: asdict(drive_figures(scene, methods=name, thresholds=thresholds)) for name in methods
    }


def _real(options: Namespace) -> Figures:
    figures: Figures = {}
    for name in ("0003", "0005"):
        folder = REAL_DATA / "kitti_stereo" / name
        if folder.is_dir():
            figures[f"KITTI {name}"] = real_warnings(
                videos=(folder / "left.mp4", folder / "right.mp4")
            )
    for path in sorted((REAL_DATA / "dashcam").glob("*.mp4")):
        figures[path.stem] = real_warnings(videos=(path,), focal_px=DASHCAM_FOCAL_PX)
    return {
        name: ", ".join(f"{event.kind} at {event.warning_s:.1f} s" for event in events) or "none"
        for name, events in figures.items()
    }


def curve_points(figures: Figures) -> dict[str, list[list[float]]]:
    """[false alarms per hour, median lead in s, fraction warned in time] by method, at rising
    thresholds.
    """
    return {
        methods: [[row[name] for name in COLUMNS] for row in part["points"]]
        for methods, part in figures.items()
    }


def draw_curve(figures: Figures, path: Path, *, lead_s: float) -> None:
    """Draw lead times and the fraction warned in time against false alarms per hour, a point for
    each threshold.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.4, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2)
    points = curve_points(figures)
    for axes, column, factor in ((left, 1, 1.0), (right, 2, 100.0)):
        for methods, rows in points.items():
            x, y = [row[0] for row in rows], [factor * row[column] for row in rows]
            axes.plot(x, y, "o-", ms=3.5, lw=1.8, color=COLOURS[methods], label=TITLES[methods])
            default = [figures[methods]["default"][name] for name in COLUMNS]
            style = {"ms": 9, "mfc": "none", "mew": 1.8, "color": COLOURS[methods]}
            axes.plot([default[0]], [factor * default[column]], "o", **style)
        axes.set_xscale("symlog", linthresh=1, linscale=0.6)
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        axes.set_xlabel("false alarms per hour (circle: default threshold)")
        _in_grey(axes)
    left.set_ylim(0, max(left.get_ylim()[1], 1.2 * lead_s))
    left.axhline(lead_s, color=_GREY, linestyle=":", lw=1)
    left.set_title("Median lead before the contact, s", loc="left", fontsize=10, color=_GREY)
    right.set_title(
        f"Contacts warned at least {lead_s:g} s before, %", loc="left", fontsize=10, color=_GREY
    )
    right.set_ylim(0, 100)
    handles, labels = left.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside upper left",
        ncols=3,
        frameon=False,
        labelcolor=_GREY,
        fontsize=10,
    )
    _save(figure, path)


def draw_reliability(figures: Figures, path: Path) -> None:
    """Draw the observed fraction of contacts against the predicted probability, as SVG without
    background.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.4, 3.9), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], ":", color=_GREY, lw=1)
    for methods, part in figures.items():
        bins = part["reliability"]["bins"]
        x, y = [row["predicted"] for row in bins], [row["observed"] for row in bins]
        axes.plot(x, y, "o-", ms=3.5, lw=1.8, color=COLOURS[methods], label=TITLES[methods])
    axes.set_xlabel("probability of contact")
    axes.set_title("Observed fraction of contacts", loc="left", fontsize=10, color=_GREY)
    _in_grey(axes)
    axes.legend(frameon=False, labelcolor=_GREY, fontsize=9)
    _save(figure, path)


def _in_grey(axes: Any) -> None:
    axes.grid(color=_GREY, alpha=0.3, lw=0.6)
    axes.tick_params(colors=_GREY)
    axes.xaxis.label.set_color(_GREY)
    axes.xaxis.set_major_formatter("{x:g}")
    for spine in axes.spines.values():
        spine.set_visible(False)


def _save(figure: Any, path: Path) -> None:
    figure.savefig(
        path, transparent=True, metadata={"Date": None} if path.suffix == ".svg" else None
    )
