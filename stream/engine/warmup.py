"""Before any device opens: sources prepare and operators are tried, so that nothing compiles while a graph runs.

Two trials for each operator: its own `warm_up_cases`, which reach every kernel, and made-up samples under the specs of this graph, which
also show whether the operator keeps the promises of its specs. The latter are given to the operator that is going to run, and its state is
put back afterwards: the laws say that its state is all that it remembers. Nothing says so of an operator from outside our packages; another
one with the same parameters is opened and tried in its place.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, MutableMapping
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import structlog

from kinegraph.stream.chunk import FOREVER, NS, Chunk, Specs, StreamSpec, empty
from kinegraph.stream.data.rows import taking
from kinegraph.stream.engine.ahead import CompilationReport, compiling_beside
from kinegraph.stream.engine.flow.admission import soundness
from kinegraph.stream.engine.flow.edge import CallSlot
from kinegraph.stream.engine.flow.merge import Merge
from kinegraph.stream.engine.flow.metrics import Timing
from kinegraph.stream.engine.pipeline import Pipeline, Stage
from kinegraph.stream.errors import (
    DeviceError,
    GraphError,
    Interrupted,
    KinegraphError,
    ParameterError,
    asked_to_end,
    blaming,
    explain,
    interruption,
)
from kinegraph.stream.graph import Graph, Node
from kinegraph.stream.graph import components as parts
from kinegraph.stream.operator import Emitted, Operator, grid
from kinegraph.stream.recording.format.overview import overview_of
from kinegraph.stream.source import Source

SAMPLES = 64

log = structlog.get_logger(__name__)


def warm_up(
    pipeline: Pipeline,
    stopped: Callable[[], bool] = bool,
    report: CompilationReport = lambda text, over: None,
    *,
    compiles_only: bool = False,
) -> None:
    """Compile (or load from the cache) all kernels of a graph, and the engine's own; with `compiles_only` also without a device's library.

    `stopped` is asked between two nodes. Raises GraphError where an operator breaks its specs' promises, Interrupted once `stopped`: a
    compiler may turn Ctrl-C into another error, or swallow it.
    """
    graph = pipeline.graph

    def meanwhile() -> None:
        _run_engine(graph)
        for node in graph.sources:
            if isinstance(node.part, Source):
                node.part.prepare()

    with compiling_beside(tried(graph), stopped, report, meanwhile):
        _run_engine(graph)
        _warm_up(pipeline, stopped, compiles_only)


def tried(graph: Graph) -> set[type[Operator[Any]]]:
    """The operators that a warm-up tries."""
    return {type(node.part) for node in graph.nodes.values() if isinstance(node.part, Operator) and not node.is_outlet}


def _run_engine(graph: Graph) -> None:
    """The engine's own kernels: those of its figures, of what it admits, and of what it records."""
    timing = Timing()
    timing.durations.append(1)
    timing.read()
    soundness(StreamSpec(()))(empty(StreamSpec(()), NS))
    if graph.recorded_in:
        for node in graph.sources:
            for spec in node.specs.values():
                overview_of(spec, "whole")


def _warm_up(pipeline: Pipeline, stopped: Callable[[], bool], compiles_only: bool) -> None:
    seen: set[type[Any]] = set()
    graph = pipeline.graph
    for node in graph.nodes.values():
        if stopped():
            raise Interrupted
        if isinstance(node.part, Source):
            try:
                with blaming(node.name, "prepare"):
                    node.part.prepare()
            except ParameterError as error:
                raise GraphError(str(error), path=node.file or graph.path, line=node.line, node=node.name) from None
            except DeviceError:
                if not compiles_only:
                    raise
        if not isinstance(node.part, Operator) or node.is_outlet:
            continue
        try:
            with _unheard():
                if type(node.part) not in seen:
                    seen.add(type(node.part))
                    run_cases(node.part)
                _run_made_up(graph, pipeline.stages[node.name])
        except BaseException as error:
            if asked_to_end(error) or isinstance(error, KinegraphError):
                raise
            if stopped() or interruption(error):
                raise interruption(error) or Interrupted() from None
            raise GraphError(
                f"fails on samples made up to try it: {explain(error)}",
                path=node.file or graph.path,
                line=node.line,
                node=node.name,
            ) from error


