"""Which output feeds which input: `from`, as a graph writes it, resolved to edges; and the order in which samples pass the nodes."""

from __future__ import annotations

import heapq
from collections.abc import Mapping

from kinegraph.stream.errors import nearest
from kinegraph.stream.graph import Edge
from kinegraph.stream.graph.components import Part, kind_of
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.yaml_lines import Located
from kinegraph.stream.operator import ANY, Operator

Wires = dict[str, tuple[Edge, Located]]
"""By input port: what feeds it, and where the graph says so."""


class Wiring:
    """Resolves the edges of one graph; what is wrong goes to `problems`."""

    def __init__(self, outputs: Mapping[str, tuple[str, ...] | None], problems: Problems) -> None:
        """`outputs` holds those of every node of the graph; None stands for what is not known, because the node itself is wrong."""
        self._outputs, self._problems = outputs, problems

    def edge(self, written: Located, node: str = "") -> Edge | None:
        """The output that a text names: "board" for the first output of a node, "board.accel" for another."""
        text = written.value
        if not isinstance(text, str):
            self._problems.add(f"{written.kind} is not the name of a node or of an output", written, node)
            return None
        name = self._node(text)
        dot, output = name != text, text[len(name) + 1 :]
        if name not in self._outputs:
            self._problems.add(f"there is no node {name!r}; {nearest(name, self._outputs)}", written, node)
            return None
        outputs = self._outputs[name]
        if outputs is None:
            return None
        if not outputs:
            self._problems.add(f"{name!r} is an outlet; it has no outputs", written, node)
            return None
        if dot and output not in outputs:
            self._problems.add(f"{name!r} has no output {output!r}; {nearest(output, outputs)}", written, node)
            return None
        return Edge(name, output if dot else outputs[0])

    def _node(self, text: str) -> str:
        """The node in "node.output": its name is the text, or the part before a dot; no node name is a prefix of another."""
        name = text
        while name not in self._outputs and "." in name:
            name = name.rpartition(".")[0]
        if name in self._outputs:
            return name
        is_in_part = any(known.startswith(f"{name}.") for known in self._outputs)
        return text if is_in_part else name

    def wires(self, node: str, part: Part, written: Located | None, entry: Located) -> Wires | None:
        """What feeds each input of `node`, in port order; None if something is wrong with it. `entry` is the whole node."""
        if not issubclass(part, Operator):
            if written is not None:
                self._problems.add(f"{part.__name__} is a source; it takes no 'from'", written, node)
                return None
            return {}
        if written is None or written.value in (None, "", [], {}):
            self._problems.add(
                f"'from' is missing; {part.__name__} is an {kind_of(part)} and needs {_wants(part)}",
                written or entry,
                node,
            )
            return None
        before = len(self._problems)
        ports = self._variadic(node, written) if ANY in part.inputs else self._ports(node, part, written)
        wires = {port: (edge, at) for port, at in ports.items() if (edge := self.edge(at, node))}
        if len(self._problems) > before or len(wires) < len(ports):
            return None
        return self._differing(node, wires)

    def _variadic(self, node: str, written: Located) -> dict[str, Located]:
        """The inputs of an operator that takes any number: named after what they read, or as a mapping names them."""
        if isinstance(written.value, dict):
            return written.value
        items = written.value if isinstance(written.value, list) else [written]
        ports: dict[str, Located] = {}
        for item in items:
            edge = self.edge(item, node)
            if edge and str(edge) in ports:
                self._problems.add(f"{str(edge)!r} is connected twice", item, node)
            elif edge:
                ports[str(edge)] = item
        return ports

    def _ports(self, node: str, part: type[Operator[object]], written: Located) -> dict[str, Located]:
        """The inputs of an operator with named ports."""
        required = [port for port, declared in part.inputs.items() if not declared.optional]
        if isinstance(written.value, list):
            if len(part.inputs) == 1 and len(written.value) == 1:
                return {required[0]: written.value[0]}
            given = f"{len(written.value)} inputs are given in a list" if len(part.inputs) == 1 else "a list is given"
            self._problems.add(f"{given}, but {part.__name__} takes {_wants(part)}", written, node)
            return {}
        if not isinstance(written.value, dict):
            if len(required) > 1:
                self._problems.add(f"one input is given, but {part.__name__} takes {_wants(part)}", written, node)
                return {}
            return {(required or list(part.inputs))[0]: written}
        for port, at in written.value.items():
            if port not in part.inputs:
                self._problems.add(f"{part.__name__} has no input {port!r}; {nearest(port, part.inputs)}", at, node)
        missing = [port for port in required if port not in written.value]
        if missing:
            names = " and ".join(map(repr, missing))
            self._problems.add(f"nothing is connected to {names}; {part.__name__} takes {_wants(part)}", written, node)
        return {port: written.value[port] for port in part.inputs if port in written.value}

    def _differing(self, node: str, wires: Wires) -> Wires | None:
        """Refuse one output on two ports: the node would get every sample twice."""
        seen: dict[Edge, str] = {}
        for port, (edge, at) in wires.items():
            if edge in seen:
                self._problems.add(f"{str(edge)!r} is connected twice: to {seen[edge]!r} and to {port!r}", at, node)
                return None
            seen[edge] = port
        return wires


def _wants(part: type[Operator[object]]) -> str:
    """What an operator's `from` must look like."""
    if ANY in part.inputs:
        return "one or more inputs, as in 'from: [board.accel, board.gyro]'"
    if len(part.inputs) == 1:
        return "one input, as in 'from: node' or 'from: node.output'"
    ports = ", ".join(f"{port}: ..." for port in part.inputs)
    left_out = ", ".join(port for port, declared in part.inputs.items() if declared.optional)
    optional = f" ({left_out} may be left out)" if left_out else ""
    return f"named inputs, as in 'from: {{{ports}}}'{optional}"


def order(inputs: Mapping[str, set[str]]) -> tuple[list[str], list[list[str]]]:
    """Nodes so that each comes after what it reads, as near to the given order as that allows; and the cycles in what is left.

    inputs   per node, the nodes that it reads
    """
    rank = {name: i for i, name in enumerate(inputs)}
    waits = {name: len(sources) for name, sources in inputs.items()}
    readers: dict[str, list[str]] = {name: [] for name in inputs}
    for name, sources in inputs.items():
        for source in sources:
            readers[source].append(name)
    ready = [rank[name] for name, n in waits.items() if n == 0]
    heapq.heapify(ready)
    names, ordered = list(inputs), []
    while ready:
        name = names[heapq.heappop(ready)]
        ordered.append(name)
        for reader in readers[name]:
            waits[reader] -= 1
            if not waits[reader]:
                heapq.heappush(ready, rank[reader])
    left = {name: sources - set(ordered) for name, sources in inputs.items() if waits[name]}
    return ordered, _cycles(left)


def _cycles(left: dict[str, set[str]]) -> list[list[str]]:
    """One cycle for each knot among nodes that all wait for each other, in the direction in which samples would flow."""
    cycles: list[list[str]] = []
    done: set[str] = set()
    for start in left:
        path: list[str] = []
        name = start
        while name not in done and name not in path:
            path.append(name)
            name = min(left[name], key=list(left).index)
        if name in path:
            cycle = path[path.index(name) :][::-1]
            first = min(range(len(cycle)), key=lambda i: list(left).index(cycle[i]))
            cycles.append(cycle[first:] + cycle[:first])
        done.update(path)
    return cycles
