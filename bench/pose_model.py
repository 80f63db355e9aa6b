"""`python -m bench.pose_model FOLDER`: make `operators/pose/people.npz`, the pose model that avatars before a camera use.

FOLDER holds cmu_mocap_30hz.npz and human_male.npz (CMU Graphics Lab Motion Capture Database; a mesh of MakeHuman, CC0), as for bench.pose.
Markers err by 15 mm, as a camera's do after all filters. Left out are the sequences that `bench.avatar_clips` reports on.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bench.avatar_clips import LEFT_OUT
from bench.pose import sequences
from kinegraph.operators.pose.landmarks import NAMES, USUAL
from kinegraph.operators.pose.learn import learn_pose, lessons_of
from kinegraph.operators.pose.operator import MODELS
from kinegraph.stream.data.model_file import write_model

NOISE_M, CENTRES = 0.015, 500


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.pose_model", description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--out", type=Path, default=MODELS["people"])
    given = parser.parse_args()
    tree, motion = sequences(given.folder)
    chosen = np.array(sorted(NAMES.index(name) for name in USUAL), np.int64)
    unseen = {sequence for _, sequence, _, _ in LEFT_OUT}
    trained_on = sorted(set(motion) - unseen)
    lessons = [one for name in trained_on for one in lessons_of(tree, motion[name], chosen, NOISE_M)]
    learned = {
        name: a.astype(np.float32) if a.dtype == np.float64 else a
        for name, a in learn_pose(lessons, chosen, CENTRES).items()
    }
    header = {
        "landmarks": [NAMES[k] for k in chosen],
        "noise_mm": 1000 * NOISE_M,
        "trained_on": [f"CMU {name}" for name in trained_on],
    }
    write_model(given.out, "pose", header, {**learned, "landmarks": chosen, "offsets": tree.offsets})
    print(f"{given.out}: {sum(len(one.features) for one in lessons) // 2} poses of {len(trained_on)} sequences")


if __name__ == "__main__":
    main()