@contextmanager
def _unheard() -> Iterator[None]:
    """Within: what this thread logs is left out, however logging is set up; operators that are tried log about made-up samples."""
    ours, before = threading.get_ident(), structlog.get_config()["processors"]

    def left_out(_logger: object, _method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        if threading.get_ident() == ours:
            raise structlog.DropEvent
        return event

    structlog.configure(processors=[left_out, *before])
    try:
        yield
    finally:
        structlog.configure(processors=before)


def run_cases(part: Operator[Any] | type[Operator[Any]]) -> None:
    """Run an operator on its own cases for the warm-up, which reach every kernel."""
    for case in part.warm_up_cases():
        operator = case.operator.unopened()
        specs = {port: spec for port, (spec, _, _) in case.inputs.items()}
        operator.open(specs)
        take = taking(operator, specs)
        merge = Merge(specs, operator.inputs)
        pieces = [(port, piece) for port, given in case.inputs.items() for piece in _pieces(*given)]
        ends = [
            (port, empty(spec, FOREVER)) for port, spec in specs.items()
        ]  # nothing is left waiting for another input
        for port, piece in [*pieces, *ends]:
            for name, merged in merge.push(port, piece):
                with suppress(KinegraphError):
                    _process(operator, name, take(name, merged))
        operator.close()


def _run_made_up(graph: Graph, stage: Stage) -> None:
    """Made-up signals and frames under the node's own specs, in the order of time as in a session; events are left to the cases, for their
    fields have meanings."""
    node, operator, specs = stage.node, stage.operator, graph.input_specs(stage.node)
    promised = {name: edge.spec for name, edge in stage.edges.items()}
    if parts.is_ours(operator):
        state = operator.snapshot()
        _try(graph, node, operator, specs, promised)
        operator.restore(state)
    else:
        scratch = operator.unopened()
        _try(graph, node, scratch, specs, scratch.open(specs))


def _try(graph: Graph, node: Node, operator: Operator[Any], specs: Specs, promised: Specs) -> None:
    take = taking(operator, specs)
    merge = Merge(specs, operator.inputs)
    given = {port: made_up(spec, SAMPLES) for port, spec in specs.items() if not spec.is_event}
    horizon = max((int(times[-1]) for times, _ in given.values() if len(times)), default=NS)
    pieces = [(port, piece) for port, samples in given.items() for piece in _pieces(specs[port], *samples)]
    for port, piece in [*pieces, *((port, empty(spec, horizon)) for port, spec in specs.items())]:
        for name, merged in merge.push(port, piece):
            check_promises(node, promised, _process(operator, name, take(name, merged)))


def _process(operator: Operator[Any], port: str, chunk: Chunk) -> Emitted:
    """Give an operator a chunk as the engine does; raises ValueError where it writes into it."""
    process = operator.process if parts.is_ours(operator) else CallSlot().read_only(operator.process)
    before = chunk.time.tobytes(), chunk.data.tobytes()
    emitted = process(port, chunk)
    if before != (chunk.time.tobytes(), chunk.data.tobytes()):
        raise ValueError(f"it writes into its input {port!r}, which others read; let it work on a copy")
    return emitted


def _pieces(spec: StreamSpec, times: Any, data: Any) -> Iterable[Chunk]:
    """The samples in two chunks and an empty one."""
    half = len(times) // 2
    whole = Chunk(times, data, int(times[-1]) if len(times) else NS)
    if half:
        yield whole.part(0, half)
        yield whole.part(half, len(times))
    yield empty(spec, whole.until)


def made_up(spec: StreamSpec, n: int, seed: int = 0) -> tuple[Any, Any]:
    """Times (n,) and plausible numbers (n, *shape) for a stream that is not an event."""
    random = np.random.default_rng(seed)
    times = grid(spec.rate_hz or 100.0, n)
    if spec.dtype.kind in "iu":
        return times, random.integers(0, 100, (n, *spec.shape)).astype(spec.dtype)
    return times, random.standard_normal((n, *spec.shape)).astype(spec.dtype)


def check_promises(node: Node, promised: dict[str, StreamSpec], emitted: Emitted) -> None:
    """Raise GraphError if an operator's output differs from what its `open` declared."""
    if emitted is None:
        return
    pairs = [(next(iter(promised)), emitted)] if isinstance(emitted, Chunk) else emitted
    for output, chunk in pairs:
        if output not in promised:
            raise GraphError(f"emits on {output!r}, but `open` gave no spec for it", node=node.name)
        spec = promised[output]
        if chunk.data.dtype != spec.dtype or chunk.data.shape[1:] != spec.shape or len(chunk.data) != len(chunk.time):
            raise GraphError(
                f"emits {chunk.data.shape} {chunk.data.dtype} for {len(chunk.time)} stamps on {output!r};"
                f" `open` promised (n, {', '.join(map(str, spec.shape))}) {spec.dtype}",
                node=node.name,
                line=node.line,
            )


class Compilations:
    """Counts what numba compiles from now on, anywhere in this process; after warm-up there must be nothing."""

    def __init__(self) -> None:
        from numba.core import event

        self.names: list[str] = []
        outer = self

        class Listener(event.Listener):
            def on_start(self, event: Any) -> None:
                name = str(event.data.get("dispatcher", "")) if isinstance(event.data, dict) else ""
                outer.names.append(name)
                log.warning("a kernel was compiled while running", kernel=name, thread=threading.current_thread().name)

            def on_end(self, event: Any) -> None:
                pass

        self._listener = Listener()
        event.register("numba:compile", self._listener)  # type: ignore[no-untyped-call]

    def stop(self) -> None:
        from numba.core import event

        event.unregister("numba:compile", self._listener)  # type: ignore[no-untyped-call]
