"""A step model: a random forest as plain arrays, what it was trained on, and how far it can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.operators.steps.forest_kernel import forest_probabilities
from kinegraph.operators.steps.step_kernel import chosen
from kinegraph.stream.chunk import Array, Samples, StreamSpec, Times
from kinegraph.stream.data.model_file import ModelError, read_model, write_model
from kinegraph.stream.errors import InputError

KIND = "steps"


@dataclass(slots=True)
class Forest:
    """Nodes of all trees one after another (see `forest_kernel`); `share` (nodes, classes)."""

    roots: Times
    feature: Times
    threshold: Samples
    left: Times
    right: Times
    share: Samples

    @staticmethod
    def of(trained: Any) -> Forest:
        """The arrays of a fitted sklearn.ensemble.RandomForestClassifier."""
        trees = [tree.tree_ for tree in trained.estimators_]
        sizes = np.array([tree.node_count for tree in trees])
        roots = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)

        def children(name: str) -> Times:
            parts = [getattr(tree, name) for tree in trees]
            return np.concatenate([np.where(p >= 0, p + r, -1) for p, r in zip(parts, roots, strict=True)]).astype(
                np.int64
            )

        feature = np.concatenate([tree.feature for tree in trees]).astype(np.int64)
        threshold = np.concatenate([tree.threshold for tree in trees])
        share = np.concatenate([tree.value[:, 0, :] for tree in trees])
        return Forest(
            roots,
            feature,
            threshold,
            children("children_left"),
            children("children_right"),
            np.ascontiguousarray(share),
        )

    def probabilities(self, x: Samples) -> Samples:
        """Of each class, for the features `x` (f,)."""
        out = np.empty(self.share.shape[1])
        forest_probabilities(x, self.roots, self.feature, self.threshold, self.left, self.right, self.share, out)
        return out


@dataclass(frozen=True, slots=True)
class StepModel:
    """forest; classes; which of the 50 features it takes; header: sensor site, rate, axes, accuracies, the threshold of "uncertain"."""

    forest: Forest
    classes: list[str]
    features: Times
    header: dict[str, Any]

    def write(self, path: Path) -> None:
        """Raises OSError."""
        arrays: dict[str, Array] = {name: getattr(self.forest, name) for name in Forest.__slots__}
        write_model(path, KIND, {**self.header, "classes": self.classes}, arrays)

    @staticmethod
    def read(path: Path) -> StepModel:
        """Raises ModelError for a file that is missing, broken or something else."""
        model = read_model(path, KIND)
        try:
            classes = [str(name) for name in model.header["classes"]]
            features = np.array(chosen(model.header["features"]))
            threshold = float(model.header["uncertain_below"])
            rate, site, axes = float(model.header["rate_hz"]), str(model.header["site"]), str(model.header["axes"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise ModelError(f"{path}: the header does not say {error}: train it again") from None
        share = model.array("share", (None, len(classes)))
        n = len(share)
        forest = Forest(
            model.array("roots", (None,), np.int64), model.array("feature", (n,), np.int64), model.array("threshold", (n,)),
            model.array("left", (n,), np.int64), model.array("right", (n,), np.int64), share,
        )  # fmt: skip
        _check_nodes(path, forest, len(features))
        known = {"uncertain_below": threshold, "rate_hz": rate, "site": site, "axes": axes}
        return StepModel(forest, classes, features, {**model.header, **known})

    def check_steps(self, spec: StreamSpec, path: str) -> None:
        """Raise InputError unless these steps are of the sensor site, rate and axes that the model was trained on."""
        for what, key in (("sensor site", "site"), ("axes", "axes")):
            if spec.meta.get(key) != self.header[key]:
                raise InputError(
                    "in", f"{what} {spec.meta.get(key)!r}", f"{self.header[key]!r}, as {path} was trained on"
                )
        rate, trained = float(spec.meta.get("imu_rate_hz", 0.0)), self.header["rate_hz"]
        if abs(rate - trained) > 0.03 * trained:
            raise InputError(
                "in", f"a sensor at {rate:g} Hz", f"one at {trained:g} Hz within 3 %, as {path} was trained on"
            )
        if self.features.max() >= 26 and not spec.meta.get("angular_velocity"):
            raise InputError("in", "steps without angular velocity", f"steps with it, as {path} was trained on")


def _check_nodes(path: Path, forest: Forest, features: int) -> None:
    """Refuse a file with trees that leave the arrays or run in circles."""
    n, at = len(forest.share), np.arange(len(forest.share))
    inner = forest.left >= 0
    sound = (
        len(forest.roots) > 0
        and ((forest.roots >= 0) & (forest.roots < n)).all()
        and ((forest.left > at) & (forest.right > at) & (forest.left < n) & (forest.right < n))[inner].all()
        and ((forest.feature >= 0) & (forest.feature < features))[inner].all()
    )
    if not sound:
        raise ModelError(f"{path}: the trees are broken")
