"""Chapters 6 and 7 of the thesis beside ours, for `bench.thesis`: muscles in the gait cycle, and classes of who walks by one sensor."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bench.emg_session import drive
from bench.report import Section
from bench.steps import dataset
from kinegraph.operators.contacts.contacts import CONTACT
from kinegraph.operators.contacts.marker import MarkerContacts
from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.emg.commands.comparison import scatter
from kinegraph.operators.emg.commands.session_cycles import SessionCycles
from kinegraph.operators.emg.envelope import Envelope
from kinegraph.operators.emg.mixtures.operator import PeakMixtures
from kinegraph.operators.emg.mixtures.refit import highest_apart
from kinegraph.operators.steps.commands.validation import SETS, Trust, trust
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec

MARKERS = ("LHIP", "LKNE", "LANK", "LTOE", "RHIP", "RKNE", "RANK", "RTOE")
FAULTY = {("S1_FLOAT", "LTA"), ("S2_NO_FLOAT", "LMG")}
TREES = 40
ABOUT_CYCLES = (
    "Mean distance of a cycle to the mean curve / MAD, medians over muscles. Horses there, trot and walk, "
    "eight muscles of the back and croup; "
    "people here (four overground, one on a treadmill), leg muscles, envelopes at 20 Hz. Heights are shares of the muscle's highest value "
    "in the session, as there. Faulty channels, as the recordings' authors name them, are left out. *Plain* is the thesis's mixture "
    "(`merge_nats`, `rest_sd`, `of_peak` 0, `contrast` 1, not circular); *ours* leaves rest out and merges "
    "modes that are nearly one, which the "
    "thesis proposes (6.4.1), so it is farther from a mixture of all points by design. A session has 5 to 12 cycles here, 10 to 50 there."
)


def walks(folder: Path) -> Iterator[tuple[str, SessionCycles]]:
    """Each leg of each session: people overground (contacts from markers), one on a treadmill (contacts as they came)."""
    for path in sorted(folder.glob("emg_epfl_*.npz")):
        name = path.stem.removeprefix("emg_epfl_")
        with np.load(path) as found:
            trials = sorted(
                key.removesuffix("_emg") for key in found.files if key.startswith("T_") and key.endswith("_emg")
            )
            for side, first in (("left", 0), ("right", 2)):
                muscles = tuple(f"{side[0].upper()}{muscle}" for muscle in ("TA", "MG"))
                one = [
                    cycles_of(found[f"{t}_emg"][:, first : first + 2], muscles, contacts_of(found[f"{t}_kin"], side)) for t in trials
                ]  # fmt: skip
                yield name, joined(f"{name} {side}", muscles, one)
    with np.load(folder / "emg_santuz_tw12.npz") as found:
        muscles = tuple(str(name) for name in found["names"])
        feet = {}
        for port, key in (("touchdown", "touchdown_s"), ("liftoff", "liftoff_s")):
            onset = np.round((found[key] - found["t_s"][0]) * NS).astype(np.int64)
            feet[port] = (StreamSpec((), CONTACT, units=("ns",), meta={"side": "right"}), onset, onset.view(CONTACT))
        yield "treadmill", joined("treadmill right", muscles, [cycles_of(found["emg_uV"], muscles, feet)])


def contacts_of(markers: Array, side: str) -> dict[str, tuple[StreamSpec, Array, Array]]:
    spec = StreamSpec((8, 3), rate_hz=100.0, channels=MARKERS, units=("mm",))
    finder = MarkerContacts(marker=f"{side[0].upper()}TOE", reference=f"{side[0].upper()}HIP", side=side)  # type: ignore[arg-type]
    stamps = np.arange(len(markers)) * (NS // 100)
    return drive(finder, {"in": (spec, stamps, markers.astype(float))})


def cycles_of(
    emg: Array, muscles: tuple[str, ...], feet: dict[str, tuple[StreamSpec, Array, Array]]
) -> dict[str, tuple[StreamSpec, Array, Array]]:
    spec = StreamSpec((len(muscles),), rate_hz=1000.0, channels=muscles, units=("uV",))
    envelope = drive(Envelope(), {"in": (spec, np.arange(len(emg)) * (NS // 1000), emg.astype(float))})["out"]
    return drive(Cycles(), {"signal": envelope, **feet})


def joined(
    label: str, muscles: tuple[str, ...], trials: list[dict[str, tuple[StreamSpec, Array, Array]]]
) -> SessionCycles:
    """The accepted cycles of all trials, each muscle's height as a share of its highest (6.2.3), numbered on."""
    curves, maxima, numbers = [], [], []
    for k, made in enumerate(trials):
        closed = {int(row["number"]): str(row["rejected"]) for row in made["closed"][2]}
        accepted = made["closed"][2]["number"][made["closed"][2]["rejected"] == ""]
        used = np.array([closed[int(number)] == "" for number in accepted], bool)
        peaks = made["maxima"][2].copy()
        peaks["number"] += 1000 * k
        curves.append(made["cycles"][2][used])
        numbers.append(accepted[used] + 1000 * k)
        maxima.append(peaks)
    found, peaks = np.concatenate(curves), np.concatenate(maxima)
    highest = np.nanmax(found, axis=(0, 1)) if len(found) else np.ones(len(muscles))
    peaks["height"] /= highest[peaks["muscle"]]
    spec = trials[0]["cycles"][0]
    return SessionCycles(
        label, label, spec, np.concatenate(numbers), found / highest, peaks, {}, np.empty(len(found)), np.array([""] * len(found))
    )  # fmt: skip


def of_table(folder: Path) -> list[tuple[str, SessionCycles]]:
    return [(name, one) for name, one in walks(folder) if len(one.curves) >= 5]


