"""Time and cost of a fleet at a number of nodes, from figures of one core; the tables of docs/fleet.md.

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

ASSUMED: Mapping[str, float] = {
    "video_h": 1000.0,
    "fps": 10.0,
    "clip_s": 60.0,
    "cores": 16.0,
    "node_mb_per_s": 1250.0,  # 10 Gbit/s
    "storage_mb_per_s": 12_500.0,  # 100 Gbit/s
    "price_per_core_h": 0.05,
}

NODES = (1, 10, 100, 1000)

BEGIN, END = "<!-- fleet costs: written by `python -m benchmarks fleet --docs` -->", "<!-- end of fleet costs -->"
"""Lines around the tables in docs/fleet.md."""


def times_s(inputs: Mapping[str, float], n_nodes: int, cameras: str) -> dict[str, float]:
    """Times in s by part: compute, storage, driver, ends, and total.

    Args:
        inputs: value of each of `INPUTS`.
        n_nodes: number of nodes.
        cameras: "stereo" or "mono".
    """
    video_s = 3600 * inputs["video_h"]
    n_clips = video_s / inputs["clip_s"]
    frame_s = inputs[f"{cameras}_ms"] / 1000
    rate_mb_per_s = min(n_nodes * inputs["node_mb_per_s"], inputs["storage_mb_per_s"])
    core_s = video_s * inputs["fps"] * frame_s + n_clips * inputs["overhead_s"]
    parts = {
        "compute": core_s / (n_nodes * inputs["cores"]),
        "storage": video_s * inputs[f"{cameras}_mb_per_s"] / rate_mb_per_s,
        "driver": n_clips / inputs["driver_clips_per_s"],
        "ends": inputs["start_s"] + inputs["clip_s"] * inputs["fps"] * frame_s,
    }
    return {**parts, "total": max(parts["compute"], parts["storage"], parts["driver"]) + parts["ends"]}


def bottleneck(parts: Mapping[str, float]) -> str:
    """Name of the part that takes longest."""
    return max((name for name in parts if name != "total"), key=lambda name: parts[name])


def cost(inputs: Mapping[str, float], n_nodes: int, total_s: float) -> float:
    """Price of all nodes for the whole time."""
    return n_nodes * inputs["cores"] * total_s / 3600 * inputs["price_per_core_h"]


def cost_tables(inputs: Mapping[str, float]) -> str:
    """The inputs and the results as Markdown tables."""
    lines = ["| input | value | source |", "|---|--:|---|"]
    lines += [f"| {meaning} (`{name}`) | {inputs[name]:g} | {source} |" for name, meaning, source in INPUTS]
    lines += ["", "| cameras, nodes | compute | storage | driver | ends | total | bottleneck | cost, $ |"]
    lines.append("|---|--:|--:|--:|--:|--:|---|--:|")
    for cameras, shown in (("stereo", "two"), ("mono", "one")):
        for n_nodes in NODES:
            parts = times_s(inputs, n_nodes, cameras)
            texts = [duration(parts[name]) for name in ("compute", "storage", "driver", "ends", "total")]
            price = f"{cost(inputs, n_nodes, parts['total']):.0f}"
            row = [f"{shown}, {n_nodes}", *texts, bottleneck(parts), price]
            lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines)


def duration(seconds: float) -> str:
    """A duration as "45 s", "12 min" or "3.4 h"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def inputs_in(page: str) -> dict[str, float]:
    """The inputs in the table of a page."""
    return {name: float(value) for name, value in re.findall(r"\(`(\w+)`\) \| ([\d.e+-]+) \|", page)}


def replace_tables(page: Path, inputs: Mapping[str, float]) -> None:
    """Write the tables of the inputs between the two marked lines of a page."""
    text = page.read_text(encoding="utf-8")
    before, _, rest = text.partition(BEGIN)
    after = rest.partition(END)[2]
    page.write_text(f"{before}{BEGIN}\n{cost_tables(inputs)}\n{END}{after}", encoding="utf-8")


def measured(figures: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """All inputs: the assumed ones, and the measured ones of parts of the benchmark."""
    inputs = dict(ASSUMED)
    for part in figures:
        inputs.update({name: part[name] for name, _, source in INPUTS if source == "measured" and name in part})
    return inputs
