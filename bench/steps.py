"""Steps of one inertial sensor: detection, and accuracy of forests, on the recordings of `KINEGRAPH_DATA`.

python -m bench.steps                 # everything; some ten minutes
python -m bench.steps --only detection
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from bench.step_votes import votes
from bench.step_walks import SPEC, activities, detection, folder, lengths, lower_back, neighbours
from kinegraph.operators.steps.commands.enrolment import enrolment
from kinegraph.operators.steps.commands.recordings import grouped
from kinegraph.operators.steps.commands.train import show_enrolment, show_trust
from kinegraph.operators.steps.commands.validation import SETS, Labelled, trust
from kinegraph.operators.steps.steps import Steps
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Times
from kinegraph.stream.text.safe_text import say


def foot() -> Iterator[tuple[str, str, Times, Samples, dict[str, str]]]:
    """Person, trial, stamps by packet counter, samples and facts of the right foot's sensor."""
    for path in sorted(folder().glob("imu_voisard_*.npz")):
        d = np.load(path)
        facts = {name: str(d[name]) for name in ("gender", "age", "height") if name in d.files}
        for key in (key for key in d.files if key.endswith("_rf")):
            yield (
                path.stem[-3:],
                key[:-3],
                d[f"{key}_counter"].astype(np.int64) * (NS // 100),
                d[key].astype(float),
                facts,
            )


def phones(site: str) -> Iterator[tuple[str, str, Times, Samples, dict[str, str]]]:
    """Person, trial, stamps of an even 100 Hz grid, samples while walking, and facts; sp: pocket, sw: wrist."""
    for path in sorted(folder().glob("imu_geotec_*.npz")):
        d = np.load(path)
        facts = {name: str(d[name]) for name in ("gender", "age", "height") if name in d.files}
        for key in d.files:
            if key.startswith(site) and key.endswith("_imu"):
                t = key[:-4]
                stamp, data, walking = d[f"{t}_t_ms"].astype(float), d[key].astype(np.float64), d[f"{t}_label"] == 2
                rate = (len(stamp) - 1) / (stamp[-1] - stamp[0]) * 1000
                steady = stamp[0] + np.arange(len(stamp)) * 1000 / rate
                even = np.arange(steady[0], steady[-1], 10.0)
                inside = np.interp(even, steady, walking.astype(float)) > 0.5
                resampled = np.stack([np.interp(even, steady, data[:, c]) for c in range(6)], 1)
                resampled[~inside] = np.nan
                yield path.stem[-3:], t, np.round((even - even[0]) * 1e6).astype(np.int64), resampled, facts


def found_steps(site: str, stamps: Times, data: Samples, axes: str) -> Array:
    finder = Steps(site=site, axes=axes)  # type: ignore[arg-type]
    finder.open({"in": SPEC})
    rows = finder.process("in", Chunk(stamps, data, int(stamps[-1]))).data
    return np.asarray(rows[(rows["kind"] == "walk") & np.isfinite(rows["features"]).all(axis=1)])


def dataset(site: str, target: str, axes: str) -> Labelled:
    """The steps of all people of a site, with their classes."""
    if site == "lower_back":
        walks = [
            (t.person, f"{t.person} {t.name}", found_steps(site, t.stamps, t.data, axes), t.facts) for t in lower_back()
        ]
    else:
        worn = foot() if site == "foot" else phones({"pocket": "sp", "wrist": "sw"}[site])
        walks = [(p, f"{p} {t}", found_steps(site, s, d, axes), facts) for p, t, s, d, facts in worn]
    walks = [walk for walk in walks if len(walk[2]) and walk[3].get(target) != "nan"]
    raw = {name: (person, person if target == "person" else facts[target]) for person, name, _, facts in walks}
    classes = grouped(raw, target)
    persons = np.concatenate([[p] * len(rows) for p, _, rows, _ in walks])
    names = np.concatenate([[name] * len(rows) for _, name, rows, _ in walks])
    features = np.concatenate([rows["features"] for _, _, rows, _ in walks])
    return Labelled(features, np.array([classes[name][1] for name in names]), persons, names)


def accuracy(sites: list[str], targets: list[str], axes: list[str], shuffles: int) -> None:
    """Random split and people left out, each set of features."""
    for site in sites:
        for target in targets:
            for axis in axes:
                given = dataset(site, target, axis)
                title = f"{target}, {site}, axes by {axis}: {len(given.labels)} steps of {len(np.unique(given.persons))} people"
                tried = [trust(given, name, 60, shuffles) for name in SETS]
                show_trust(tried, title)
                for t in tried:
                    where = f"{target}, {site.replace('_', ' ')} ({axis})" if t is tried[0] else ""
                    say(
                        f"| {where} | {t.features.replace('_', ' ')} | {t.random:.3f} | {t.subjects:.3f} | {t.majority:.3f} | "
                        f"{t.voted} of {t.people} ({t.low:.2f}-{t.high:.2f}) | {t.chance:.2f} |"
                    )


def enrolled() -> None:
    """Who is it, of those enrolled?"""
    given = dataset("lower_back", "person", "gravity")
    show_enrolment(enrolment(given, "both", 60), len(np.unique(given.persons)))


def sites() -> None:
    """Pocket and wrist, without annotated contacts: the cadence of the steps beside that of the signal's own period."""
    for site, short in (("pocket", "sp"), ("wrist", "sw")):
        ratios, stretches = list[float](), 0
        for _, _, stamps, data, _ in phones(short):
            rows = found_steps(site, stamps, data, "gravity")
            for a, b in walked_for(data, 200):
                mine = rows["duration_s"][(rows["onset"] >= stamps[a]) & (rows["end"] <= stamps[b - 1])]
                stretches += 1
                ratios.append(period_s(data[a:b, :3]) / float(np.median(mine)) if len(mine) else 0.0)
        found = np.array(ratios)
        near = {
            name: int((np.abs(found / times - 1) < 0.1).sum())
            for name, times in (("1", 1.0), ("half", 0.5), ("twice", 2.0))
        }
        counts = ", ".join(f"{name} {n}" for name, n in near.items())
        say(
            f"{site}: cadence over that of the signal's period, {stretches} stretches of 2 s or more: {counts} (within 10 %)"
        )


def walked_for(data: Samples, least: int) -> list[tuple[int, int]]:
    """Where so many rows or more are known without a break: first, end."""
    known = np.concatenate([[False], np.isfinite(data).all(axis=1), [False]])
    edges = np.flatnonzero(np.diff(known.astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= least]


def period_s(acceleration: Samples) -> float:
    """The lag of 0.36 to 0.9 s at which the norm (100 Hz) is most like itself."""
    norm = np.linalg.norm(acceleration, axis=1)
    norm -= norm.mean()
    lags = np.arange(36, 91)
    return float(lags[np.argmax([(norm[k:] * norm[:-k]).mean() for k in lags])]) / 100


MEASURES = {
    "detection": detection, "neighbours": neighbours, "lengths": lengths, "activities": activities, "sites": sites,
    "enrolment": enrolled,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.steps", description=__doc__)
    parser.add_argument("--only", nargs="+", default=[*MEASURES, "accuracy", "votes"])
    parser.add_argument("--sites", nargs="+", default=["lower_back", "foot", "pocket", "wrist"])
    parser.add_argument("--targets", nargs="+", default=["gender", "age", "height"])
    parser.add_argument("--axes", nargs="+", default=["sensor", "gravity"])
    parser.add_argument("--shuffles", type=int, default=39)
    given = parser.parse_args()
    for name in given.only:
        if name == "votes":
            for site, axis in ((site, axis) for site in given.sites for axis in given.axes):
                votes(dataset(site, "gender", axis), f"{site.replace('_', ' ')} ({axis})")
        elif name == "accuracy":
            accuracy(given.sites, given.targets, given.axes, given.shuffles)
        else:
            MEASURES[name]()


if __name__ == "__main__":
    main()