def chapter_six(folder: Path) -> list[Section]:
    """Tables 6.1 to 6.7, of what is at hand."""
    sessions = of_table(folder)
    ours = PeakMixtures(cycles=500)
    plain = PeakMixtures(cycles=500, merge_nats=0.0, rest_sd=0.0, of_peak=0.0, contrast=1.0, circular=False)
    means: dict[str, list[Samples]] = {}
    for _, one in sessions:
        for m, muscle in enumerate(one.muscles):
            means.setdefault(muscle, []).append(one.curves[:, :, m].mean(axis=0))
    rows, apart, every = [], dict[str, list[float]](), dict[str, list[float]]()
    for name, one in sessions:
        good = [m for m, muscle in enumerate(one.muscles) if (name, muscle) not in FAULTY]
        own = np.array([scatter(one.curves[:, :, m], one.curves[:, :, m].mean(axis=0))[:2] for m in good])
        shared = [m for m in good if len(means[one.muscles[m]]) > 1]
        group = np.array([scatter(one.curves[:, :, m], np.mean(means[one.muscles[m]], axis=0))[:2] for m in shared])
        cells = [pair(own), pair(group) if len(group) else "-"]
        every.setdefault("own", []).extend(own[:, 0])
        every.setdefault("group", []).extend(group[:, 0] if len(group) else [])
        for way, mixer in (("plain", plain), ("ours", ours)):
            made, _ = one.references(mixer, 0, 2)
            modes, full, noise = (of[good] for of in (made.modes, made.full, made.noise))
            cells += [
                f"{np.nanmedian(full):.2f}",
                f"{np.nanmedian(noise / full):.1f}",
                f"{modes.min()} to {modes.max()}",
            ]
            every.setdefault(f"{way} full", []).extend(full)
            every.setdefault(f"{way} noise", []).extend(noise / full)
            far = [highest_apart(made.means[m], int(max(made.modes[m], 0))) for m in good]
            apart.setdefault(way, []).extend(value for value in far if np.isfinite(value))
        rows.append([one.label, str(len(one.curves)), *cells])
    middle = {key: f"{np.nanmedian(values):.2f}" for key, values in every.items()}
    last = [middle["own"], middle["group"]]
    for way in ("plain", "ours"):
        last += [middle[f"{way} full"], middle[f"{way} noise"], ""]
    rows.append(["**median**", "", *last])
    rows.append(
        ["thesis, trot, median", "709 in 14", "1.11 / .24", "1.45 / .24", "0.21", "4", "5 to 11", "-", "-", "-"]
    )
    rows.append(
        ["thesis, walk, median", "426 in 14", "1.10 / .22", "1.36 / .24", "0.10", "9", "6 to 13", "-", "-", "-"]
    )
    bins = [[f"ours, {way}" if way == "plain" else way, *in_tens(values)] for way, values in apart.items()]
    head = ["session and leg", "cycles", "about the own mean (6.1, 6.2)", "about the group's mean (6.3, 6.4)"]
    head += [
        "plain: full against peaks (6.5)",
        "noise over full",
        "modes (6.6)",
        "ours: full against peaks",
        "noise over full",
        "modes",
    ]
    return [
        Section("6.3 Tables 6.1 to 6.6: scatter of cycles, and mixtures of their peaks", head, rows, [ABOUT_CYCLES]),
        Section(
            "6.3.2 Table 6.7: distance of the two highest modes, in % of the cycle",
            ["", "0-10", "10-20", "20-30", "30-40", "40-50"],
            [*bins, ["thesis, walk", "-", "9", "16", "37", "51"], ["thesis, trot", "-", "10", "24", "23", "44"]],
            ["Counts of legs, sessions and muscles; of the thesis the sums over its eight muscles."],
        ),
    ]


def in_tens(values: list[float]) -> list[str]:
    return [str(sum(a <= value < a + 10 or (a == 40 and value == 50) for value in values)) for a in (0, 10, 20, 30, 40)]


def pair(values: Samples) -> str:
    return f"{np.median(values[:, 0]):.2f} / {np.median(values[:, 1]):.2f}"


def chapter_seven() -> Section:
    """Classification by random split and by person, each place and set of features."""
    rows = []
    for site in ("lower_back", "foot", "pocket", "wrist"):
        for target in ("gender", "age", "height"):
            given = dataset(site, target, "gravity")
            for features in SETS if target == "gender" else ("both",):
                found = trust(given, features, TREES, 0)
                rows.append([
                    f"{target}, {site.replace('_', ' ')}", features.replace("_", " "), f"{found.random:.0%}", f"{found.subjects:.0%}",
                    f"{found.majority:.0%}", *mean_of_classes(found),
                ])  # fmt: skip
    return Section(
        "7 What one inertial sensor says of who walks: rates of steps",
        ["", "features", "random split", "by person", "always the commonest", "sensitivity", "specificity", "PPV"], rows,
        ["Thesis: 26 people, four places, \"high accuracy values in all classification tasks\" by both splits; this chapter prints "
         "no number. Here: 13 people (lower back, foot) and 15 (pocket, wrist), age and height in three "
         "classes. By person means that nothing of the "
         "person was trained on; sensitivity, specificity and PPV are of that split, means over the classes. Ours is worse by person: it "
         "does not exceed the commonest class in most rows, so kinegraph does not claim these traits ([steps](lab/steps.md))."],
    )  # fmt: skip


def mean_of_classes(found: Trust) -> list[str]:
    return [
        f"{np.nanmean([getattr(one, field) for one in found.per_class]):.0%}" for field in ("sensitivity", "specificity", "predictive")
    ]  # fmt: skip
