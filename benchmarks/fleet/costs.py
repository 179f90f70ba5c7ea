"""Time and cost of a fleet at a number of nodes, from figures of one core; the tables of
docs/how-to/fleet.md.

compute  T_c = (3600 H f t + C o) / (N k)       H hours of video, f frames/s, t s per frame and core
storage  T_s = 3600 H b / min(N r, R)           b MB per second of video, r and R MB/s of a node and of the storage
driver   T_d = C / d                            C = 3600 H / L clips of L s, d clips/s, o s of overhead per clip
ends     T_e = s + L f t                        s s until all workers have started, and the last clip of a worker
total    T = max(T_c, T_s, T_d) + T_e           N nodes with k cores, one worker per core
cost     N k T p / 3600                         p price of a core for an hour
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

INPUTS: tuple[tuple[str, str, str], ...] = (
    ("stereo_ms", "ms per frame and core, two cameras without dense stereo", "measured"),
    ("mono_ms", "ms per frame and core, one camera", "measured"),
    ("overhead_s", "overhead per clip after warm-up, s", "measured"),
    ("start_s", "start of a worker, s", "measured"),
    ("driver_clips_per_s", "clips/s that the driver can schedule and record", "measured"),
    ("stereo_mb_per_s", "MB per second of video, two cameras", "measured"),
    ("mono_mb_per_s", "MB per second of video, one camera", "measured"),
    ("video_h", "hours of video", "assumed"),
    ("fps", "frames/s", "assumed"),
    ("clip_s", "length of a clip, s", "assumed"),
    ("cores", "cores of a node", "assumed"),
    ("node_mb_per_s", "network of a node, MB/s", "assumed"),
    ("storage_mb_per_s", "all reads from the storage, MB/s", "assumed"),
    ("price_per_core_h", "price of a core for an hour, $", "assumed"),
)
"""Name, meaning and source of the inputs."""

GPU_INPUTS: tuple[tuple[str, str, str], ...] = (
    ("gpu_mono_ms", "ms per frame of a GPU that workers share, one camera", "measured"),
    ("price_per_gpu_h", "price of a node with one GPU for an hour, $", "assumed"),
)
"""Inputs of the rows for GPUs, which are left out without them."""

ASSUMED: Mapping[str, float] = {
    "video_h": 1000.0,
    "fps": 10.0,
    "clip_s": 60.0,
    "cores": 16.0,
    "node_mb_per_s": 1250.0,  # 10 Gbit/s
    "storage_mb_per_s": 12_500.0,  # 100 Gbit/s
    "price_per_core_h": 0.05,
    "price_per_gpu_h": 1.0,
}

NODES = (1, 10, 100, 1000)

BEGIN, END = (
    "<!-- fleet costs: written by `python -m benchmarks fleet --docs` -->",
    "<!-- end of fleet costs -->",
)
"""Lines around the tables in docs/how-to/fleet.md."""


def times_s(
    inputs: Mapping[str, float], n_nodes: int, cameras: str, *, has_gpu: bool = False
) -> dict[str, float]:
    """Times in s by part: compute, storage, driver, ends, and total, for "stereo" or "mono".

    The rate of one GPU per node, which its workers share, counts instead of that of k cores.
    """
    video_s = 3600 * inputs["video_h"]
    n_clips = video_s / inputs["clip_s"]
    frame_s = inputs[f"{'gpu_' if has_gpu else ''}{cameras}_ms"] / 1000
    n_workers = n_nodes * (1 if has_gpu else inputs["cores"])
    rate_mb_per_s = min(n_nodes * inputs["node_mb_per_s"], inputs["storage_mb_per_s"])
    core_s = video_s * inputs["fps"] * frame_s + n_clips * inputs["overhead_s"]
    parts = {
        "compute": core_s / n_workers,
        "storage": video_s * inputs[f"{cameras}_mb_per_s"] / rate_mb_per_s,
        "driver": n_clips / inputs["driver_clips_per_s"],
        "ends": inputs["start_s"] + inputs["clip_s"] * inputs["fps"] * frame_s,
    }
    return {
        **parts,
        "total": max(parts["compute"], parts["storage"], parts["driver"]) + parts["ends"],
    }


def bottleneck(parts: Mapping[str, float]) -> str:
    return max((name for name in parts if name != "total"), key=lambda name: parts[name])


def cost(
    inputs: Mapping[str, float], n_nodes: int, total_s: float, *, has_gpu: bool = False
) -> float:
    node_h = inputs["price_per_gpu_h"] if has_gpu else inputs["cores"] * inputs["price_per_core_h"]
    return n_nodes * total_s / 3600 * node_h


def is_complete(inputs: Mapping[str, float]) -> bool:
    return all(name in inputs for name, _, _ in INPUTS)


def cost_tables(inputs: Mapping[str, float]) -> str:
    """The inputs and the results as Markdown tables; the results are those of the inputs as they
    are shown.
    """
    inputs = {name: float(_text(value)) for name, value in inputs.items()}
    lines = ["| input | value | source |", "|---|--:|---|"]
    has_gpu = "gpu_mono_ms" in inputs
    shown_inputs = (*INPUTS, *GPU_INPUTS) if has_gpu else INPUTS
    lines += [
        f"| {meaning} (`{name}`) | {_text(inputs[name])} | {source} |"
        for name, meaning, source in shown_inputs
    ]
    lines += [
        "",
        "| cameras, nodes | compute | storage | driver | ends | total | bottleneck | cost, $ |",
    ]
    lines.append("|---|--:|--:|--:|--:|--:|---|--:|")
    kinds = [
        ("stereo", "two", False),
        ("mono", "one", False),
        *([("mono", "one, GPU", True)] if has_gpu else []),
    ]
    for cameras, shown, on_gpu in kinds:
        for n_nodes in NODES:
            parts = times_s(inputs, n_nodes, cameras, has_gpu=on_gpu)
            texts = [
                duration(parts[name]) for name in ("compute", "storage", "driver", "ends", "total")
            ]
            price = f"{cost(inputs, n_nodes, parts['total'], has_gpu=on_gpu):.0f}"
            row = [f"{shown}, {n_nodes}", *texts, bottleneck(parts), price]
            lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines)


def _text(value: float) -> str:
    """A number with four significant digits, without an exponent."""
    return f"{float(f'{value:.4g}'):.10g}"


def duration(seconds: float) -> str:
    """A duration as "45 s", "12 min" or "3.4 h"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def inputs_in(page: str) -> dict[str, float]:
    return {
        name: float(value) for name, value in re.findall(r"\(`(\w+)`\) \| ([\d.e+-]+) \|", page)
    }


def replace_tables(page: Path, inputs: Mapping[str, float]) -> None:
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    page.write_text(f"{before}{BEGIN}\n\n{cost_tables(inputs)}\n\n{END}{after}", encoding="utf-8")


def measured(figures: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The inputs: the assumed ones, and the measured ones of parts of the benchmark."""
    inputs = dict(ASSUMED)
    for part in figures:
        names = [name for name, _, source in (*INPUTS, *GPU_INPUTS) if source == "measured"]
        inputs.update({name: part[name] for name in names if name in part})
    return inputs
