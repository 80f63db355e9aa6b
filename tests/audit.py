"""`python -m tests.audit`: known holes in what is installed, by pip-audit; every package is asked about, and which could not be is said.

Ends with 0 only if an answer came for every package and none has a known hole.
"""

from __future__ import annotations

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
    lines = [*holes, f"{len(packages) - len(unasked)} of {len(packages)} packages audited; known holes: {len(holes)}"]
    if unasked:
        lines.append(f"the index knows nothing of {len(unasked)}: {', '.join(unasked)}")
    if not packages:
        lines.append("no package was found")
    return lines, bool(packages) and not holes and not unasked


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        if not (wanted := Path(*sys.argv[1:2])).is_file():
            wanted = Path(folder, "wanted.txt")
            wanted.write_bytes(
                subprocess.run([sys.executable, "-m", *LISTED], stdout=subprocess.PIPE, check=True).stdout
            )
        call = [sys.executable, "-m", "pip_audit", *OPTIONS, "--requirement", str(wanted)]
        done = subprocess.run(call, capture_output=True, text=True)
    try:
        packages = json.loads(done.stdout)["dependencies"]
    except ValueError:
        sys.exit(f"{done.stderr}the audit could not be made: pip-audit ended with {done.returncode}")
    lines, well = judged(packages)
    print("\n".join(lines))
    sys.exit(0 if well else 1)


if __name__ == "__main__":
    main()
