"""Peers of the tracker: environments of their own, made on demand, and `peer_trackers.py` run in them.

Two peers want different releases of the same library, and one brings PyTorch (some GB): so there are three, apart from
ours. Nothing here imports them.
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

from benchmarks.inputs.tracking_sets import Sequence
from benchmarks.peers.peer_trackers import PEERS, Array

REQUIREMENTS: Mapping[str, tuple[str, ...]] = {
    "trackers": ("trackers>=2.6,<2.7", "deep-sort-realtime>=1.3.2,<2", "motpy>=0.0.10,<0.1"),
    "norfair": ("norfair>=2.3,<3",),
    "boxmot": ("boxmot>=25,<26",),
}
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
_SCRIPT = Path(__file__).with_name("peer_trackers.py")
_MADE = "made.stamp"


def made_environments(folder: Path) -> dict[str, Path]:
    """The interpreter of each environment, made where it is missing; without those that cannot be made."""
    found = {name: folder / name for name in REQUIREMENTS}
    return {name: each / "bin" / "python" for name, each in found.items() if _is_made(name, each)}


def _is_made(name: str, place: Path) -> bool:
    if (place / _MADE).is_file():
        return True
    print(f"{place}: making it for {', '.join(REQUIREMENTS[name])} (once) ...", flush=True)
    install = [str(place / "bin" / "python"), "-m", "pip", "install", "--quiet", *REQUIREMENTS[name]]
    for command in ([sys.executable, "-m", "venv", "--clear", str(place)], install):
        try:
            subprocess.run(command, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            print(f"{place}: cannot be made ({error}); its peers are left out.", flush=True)
            return False
    (place / _MADE).touch()
    return True


@dataclass(frozen=True, slots=True)
class Answer:
    """What a peer said of some sequences.

    Attributes:
        version: of its package.
        tracks: by index of the sequence: frame, track_id (N,), xyxy_px (N, 4).
        us: by index of the sequence: time of every frame.
    """

    version: str
    tracks: dict[int, tuple[Array, Array, Array]] = field(default_factory=dict)
    us: dict[int, Array] = field(default_factory=dict)


def run_peers(
    python: Path, names: Iterable[str], sequences: Iterable[Sequence], *, max_s: float = np.inf
) -> dict[str, Answer]:
    """Run peers of one environment in one process, one after another; without those that fail, which say so.

    Args:
        python: the environment's interpreter.
        names: of `peer_trackers.PEERS`.
        sequences: what they track.
        max_s: seconds after which a tracker leaves a sequence.
    """
    with tempfile.TemporaryDirectory() as folder:
        given, answers = Path(folder) / "given.npz", Path(folder)
        np.savez(given, **_given(list(sequences), max_s))  # type: ignore[arg-type]
        # -P: the script's own folder has modules whose names somebody else's may have too.
        command = [str(python), "-P", str(_SCRIPT), str(given), folder, *names]
        run = subprocess.run(command, env={**os.environ, **ONE_THREAD}, check=False, stderr=subprocess.PIPE, text=True)
        if run.returncode:
            print(f"{python}: status {run.returncode}. {run.stderr[-300:]}", flush=True)
        found = {name: answers / f"{name}.npz" for name in names}
        return {name: _answer(file) for name, file in found.items() if file.is_file()}


def _given(sequences: list[Sequence], max_s: float) -> dict[str, Array]:
    """See `peer_trackers`."""
    given: dict[str, Array] = {"n": np.array(len(sequences))}
    for i, each in enumerate(sequences):
        boxes = each.found.detections
        given |= {
            f"{i}/begin": np.searchsorted(each.found.frame, np.arange(each.n_frames + 1)),
            f"{i}/xyxy_px": boxes.xyxy_px,
            f"{i}/score": boxes.score,
            f"{i}/descriptor": boxes.descriptor,
            f"{i}/fps": np.array(each.fps),
            f"{i}/size_px": np.array(each.size_px),
            f"{i}/min_score": np.array(each.min_score),
            f"{i}/max_s": np.array(max_s),
        }
    return given


def _answer(file: Path) -> Answer:
    with np.load(file, allow_pickle=False) as arrays:
        answer = Answer(str(arrays["version"]))
        for i in (int(key.split("/")[0]) for key in arrays if key.endswith("/us")):
            answer.us[i] = arrays[f"{i}/us"]
            answer.tracks[i] = (arrays[f"{i}/frame"], arrays[f"{i}/track_id"], arrays[f"{i}/xyxy_px"])
        return answer


def names_in(environment: str, *, with_vectors: bool = True) -> list[str]:
    """Peers of an environment, in the table's order."""
    return [n for n, p in PEERS.items() if p.environment == environment and (with_vectors or not p.has_vectors)]
