"""`python -m benchmarks WORKLOAD [OPTIONS]`: run one workload, print its tables, and write its
figures as JSON.

python -m benchmarks WORKLOAD --help lists the options of a workload.
"""

from __future__ import annotations

import importlib
import sys

from benchmarks.harness import Workload

WORKLOADS = {
    "ablation": (
        "accuracy.detection.ablation",
        "improvements of the monocular paper on the same training budget",
    ),
    "alignment": (
        "accuracy.cameras.rig_alignment",
        "alignment from drives against known disparity errors",
    ),
    "anonymization": (
        "accuracy.detection.anonymization",
        "covered fraction of heads and plates in simulated drives",
    ),
    "appearance": (
        "accuracy.tracking.appearance",
        "effect of appearance and camera motion on online tracking",
    ),
    "baseline": ("gate", "record the fast workloads as baselines"),
    "box_errors": (
        "accuracy.warnings.box_errors",
        "errors of boxes and tracks on rendered drives and without images",
    ),
    "compare": ("gate", "ratios of the figures of two recordings"),
    "crossings": (
        "accuracy.tracking.crossings",
        "identity switches of simulated people and cars that cross, without images",
    ),
    "devices": (
        "speed.devices",
        "the network, runs and steps of a pipeline on each device",
    ),
    "doubt": ("accuracy.ranging.doubt", "what runs say about wrong inputs, and their errors"),
    "far_pass": (
        "accuracy.detection.far_pass",
        "far road users by the size of the input, and with a second pass",
    ),
    "fixed": (
        "accuracy.ranging.fixed",
        "speeds and counts of cameras that stand still, in simulated streets",
    ),
    "fixed_parts": (
        "accuracy.detection.fixed_parts",
        "boxes that burnt-in text adds, and true boxes that are lost with it",
    ),
    "fleet": (
        "fleet.throughput",
        "throughput, overhead and memory of workers, and the cost of 1,000 hours",
    ),
    "fleet_faults": ("fleet.faults", "killed workers, a corrupt clip and a killed driver"),
    "formats": ("accuracy.detection.formats", "round trips through the label formats"),
    "fusion": (
        "accuracy.ranging.simulated_runs",
        "fusion while the right camera is black or noise",
    ),
    "ground_weight": (
        "accuracy.cameras.ground_weight",
        "what contact points add to sizes on KITTI's labels, by drive",
    ),
    "history": ("accuracy.tracking.history", "median label prediction by length, form and gates"),
    "horizon": (
        "accuracy.cameras.horizon",
        "ranging from box bottoms with and without a known camera height",
    ),
    "identities": (
        "accuracy.tracking.identities",
        "what a run with images loses of IDF1: detection, false boxes, or identities",
    ),
    "lanes": ("accuracy.detection.lanes", "lane detectors: time, accuracy, agreement"),
    "latency": (
        "speed.latency",
        "steps of a pipeline, and frames that a live run drops",
    ),
    "memory": ("speed.runs", "resident memory of a run of 2,000 frames"),
    "occlusion": ("accuracy.ranging.occlusion", "stereo matchers for road users behind obstacles"),
    "mountings": (
        "accuracy.cameras.mountings",
        "cameras that look aside and back, and given heights, on real roads",
    ),
    "mono_speed": (
        "accuracy.cameras.mono_speed",
        "ego speed of one camera, also without its height",
    ),
    "networks": (
        "accuracy.networks.networks",
        "stereo networks against the matchers, on real pairs with lidar",
    ),
    "odometry": ("accuracy.cameras.odometry", "speed and yaw rate of the camera from the images"),
    "pipeline": ("speed.runs", "wall time of whole runs relative to inference alone"),
    "processor_time": (
        "speed.processor_time",
        "processor time of each step of a run, and waits of its threads",
    ),
    "recall": ("accuracy.detection.recall", "recall of detectors on simulated cars"),
    "recordings": (
        "accuracy.ranging.recordings",
        "kinds of recordings and calibrations against a drive in plain form",
    ),
    "reference": ("reference", "results of every main command, recorded and compared"),
    "rig_health": (
        "accuracy.cameras.rig_alignment",
        "true rig files and rig files with errors on the same drives",
    ),
    "self_calibration": (
        "accuracy.cameras.self_calibration",
        "cameras without a calibration: focal length, distortion, distances, time",
    ),
    "stages": (
        "speed.stages",
        "time and calls of each stage of a frame, and of detectors and formats",
    ),
    "startup": ("speed.runs", "start-up time of the command line and of the import"),
    "roads": (
        "accuracy.ranging.roads",
        "error and sigma of one camera by data set, on boxes and on recordings",
    ),
    "stereo": (
        "accuracy.ranging.stereo",
        "time and accuracy of the patch matcher and of dense matching",
    ),
    "surface_choice": (
        "accuracy.ranging.occlusion",
        "fit of the probabilities of a box's surfaces",
    ),
    "tracking": (
        "accuracy.tracking.tracking",
        "trackers against each other on KITTI and MOTChallenge",
    ),
    "visibility": (
        "accuracy.detection.visibility",
        "recall of the packaged detector in the dark, in fog, glare, blur and drops",
    ),
    "warnings": ("accuracy.warnings.warnings", "lead times and false alarms of collision warnings"),
    "wide_lenses": (
        "accuracy.ranging.simulated_runs",
        "a fisheye against a pinhole of the same resolution",
    ),
}
"""Module, which has a function of the same name, and description of each workload."""


def find(name: str) -> Workload:
    found: Workload = getattr(importlib.import_module(f"benchmarks.{WORKLOADS[name][0]}"), name)
    return found


def main() -> None:
    """Run the workload of the command line, or list all of them."""
    name, *arguments = sys.argv[1:] or ["--help"]
    if name not in WORKLOADS:
        print(__doc__)
        for known, (_, description) in WORKLOADS.items():
            print(f"  {known:<16}{description}")
        raise SystemExit(
            0 if name in ("-h", "--help") else f"{name}: expected one of these workloads"
        )
    find(name).run(name, arguments)


if __name__ == "__main__":
    main()
