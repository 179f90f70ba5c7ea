"""`python -m benchmarks WORKLOAD [--json FILE]`: run one workload and print its table."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks import mutation, reference, torture
from benchmarks.accuracy import (
    ablation,
    anonymization,
    appearance,
    box_errors,
    focal_length,
    formats,
    fusion,
    history,
    horizon,
    lanes,
    odometry,
    recall,
    tracking,
    warnings,
    wide_lenses,
)
from benchmarks.accuracy.stereo_matching import alignment, occlusion, rig_health, stereo, surface_choice
from benchmarks.fleet import faults, throughput
from benchmarks.speed import detection, memory, pipeline, processor_time, ranging, server, startup, writers

WORKLOADS = {
    "pipeline": pipeline,
    "memory": memory,
    "mutation": mutation,
    "detection": detection,
    "ablation": ablation,
    "alignment": alignment,
    "box_errors": box_errors,
    "anonymization": anonymization,
    "fleet": throughput,
    "fleet_faults": faults,
    "focal_length": focal_length,
    "formats": formats,
    "fusion": fusion,
    "history": history,
    "horizon": horizon,
    "lanes": lanes,
    "occlusion": occlusion,
    "odometry": odometry,
    "appearance": appearance,
    "processor_time": processor_time,
    "tracking": tracking,
    "ranging": ranging,
    "recall": recall,
    "reference": reference,
    "rig_health": rig_health,
    "server": server,
    "startup": startup,
    "torture": torture,
    "stereo": stereo,
    "surface_choice": surface_choice,
    "warnings": warnings,
    "wide_lenses": wide_lenses,
    "writers": writers,
}
"""Module of each workload, with `add_options(parser)` and `measure(options) -> figures`, which prints its tables."""


def main() -> None:
    """Parse the command line and run the workload."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON file to write the figures to")
    commands = parser.add_subparsers(dest="workload", required=True)
    for name, module in WORKLOADS.items():
        command = commands.add_parser(name, help=(module.__doc__ or "").splitlines()[0])
        command.add_argument("--json", type=Path, metavar="FILE", default=argparse.SUPPRESS, help="JSON file to write")
        module.add_options(command)
    options = parser.parse_args()
    figures = WORKLOADS[options.workload].measure(options)
    if options.json:
        options.json.write_text(json.dumps({options.workload: figures}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
