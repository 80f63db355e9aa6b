"""`python -m tests.audit`: known holes in what is installed, by pip-audit; packages without an answer are listed.

Ends with 0 only if an answer came for every package and no package has a known hole.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

LISTED = ("pip", "freeze", "--exclude-editable")
OPTIONS = ("--no-deps", "--disable-pip", "--progress-spinner", "off", "--format", "json")


def judged(packages: list[dict[str, Any]]) -> tuple[list[str], bool]:
    """What pip-audit found of each package, in lines, and whether all is well."""
    holes = [
        f"{package['name']} {package['version']}: {hole['id']}, mended in {', '.join(hole['fix_versions']) or 'no version yet'}"
        for package in packages
        for hole in package.get("vulns", ())
    ]
    unasked = [package["name"] for package in packages if "skip_reason" in package]
    audited = len(packages) - len(unasked)
    text = f"; known holes: {len(holes)}" if audited else ""
    lines = [*holes, f"{audited} of {len(packages)} packages audited{text}"]
    if unasked and len(unasked) == len(packages):
        lines.append(
            "the index answers about no package: it may be a mirror without this service, and no hole is known or ruled out"
        )
    elif unasked:
        lines.append(f"the index knows nothing of {len(unasked)}: {', '.join(unasked)}")
    if not packages:
        lines.append("no package was found")
    return lines, bool(packages) and not holes and not unasked


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.audit", description=__doc__)
    parser.add_argument("wanted", nargs="?", type=Path, help="a file of requirements; left out: what is installed")
    parser.add_argument("--service", default="pypi", choices=("pypi", "osv"), help="who is asked")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        wanted = given.wanted or Path(folder, "wanted.txt")
        if not given.wanted:
            listed = subprocess.run([sys.executable, "-m", *LISTED], stdout=subprocess.PIPE, check=True).stdout
            wanted.write_bytes(listed)
        call = [sys.executable, "-m", "pip_audit", *OPTIONS, "--vulnerability-service", given.service]
        done = subprocess.run([*call, "--requirement", str(wanted)], capture_output=True, text=True)
    try:
        packages = json.loads(done.stdout)["dependencies"]
    except ValueError:
        reported = done.stderr.strip().splitlines() or [""]
        sys.exit(f"the audit could not be made: pip-audit ended with {done.returncode}: {reported[-1]}")
    lines, well = judged(packages)
    print("\n".join(lines))
    sys.exit(0 if well else 1)


if __name__ == "__main__":
    main()
