"""Known vulnerabilities of the direct dependencies, as installed in an environment, by pip-audit.

`python .ci/audit.py PIP_AUDIT SITE_PACKAGES` exits with 1 if there is one. It is skipped, with the
reason, where the database of vulnerabilities cannot be reached.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

_TIMEOUT_S = 180
"""Seconds for all requests; a request has 5."""

_PROJECT = Path(__file__).resolve().parents[1]


def main(pip_audit: str, site_packages: str) -> int:
    """Print the vulnerabilities and return the exit status."""
    report = _report(pip_audit, site_packages)
    if isinstance(report, str):
        print(f"audit skipped: {report}")
        return 0
    direct = _direct_dependencies()
    audited = [package for package in report if "skip_reason" not in package]
    if not {_normalised(package["name"]) for package in audited} & direct:
        print(
            "audit skipped: the database of vulnerabilities has no answer for any direct dependency"
        )
        return 0
    status = 0
    for package in audited:
        is_direct = _normalised(package["name"]) in direct
        for vulnerability in package["vulns"]:
            fixed = ", ".join(vulnerability["fix_versions"]) or "none yet"
            kind = "direct dependency" if is_direct else "indirect dependency, not a failure"
            print(
                f"{package['name']} {package['version']}: {vulnerability['id']} ({kind}); "
                f"corrected in: {fixed}"
            )
            status |= is_direct
    missing = sorted(direct - {_normalised(package["name"]) for package in audited})
    print(
        f"audit: {len(audited)} "
        "packages" + (f", without an answer: {', '.join(missing)}" if missing else "")
    )
    return status


def _report(pip_audit: str, site_packages: str) -> list[dict[str, Any]] | str:
    """The packages of pip-audit's report, or the reason why there is none."""
    command = [
        pip_audit,
        "--path",
        site_packages,
        "--format",
        "json",
        "--progress-spinner",
        "off",
        "--timeout",
        "5",
    ]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
        )
        packages: list[dict[str, Any]] = json.loads(done.stdout)["dependencies"]
    except subprocess.TimeoutExpired:
        return f"no answer of the database of vulnerabilities within {_TIMEOUT_S} s"
    except OSError as error:
        return f"pip-audit does not start: {error}"
    except ValueError:
        return (done.stderr.strip().splitlines() or ["pip-audit printed no report"])[-1]
    return packages


def _direct_dependencies() -> set[str]:
    project = tomllib.loads((_PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return {
        _normalised(re.split(r"[\[<>=!~; ]", text, maxsplit=1)[0])
        for text in project["dependencies"]
    }


def _normalised(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
