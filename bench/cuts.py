"""`python -m bench.cuts`: boundaries of activities beside other libraries' on the same recordings, by the same scorer; Markdown.

ruptures (KernelCPD, PELT), claspy (ClaSP) and stumpy (FLUSS), in an environment of their own, see a whole recording, each channel as it
is; claspy's ClaSS and stumpy's FLOSS, which stream, see it frame by frame. The number of cuts is given to those that accept it; what they
can be set to is set once for all recordings, with the annotations in hand: the best mean F1 counts. kinegraph has its defaults and sees
the recording as it comes. Needs the folder that KINEGRAPH_DATA names.
`--write` puts the table into docs/lab/segmentation-figures.md.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from bench.engines import environment
from bench.motion import RATE, Series, poses, segment
from bench.report import Section, marks, publish, whole
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation.evaluation.found import Found
from kinegraph.operators.segmentation.evaluation.scores import Scores, score
from kinegraph.operators.segmentation.evaluation.truth import Truth

SHOWN = ("f1", "covering", "strict", "tolerant")


def as_found(cuts: list[int], frames: int) -> Found:
    """Cuts at these frames, and nothing else, as what is scored."""
    edges = np.array([0, *sorted(c for c in cuts if 0 < c < frames), frames]) / RATE
    spans = np.stack([edges[:-1], edges[1:]], 1)
    nothing = np.full(len(spans), -1)
    return Found(spans, np.zeros(len(spans), bool), spans, nothing, np.zeros(len(spans), int))


def others(recordings: dict[str, tuple[Series, Truth, int]]) -> dict[str, Any]:
    """What contenders/library_cuts.py prints. Raises EngineError where the libraries do not install."""
    python = environment("cuts", ["ruptures", "claspy", "stumpy"])
    script = Path(__file__).parent / "contenders" / "library_cuts.py"
    with tempfile.TemporaryDirectory() as folder:
        for name, (pose, _, cuts) in recordings.items():
            np.savez(Path(folder) / f"{name}.npz", x=pose.data, cuts=cuts)
        done = subprocess.run([str(python), str(script), folder], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(done.stderr)
    print(done.stderr, file=sys.stderr)
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


def cuts(folder: Path, kinds: tuple[str, ...]) -> Section:
    recordings: dict[str, tuple[Series, Truth, int]] = {}
    ours: list[Scores] = []
    for kind, name, pose, truth in poses(folder):
        if kind in kinds:
            recordings[f"{len(recordings):02d}_{name}"] = pose, truth, len(truth.boundaries())
            ours.append(score(segment(pose.through(Stack())), truth))
    rows = [["**kinegraph, live, defaults**", "–", *figures(ours), f"{len(ours)} of {len(ours)}"]]
    answer = others(recordings)
    versions = answer.pop("versions")
    for method, settings in answer.items():
        scored = {s: [_scored(found[n], recordings[n]) for n in recordings] for s, found in settings.items()}
        best = max(scored, key=lambda s: float(np.mean([one.f1 if one else 0.0 for one in scored[s]])))
        done = [one for one in scored[best] if one]
        rows.append([method, best if len(settings) > 1 else "–", *figures(done), f"{len(done)} of {len(ours)}"])
    note = "Versions: " + ", ".join(f"{name} {v}" for name, v in versions.items()) + "."
    title = f"Boundaries of activities, mean of {len(ours)} recordings ({', '.join(kinds)})"
    return Section(title, ["", "setting", "F1", "covering", "strict", "tolerant", "recordings"], rows, [note])


def _scored(found: list[int] | None, recording: tuple[Series, Truth, int]) -> Scores | None:
    pose, truth, _ = recording
    return None if found is None else score(as_found(found, len(pose.data)), truth)


def figures(scores: list[Scores]) -> list[str]:
    return [f"{np.mean([getattr(one, field) for one in scores]):.2f}" if scores else "" for field in SHOWN]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.cuts", description=__doc__)
    parser.add_argument(
        "--all", action="store_true", help="all twelve annotated recordings; else the five of four channels"
    )
    parser.add_argument("--write", action="store_true", help="write the table into docs/lab/segmentation-figures.md")
    given = parser.parse_args()
    folder = Path(os.environ.get("KINEGRAPH_DATA", "")) / "segmentation"
    if not os.environ.get("KINEGRAPH_DATA") or not folder.is_dir():
        sys.exit("KINEGRAPH_DATA must name a folder of recordings that holds `segmentation`")
    every = ("CMU-86, 4 channels", "CMU-86, full body", "exercises, full body", "exercises, 12 channels")
    sections = [cuts(folder, every if given.all else every[:1])]
    print(whole(sections, "By `python -m bench.cuts`."))
    if given.write:
        publish(sections, "By `python -m bench.cuts`.", "lab/segmentation-figures.md", *marks("bench.cuts"))


if __name__ == "__main__":
    main()
