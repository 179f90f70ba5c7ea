"""Damaged inputs: mutations of valid files of every kind, each read by a command."""

from __future__ import annotations

import multiprocessing
import os
import shutil
from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from random import Random

from tests.torture.cases import Case, finished, notes, outcome, problems, result_problems
from tests.torture.mutations import FILE_KINDS
from tests.torture.processes import run, succeed
from tests.torture.seeds import KINDS, Kind, write_seeds

# of the cases in which the file becomes a pipe, a device, a folder or the like
FILE_KIND_FRACTION = 0.08


def run_mutants(folder: Path, seed: int, n_cases: int, n_jobs: int) -> Iterator[Case]:
    """The finished cases, the kinds in turn."""
    seeds = folder / "valid"
    write_seeds(seeds)
    # forked, so that the loaded modules are shared
    with multiprocessing.get_context("fork").Pool(n_jobs) as pool:
        yield from pool.imap_unordered(
            partial(run_mutant, seed=seed, seeds=seeds, folder=folder), range(n_cases)
        )


def run_mutant(number: int, *, seed: int, seeds: Path, folder: Path) -> Case:
    """Damage a file in a copy of the valid files, and run the command that reads it."""
    kind, random = KINDS[number % len(KINDS)], Random(f"{seed}-{number}")
    place = folder / f"mutant-{seed}-{number}"
    shutil.copytree(seeds, place, copy_function=os.link)
    path = place / random.choice(kind.files)
    name = f"{path.relative_to(place)}, {_damage(path, kind, random)}"
    end = run(kind.command, place)
    # a damaged file may be blamed on the file beside it that no longer fits, or on the folder of
    # both
    names = (
        path.name,
        *(Path(file).name for file in kind.files),
        f"{path.parent.name}/",
        f"{path.parent.name}:",
    )
    faults = problems(end, names=() if kind.has_paths else names)
    if not end.status and (place / "out/tracks.csv").exists():
        faults += result_problems(place / "out")
    result = outcome(end, usual_notes=_usual_notes(kind, seeds))
    return finished(Case("mutants", kind.name, name, result, faults, kind.command, place, end))


def _damage(path: Path, kind: Kind, random: Random) -> str:
    """Replace a file by a damaged one; returns what was done."""
    content = path.read_bytes()
    path.unlink()
    if random.random() < FILE_KIND_FRACTION:
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
    end = succeed(kind.command, place)
    shutil.rmtree(place)
    return notes(end)
