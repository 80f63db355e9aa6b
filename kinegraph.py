"""kinegraph for Python programs and notebooks: a tour. `import kinegraph as kg`; docs/python.md shows all of it at work.

An operator on an array. Its parameters are checked where they are given, as those of a YAML file are:

    from operators import Lowpass
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

What `kinegraph batch` made of many recordings (docs/batch.md):

    kg.BatchResults("results").to_pandas("smooth")

An operator of one's own is a frozen dataclass (docs/operators.md), held to the laws by `kg.try_(Gain)`:

    Operator, Outlet, Source, param, kernel, Case, Chunk, StreamSpec

What each name comes from is imported when it is first used.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING

from stream.lazy import offered

if TYPE_CHECKING:
    from stream.batch.results import BatchResults
    from stream.chunk import Chunk, StreamSpec
    from stream.errors import KinegraphError
    from stream.face.builder import GraphBuilder as Graph
    from stream.face.results import Results
    from stream.face.running import live, load, replay, run, try_
    from stream.given import Input
    from stream.kernel import kernel
    from stream.operator import Case, Operator
    from stream.outlet import Outlet
    from stream.params import param
    from stream.recording import Recording
    from stream.series import Series
    from stream.source import Source

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
        "BatchResults": "stream.batch.results",
        "Case": "stream.operator",
        "Chunk": "stream.chunk",
        "Graph": "stream.face.builder:GraphBuilder",
        "Input": "stream.given",
        "KinegraphError": "stream.errors",
        "Operator": "stream.operator",
        "Outlet": "stream.outlet",
        "Recording": "stream.recording",
        "Results": "stream.face.results",
        "Series": "stream.series",
        "Source": "stream.source",
        "StreamSpec": "stream.chunk",
        "kernel": "stream.kernel",
        "live": "stream.face.running",
        "load": "stream.face.running",
        "param": "stream.params",
        "replay": "stream.face.running",
        "run": "stream.face.running",
        "try_": "stream.face.running",
    },
)
