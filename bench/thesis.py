"""`python -m bench.thesis`: every table and figure of the thesis that the recordings at hand allow, printed value beside ours; Markdown.

Needs the folder of recordings that KINEGRAPH_DATA names. Nothing is tuned here: defaults everywhere. `--only 2 6 7 9 10` chooses chapters;
`--write` puts each chapter that was run, with its date, into docs/thesis.md.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

import numpy as np

from bench.report import HOUSE, Section, into_page, marks, tables
from bench.steering import live
from bench.steering_meshes import compared, meshes
from bench.thesis_segmentation import ACA, METHODS, RAW, chapter_two, recordings
from bench.thesis_walking import chapter_seven, chapter_six
from kinegraph.operators.steering.model.fit import fit_steering


def chapter_nine(folder: Path) -> Section:
    """Mesh sequences steered by markers: frames that were not trained on."""
    rows = []
    for name, mesh in islice(
        meshes(folder), 1
    ):  # the thesis's own; the others take an hour: python -m bench.steering_meshes
        every = mesh.densities[0]
        way, off = compared(mesh, every)
        train = mesh.frames[::every]
        took = live(fit_steering(train, mesh.faces, mesh.markers, mesh.reference), mesh.frames, mesh.faces)
        errors = [f"{value:.2f}" for value in off.values()]
        rows.append([name, f"{mesh.frames.shape[1]}", str(len(train)), way, *errors, f"{took / 1000:.2f}"])
    head = [
        "mesh",
        "vertices",
        "frames trained",
        "way chosen",
        "ours",
        "skinning",
        "global PCA",
        "nearest frame",
        "ms a frame, part model",
    ]
    note = (
        "Mean error of frames that were not trained on, in % of the diagonal. The thesis shows pictures and prints no error; its MATLAB "
        '"synthesizes several frames per second". Its horse is ours (Sumner and Popovic); bunny and Kinect recordings are not at hand. '
        "Other meshes: [steering](lab/steering.md)."
    )
    return Section("9.5 Meshes steered by markers", head, rows, [note])


def chapter_ten(folder: Path) -> Section:
    """Figure 10.1: the runs of CMU 86_03, cut for a motion graph."""
    pose, truth = next((pose, truth) for _, name, pose, truth in recordings(folder) if name == "86_03")
    rows = [["thesis", "9, a double step each"], ["thesis, HACA", "4, two double steps each"]]
    for method in (RAW, ACA):
        found = METHODS[method](pose, truth)
        label = truth.labels(found.primitives.mean(axis=1)) == list(dict.fromkeys(truth.label)).index("run")
        cluster = np.bincount(found.cluster[label & (found.cluster >= 0)]).argmax()
        rows.append([method, str(int((found.cluster == cluster).sum()))])
    return Section(
        "10 Figure 10.1: segments in the cluster of the runs of CMU 86_03", ["", "segments"], rows,
        ["That ours make the graph of that figure is a test (`tests/motion/test_graph_of_runs.py`). Walks on graphs, seams and paths: "
         "[motion graphs](lab/motion-graphs.md)."],
    )  # fmt: skip


def main() -> None:
    folder = Path(os.environ.get("KINEGRAPH_DATA", ""))
    chapters: dict[str, Callable[[], list[Section]]] = {
        "2": lambda: chapter_two(folder / "segmentation"),
        "6": lambda: chapter_six(folder / "emg"),
        "7": lambda: [chapter_seven()],
        "9": lambda: [chapter_nine(folder)],
        "10": lambda: [chapter_ten(folder / "segmentation")],
    }
    parser = argparse.ArgumentParser(prog="python -m bench.thesis", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=list(chapters), default=list(chapters), metavar="CHAPTER")
    parser.add_argument("--write", action="store_true", help="into docs/thesis.md")
    given = parser.parse_args()
    if not os.environ.get("KINEGRAPH_DATA") or not folder.is_dir():
        sys.exit("KINEGRAPH_DATA must name a folder of recordings")
    for chapter in given.only:
        with np.errstate(all="ignore"):
            made = chapters[chapter]()
        text = f"By `python -m bench.thesis --only {chapter}`, {datetime.now(UTC):%Y-%m-%d}.\n\n{tables(made)}"
        print(text, flush=True)
        if given.write:
            into_page(HOUSE / "docs" / "thesis.md", text, *marks(f"bench.thesis --only {chapter}"))


if __name__ == "__main__":
    main()
