"""What importers find out about files beside their streams: what kind they are, facts, and doubts."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from kinegraph.stream.domain.finding import Finding
from kinegraph.stream.errors import RecordingError

if TYPE_CHECKING:
    from kinegraph.devices.formats.import_result import Understood


Claims = Literal["warn", "refuse", "measured"]
"""What is done where a file claims one thing and holds another: warn of it, refuse the file, or use what was measured."""


@dataclass(slots=True)
class Findings:
    """Of all files of an import.

    kinds   by file: the program and the grammar, in words
    facts   about session and person, without names
    doubts  what was taken for granted, or contradicts itself; each begins with the file's name
    claims  what the files claim, and does not hold
    """

    kinds: dict[Path, str] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)
    doubts: list[str] = field(default_factory=list)
    claims: list[Finding] = field(default_factory=list)

    def find(self, file: Path, finding: Finding, policy: Claims) -> None:
        """A claim of a file does not hold. Raises RecordingError where such files are refused."""
        if policy == "refuse":
            raise RecordingError(f"{file}: {finding.text}")
        self.claims.append(finding)

    def of(self, made: Understood, policy: Claims) -> None:
        """Take over what was found in a file; a fact that another file tells otherwise is doubted. Raises as `find` does."""
        self.kinds[made.path] = made.kind
        for finding in made.claims:
            self.find(made.path, finding, policy)
        self.doubts += [f"{made.path.name}: {doubt}" for doubt in made.doubts]
        for key, value in made.facts.items():
            if self.facts.setdefault(key, value) != value:
                self.doubts.append(
                    f"{made.path.name}: gives {key} {value}, another file {self.facts[key]}: the first is kept"
                )
