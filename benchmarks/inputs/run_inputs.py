"""The two recordings of the workloads that measure the speed of runs, and the settings of the runs.

They are a pair whose videos are nearly lossless, and an ordinary video of one camera.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from benchmarks.inputs.drives import decoded, looped, ordinary_video
from benchmarks.inputs.emulated_network import OpenedStoredBoxes, packaged_boxes, write_network
from track_range.foundation.processes import tuned_process
from track_range.run.options.opened import OpenedDetectors
from track_range.run.options.precedence import settings_from
from track_range.run.run import Run

PAIR, ONE = "near-lossless pair", "ordinary video"


@dataclass(frozen=True, slots=True)
class RunInputs:
    """Settings of the runs by recording, and the boxes of the frames if those are stored."""

    detector: Path  # a file of the user, or that of a network that takes a given time
    settings: dict[str, dict[str, Any]]
    stored: dict[str, OpenedStoredBoxes]  # by recording; empty = the detector finds the boxes
    network_ms: float = 0.0  # time of a network that was made for it; 0 = another one

    @classmethod
    def written(
        cls, folder: Path, drive: Path, detector: Path, n_frames: int, network_ms: float = 0.0
    ) -> RunInputs:
        """The recordings and the network in `folder`; with `network_ms`, the network takes so long,
        and the boxes are those of the packaged detector.
        """
        pair = looped(drive, folder, n_frames=n_frames)
        video = ordinary_video(folder / "ordinary.mp4", n_frames=n_frames)
        stored = {}
        if network_ms:
            detector = folder / "network.onnx"
            network_ms = write_network(detector, network_ms)
            for name, file in ((PAIR, pair.left), (ONE, video)):
                stored[name] = OpenedStoredBoxes(packaged_boxes(decoded(file, n_frames)))
        shared = {"detector": str(detector), "threads": 1, "device": "cpu"}
        settings: dict[str, dict[str, Any]] = {
            PAIR: {
                **shared,
                "stereo": (str(pair.left), str(pair.right)),
                "rig": str(pair.rig),
                "align": "off",
                "sgbm": False,
                "out": str(folder / "pair"),
            },
            ONE: {
                **shared,
                "mono": str(video),
                "focal_px": 1150.0,
                "out": str(folder / "one"),
            },
        }
        return cls(detector, settings, stored, network_ms)


def opened_run(settings: dict[str, Any], stored: OpenedStoredBoxes | None = None) -> Run:
    """The run of settings, with stored boxes if given."""
    opened = None if stored is None else cast(OpenedDetectors, stored)
    return Run(settings_from(settings), opened_detectors=opened)


def run_ms(settings: dict[str, Any], stored: OpenedStoredBoxes | None = None) -> dict[str, float]:
    """Wall time per frame of a run, as its summary states it, and processor time from its opening
    on, in ms.
    """
    with opened_run(settings, stored) as run, tuned_process(has_dense_stereo=run.settings.sgbm):
        begin_s = time.process_time()
        for _ in run:
            pass
        spent_s = time.process_time() - begin_s
    n_frames = int(run.summary["frames"])
    return {
        "wall_ms": 1e3 * float(run.summary["wall_s"]) / n_frames,
        "processor_ms": 1e3 * spent_s / n_frames,
    }
