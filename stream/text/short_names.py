"""Names without those of the parts around them: "cycles.closed" for "leg.cycles.closed", where only one stream or node is called so."""

from __future__ import annotations

from collections.abc import Collection


def whole_name(name: str, known: Collection[str]) -> str:
    """The one of the known names that is meant: this one, or the only one that ends in it; the name itself where that is not plain."""
    if name in known:
        return name
    longer = [one for one in known if one.endswith(f".{name}")]
    return longer[0] if len(longer) == 1 else name
