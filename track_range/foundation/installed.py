"""Versions of installed packages, of which some come in several distributions that replace each
other.
"""

from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version

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
