"""Versions of installed packages, of which some come in several distributions that replace each
other.
"""

import os
import re
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import Distribution, PackageNotFoundError, version
from pathlib import Path

# with the same modules, by the one that is required
_DISTRIBUTIONS: Mapping[str, tuple[str, ...]] = {
    "opencv-python-headless": (
        *(
            "opencv-python-headless",
            "opencv-python",
            "opencv-contrib-python-headless",
            "opencv-contrib-python",
        ),
    ),
    "onnxruntime": (
        "onnxruntime",
        "onnxruntime-gpu",
        "onnxruntime-directml",
        "onnxruntime-openvino",
    ),
}


def installed_versions(name: str) -> dict[str, str]:
    """Versions of the installed distributions that have the modules of a package, by name; empty =
    not installed.
    """
    versions = {}
    for distribution in _DISTRIBUTIONS.get(name, (name,)):
        try:
            versions[distribution] = version(distribution)
        except PackageNotFoundError:
            continue
    return versions


@cache
def conflicts() -> tuple[str, ...]:
    """A sentence for each package that is installed in several distributions, which overwrite each
    other's files.
    """
    several = [versions for name in _DISTRIBUTIONS if len(versions := installed_versions(name)) > 1]
    return tuple(
        f"{' and '.join(f'{key} {value}' for key, value in versions.items())} are installed and "
        f"overwrite each other's files: pip uninstall -y {' '.join(versions)}, then pip install "
        "the package that you need."
        for versions in several
    )


@cache
def commit_of_package(package: Path, distribution: str) -> str:
    """Commit of an installed package: that of its installation from a repository, or that of the
    checkout that contains it, with "-dirty" if files differ from it; "" = unknown.
    """
    with suppress(PackageNotFoundError):
        origin = Distribution.from_name(distribution).read_text("direct_url.json") or ""
        if match := re.search(r'"commit_id": *"([0-9a-f]+)"', origin):
            return match[1]
    with suppress(OSError, subprocess.SubprocessError):
        # a package that is installed inside of another project's checkout is no part of it
        if _git(package, "ls-files", "--error-unmatch", "__init__.py"):
            return _git(package, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    return ""


def _git(folder: Path, *arguments: str) -> str:
    """What Git prints, "" if it fails; it changes nothing, not even its index."""
    answer = subprocess.run(
        ["git", "-C", os.fspath(folder), *arguments],
        capture_output=True,
        text=True,
        timeout=10,
        check=False,
        env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
    )
    return answer.stdout.strip() if answer.returncode == 0 else ""
