"""kinegraph for Python programs and notebooks: a tour. `import kinegraph as kg`; docs/use/python.md shows all of it at work.

An operator on an array. Its parameters are checked where they are given, as those of a YAML file are:

    from kinegraph.operators import Lowpass
    smooth = Lowpass(cutoff_hz=6)(array, rate_hz=1000)          # (n,) or (n, channels) in, the same out

A graph, on arrays or a recording, gives named results:

    graph = kg.Graph("low")
    graph.add("emg", kg.Input(channels=["TA", "SO"], rate_hz=1000, units=["uV"]))
    graph.add("smooth", Lowpass(cutoff_hz=6), "emg", record=True)
    results = graph.run(array)                                   # or graph.run("session"), a recording
    results["smooth"].data, results["smooth"].time               # stamps: int64 ns, the filter's delay subtracted
    results["smooth"].to_pandas()

The same graph is a YAML file, and a Python program:

    graph.save("low.yaml"); graph.to_python(); kg.load("low.yaml"); kg.load("treadmill_emg")

Live, recorded, and again from the recording, bit for bit:

    kg.run("treadmill_emg", "session", duration_s=5)
    kg.replay("treadmill_emg", "session").differing              # ()
    with kg.Recording.open("session") as recording:
        recording.series("envelope", 60, 70).to_xarray()         # ten seconds; also to_pandas, to_polars, to_mne

While it runs, in a program or a notebook (`async for`):

    with kg.live("treadmill_emg", ["cycles.closed"]) as session:
        for piece in session: piece.series

What `kinegraph batch` made of many recordings (docs/use/batch.md):

    kg.BatchResults("results").to_pandas("smooth")

An operator of one's own is a frozen dataclass (docs/extend/operator.md), held to the laws by `kg.try_(Gain)`:

    Operator, Outlet, Source, param, kernel, Case, Chunk, StreamSpec

What each name comes from is imported when it is first used.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING

from kinegraph.stream.system.lazy import offered

if TYPE_CHECKING:
    from kinegraph.stream.api.builder import GraphBuilder as Graph
    from kinegraph.stream.api.input import Input
    from kinegraph.stream.api.results import Results
    from kinegraph.stream.api.running import live, load, replay, run, try_
    from kinegraph.stream.batch.results import BatchResults
    from kinegraph.stream.chunk import Chunk, StreamSpec
    from kinegraph.stream.data.series import Series
    from kinegraph.stream.errors import KinegraphError
    from kinegraph.stream.kernel import kernel
    from kinegraph.stream.operator import Case, Operator
    from kinegraph.stream.outlet import Outlet
    from kinegraph.stream.params import param
    from kinegraph.stream.recording import Recording
    from kinegraph.stream.source import Source

__version__ = version("kinegraph")
__all__ = [
    "BatchResults",
    "Case",
    "Chunk",
    "Graph",
    "Input",
    "KinegraphError",
    "Operator",
    "Outlet",
    "Recording",
    "Results",
    "Series",
    "Source",
    "StreamSpec",
    "__version__",
    "kernel",
    "live",
    "load",
    "param",
    "replay",
    "run",
    "try_",
]

__getattr__, __dir__ = offered(
    __name__,
    {
        "BatchResults": "kinegraph.stream.batch.results",
        "Case": "kinegraph.stream.operator",
        "Chunk": "kinegraph.stream.chunk",
        "Graph": "kinegraph.stream.api.builder:GraphBuilder",
        "Input": "kinegraph.stream.api.input",
        "KinegraphError": "kinegraph.stream.errors",
        "Operator": "kinegraph.stream.operator",
        "Outlet": "kinegraph.stream.outlet",
        "Recording": "kinegraph.stream.recording",
        "Results": "kinegraph.stream.api.results",
        "Series": "kinegraph.stream.data.series",
        "Source": "kinegraph.stream.source",
        "StreamSpec": "kinegraph.stream.chunk",
        "kernel": "kinegraph.stream.kernel",
        "live": "kinegraph.stream.api.running",
        "load": "kinegraph.stream.api.running",
        "param": "kinegraph.stream.params",
        "replay": "kinegraph.stream.api.running",
        "run": "kinegraph.stream.api.running",
        "try_": "kinegraph.stream.api.running",
    },
)
