"""Damaged inputs: mutations of valid files of every kind, each read by a command."""

from __future__ import annotations

import multiprocessing
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from random import Random

from benchmarks.torture.cases import Case, notes, outcome, problems
from benchmarks.torture.mutations import FILE_KINDS
from benchmarks.torture.processes import run
from benchmarks.torture.result_files import result_problems
from benchmarks.torture.seeds import KINDS, Kind, write_seeds

PART = "mutants"

_FILE_KIND_FRACTION = 0.08
"""Fraction of the cases in which the file becomes a pipe, a device, a folder or the like."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """A case to run: the kind of the input, and the seed of the mutation."""

    kind: Kind
    seed: str


def run_mutants(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """The finished cases, the kinds in turn."""
    seeds = folder / "valid"
    write_seeds(seeds)
    planned = [Mutant(KINDS[number % len(KINDS)], f"{seed}-{number}") for number in range(n_cases)]
    # forked, so that the loaded modules are shared
    with multiprocessing.get_context("fork").Pool(n_jobs) as pool:
        yield from pool.imap_unordered(partial(run_mutant, seeds=seeds, folder=folder), planned)


def run_mutant(mutant: Mutant, *, seeds: Path, folder: Path) -> Case:
    """Damage a file and run the command that reads it.

    Args:
        mutant: the case.
        seeds: folder of the valid files.
        folder: folder of all cases; that of this case is kept if there is a problem.
    """
    kind, random = mutant.kind, Random(mutant.seed)
    place = folder / f"mutant-{mutant.seed}"
    shutil.copytree(seeds, place, copy_function=os.link)
    path = place / random.choice(kind.files)
    name = f"{path.relative_to(place)}, {_damage(path, kind, random)}"
    end = run(kind.command, place)
    # a damaged file may be blamed on the file beside it that no longer fits, or on the folder of both
    names = (path.name, *(Path(file).name for file in kind.files), f"{path.parent.name}/", f"{path.parent.name}:")
    faults = problems(end, names=() if kind.has_paths else names)
    if not end.status and (place / "out/tracks.csv").exists():
        faults += result_problems(place / "out")
    case = Case(
        PART, kind.name, name, outcome(end, usual_notes=_usual_notes(kind, seeds)), faults, kind.command, place, end
    )
    if not faults:
        shutil.rmtree(place)
    return case


def _damage(path: Path, kind: Kind, random: Random) -> str:
    """Replace a file by a damaged one; returns what was done."""
    content = path.read_bytes()
    path.unlink()
    if random.random() < _FILE_KIND_FRACTION:
        make = random.choice(FILE_KINDS)
        make(path)
        return make.__name__
    mutation = random.choice(kind.mutations)
    try:
        damaged = mutation(content, random)
    except (ValueError, KeyError, IndexError):  # a structured mutation of a file in another format
        mutation = kind.mutations[0]
        damaged = mutation(content, random)
    path.write_bytes(damaged)
    return mutation.__name__


@cache
def _usual_notes(kind: Kind, seeds: Path) -> frozenset[str]:
    """Notes of the command on the valid files."""
    place = seeds.with_name(f"valid-{os.getpid()}")
    shutil.copytree(seeds, place, copy_function=os.link)
    end = run(kind.command, place)
    shutil.rmtree(place)
    if end.status:
        raise RuntimeError(f"track-range {' '.join(kind.command)}: {end.stderr}")
    return notes(end)
