"""Which muscle of the one leg stands for which of the other, mixture by mixture."""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import StreamSpec, Times


def pairing(names: list[str], others: list[str]) -> Times:
    """The other leg's counterpart of each muscle: of the same name, ignoring a leading or trailing L or R; -1 without one."""

    def bare(name: str) -> str:
        short = name[1:] if name[:1] in "LR" else name
        return short[:-1].rstrip(" _-") if short[-1:] in "LR" and len(short) > 2 else short

    exact = [others.index(name) if name in others else -1 for name in names]
    plain = [bare(name) for name in others]
    return np.array(
        [
            k if k >= 0 else plain.index(bare(name)) if bare(name) in plain else -1
            for k, name in zip(exact, names, strict=True)
        ]
    )


def limb_pairing(group: Times, limb: Times, spec: StreamSpec) -> Times:
    """The counterpart of each mixture among those of two limbs: of the other limb's same muscles; else -1."""
    muscles = dict(spec.meta.get("muscles") or {})
    named = [{muscles.get(spec.channels[k], spec.channels[k]) for k in row[row >= 0]} for row in group]
    found = np.full(len(group), -1)
    for i, mine in enumerate(named):
        others = [k for k, theirs in enumerate(named) if theirs == mine and limb[k] != limb[i]]
        found[i] = others[0] if len(others) == 1 else -1
    return found
