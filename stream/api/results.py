"""What a graph gave: every kept output as a series, by name."""

from __future__ import annotations

from kinegraph.stream.data.series import Series
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.text.html import table_html
from kinegraph.stream.text.short_names import whole_name


class Results(dict[str, Series]):
    """The outputs of a graph that was run on arrays or a recording: {"smooth": Series, "active.interval": Series}.

    The names of parts may be left out where it is plain which output is meant: "cycles.closed" for "leg.cycles.closed".
    A series has `time` (n,) int64 ns, `data` (n, *shape), `lost`, its `spec`, and `to_pandas()`.

    differing   edges of the recording that came out differently; empty for arrays
    """

    differing: tuple[str, ...] = ()

    def __missing__(self, name: str) -> Series:
        if (whole := whole_name(name, self)) in self:
            return self[whole]
        raise NoSuchOutput(f"no output {name!r} was kept; {nearest(name, self)}")

    def _repr_html_(self) -> str:
        rows = [(name, len(s), s.spec.describe()) for name, s in self.items()]
        return table_html(("output", "samples", "of"), rows)

    def __repr__(self) -> str:
        rows = [f"  {name}: {len(s.time)} samples of {s.spec.describe()}" for name, s in self.items()]
        return "\n".join(["Results", *rows])


class NoSuchOutput(KinegraphError, KeyError):
    """A name that no output of the results has."""

    __str__ = Exception.__str__
