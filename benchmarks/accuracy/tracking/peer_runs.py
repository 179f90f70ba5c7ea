"""Virtual environments for trackers of other packages (peers), and runs of `peer_trackers.py` in
them.

There are three environments, separate from that of track-range: two peers require different
releases of the same library, and one requires PyTorch (several GB). They are created on demand.
This module does not import the peers.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.accuracy.tracking.peer_trackers import PEERS, Array
from benchmarks.inputs.tracking_sets import Sequence

REQUIREMENTS: Mapping[str, tuple[str, ...]] = {
    "trackers": ("trackers>=2.6,<2.7", "deep-sort-realtime>=1.3.2,<2", "motpy>=0.0.10,<0.1"),
    "norfair": ("norfair>=2.3,<3",),
    "boxmot": ("boxmot>=25,<26",),
}
"""Requirements of each environment."""

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Environment variables that limit numerical libraries to one thread."""

_SCRIPT = Path(__file__).with_name("peer_trackers.py")
_STAMP = "made.stamp"  # file in a complete environment


def create_environments(folder: Path) -> dict[str, Path]:
    """Python interpreters of the environments, created if missing; without those that cannot be
    created.
    """
    folders = {name: folder / name for name in REQUIREMENTS}
    return {
        name: path / "bin" / "python" for name, path in folders.items() if _is_created(name, path)
    }


def _is_created(name: str, folder: Path) -> bool:
    if (folder / _STAMP).is_file():
        return True
    print(f"{folder}: installing {', '.join(REQUIREMENTS[name])} ...", flush=True)
    install = [
        str(folder / "bin" / "python"),
        "-m",
        "pip",
        "install",
        "--quiet",
        *REQUIREMENTS[name],
    ]
    for command in ([sys.executable, "-m", "venv", "--clear", str(folder)], install):
        try:
            subprocess.run(command, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            print(f"{folder}: cannot be created ({error}); its peers are skipped.", flush=True)
            return False
    (folder / _STAMP).touch()
    return True


@dataclass(frozen=True, slots=True)
class PeerResult:
    """Tracks and times of a peer on some sequences."""

    version: str  # version of the peer's package
    # frame (N,), track_id (N,) and xyxy_px (N, 4), by index of the sequence
    tracks: dict[int, tuple[Array, Array, Array]] = field(default_factory=dict)
    # time of each frame in microseconds, by index of the sequence
    us: dict[int, Array] = field(default_factory=dict)


def run_peers(
    python: Path, names: Iterable[str], sequences: Iterable[Sequence], *, max_s: float = np.inf
) -> dict[str, PeerResult]:
    """Results of peers of one environment, one after another in one process; without peers that
    fail.

    A sequence is stopped after `max_s` of processor time.
    """
    with tempfile.TemporaryDirectory() as folder:
        inputs, results = Path(folder) / "inputs.npz", Path(folder)
        np.savez(inputs, **_inputs(list(sequences), max_s))  # type: ignore[arg-type]
        # -P: modules in the folder of the script could shadow those of a peer.
        command = [str(python), "-P", str(_SCRIPT), str(inputs), folder, *names]
        run = subprocess.run(
            command,
            env={**os.environ, **ONE_THREAD},
            check=False,
            stderr=subprocess.PIPE,
            text=True,
        )
        if run.returncode:
            print(f"{python}: status {run.returncode}. {run.stderr[-300:]}", flush=True)
        files = {name: results / f"{name}.npz" for name in names}
        return {name: _peer_result(file) for name, file in files.items() if file.is_file()}


def _inputs(sequences: list[Sequence], max_s: float) -> dict[str, Array]:
    inputs: dict[str, Array] = {"n": np.array(len(sequences))}
    for i, sequence in enumerate(sequences):
        boxes = sequence.detected.detections
        inputs |= {
            f"{i}/begin": np.searchsorted(
                sequence.detected.frame, np.arange(sequence.n_frames + 1)
            ),
            f"{i}/xyxy_px": boxes.xyxy_px,
            f"{i}/score": boxes.score,
            f"{i}/descriptor": boxes.descriptor,
            f"{i}/fps": np.array(sequence.fps),
            f"{i}/size_px": np.array(sequence.size_px),
            f"{i}/min_score": np.array(sequence.min_score),
            f"{i}/max_s": np.array(max_s),
        }
    return inputs


def _peer_result(file: Path) -> PeerResult:
    with np.load(file, allow_pickle=False) as arrays:
        result = PeerResult(str(arrays["version"]))
        for i in (int(key.split("/")[0]) for key in arrays if key.endswith("/us")):
            result.us[i] = arrays[f"{i}/us"]
            result.tracks[i] = (
                arrays[f"{i}/frame"],
                arrays[f"{i}/track_id"],
                arrays[f"{i}/xyxy_px"],
            )
        return result


def names_in(environment: str, *, with_embeddings: bool = True) -> list[str]:
    return [
        name
        for name, peer in PEERS.items()
        if peer.environment == environment and (with_embeddings or not peer.has_embeddings)
    ]
