"""A graph as a picture: a tree for the terminal, Mermaid for Markdown, DOT for Graphviz."""

from __future__ import annotations

from rich.text import Text
from rich.tree import Tree

from kinegraph.stream.graph import Edge, Graph, Node


def tree(graph: Graph) -> Tree:
    """Sources at the left, and below each what reads it; a node with several inputs is drawn once and then pointed at."""
    root = Tree(Text(graph.name, "bold"), guide_style="dim")
    drawn: set[str] = set()
    for node in shown(graph):
        if node.is_source:
            _branch(graph, root.add(_label(node)), node, drawn)
    return root


def _branch(graph: Graph, branch: Tree, node: Node, drawn: set[str]) -> None:
    drawn.add(node.name)
    for output, spec in node.specs.items():
        edge = Edge(node.name, output)
        mark = (" ", ("●", "red"), " recorded") if edge in graph.record else ()
        flow = branch.add(Text.assemble((f"{output}: {spec.describe()}", "dim"), *mark))
        for reader, port in graph.readers(edge):
            into = Text(f" (into {port})" if len(reader.inputs) > 1 else "", "dim")
            if reader.name in drawn:
                flow.add(Text.assemble(reader.name, into, (" see above", "dim")))
            else:
                _branch(graph, flow.add(_label(reader) + into), reader, drawn)


def _label(node: Node) -> Text:
    worker = f" worker {node.options.worker}" if node.options.worker else ""
    given = ", ".join(f"{key}={value}" for key, value in node.given.items())
    return Text.assemble((node.name, "bold cyan"), f" {node.use}({given})", (worker, "yellow"))


def mermaid(graph: Graph) -> str:
    """For Markdown pages that show Mermaid."""
    nodes, edges = _numbered(graph)
    lines = ["flowchart LR"]
    for i, node in nodes.items():
        left, right = ("([", "])") if node.is_source else ("[/", "/]") if node.is_outlet else ("[", "]")
        lines.append(f'  {i}{left}"{node.name}<br/>{node.use}"{right}')
    lines += [f'  {a} -- "{text.replace(chr(34), "#quot;")}" --> {b}' for a, b, text in edges]
    return "\n".join(lines) + "\n"


def dot(graph: Graph) -> str:
    """For Graphviz: `kinegraph draw CONFIG --format dot | dot -Tsvg`."""
    nodes, edges = _numbered(graph)
    lines = [f"digraph {_quoted(graph.name)} {{", "  rankdir=LR; node [shape=box, fontname=Helvetica];"]
    for i, node in nodes.items():
        shape = "ellipse" if node.is_source else "parallelogram" if node.is_outlet else "box"
        lines.append(f'  {i} [label="{node.name}\\n{node.use}", shape={shape}];')
    lines += [f"  {a} -> {b} [label={_quoted(text)}];" for a, b, text in edges]
    return "\n".join([*lines, "}"]) + "\n"


def _quoted(text: str) -> str:
    """A text as DOT wants it."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _numbered(graph: Graph) -> tuple[dict[str, Node], list[tuple[str, str, str]]]:
    """Nodes under plain ids, and the edges between them with what flows there."""
    ids = {node.name: f"n{i}" for i, node in enumerate(shown(graph))}
    edges = [
        (ids[edge.node], ids[node.name], f"{edge.output}: {graph.spec(edge).describe()}")
        for node in graph.nodes.values()
        for edge in node.inputs.values()
    ]
    return {ids[name]: graph.nodes[name] for name in ids}, edges


def shown(graph: Graph) -> list[Node]:
    """The nodes that a reader wants to see: all but an implicit source without readers."""
    read = {edge.node for node in graph.nodes.values() for edge in node.inputs.values()}
    return [node for node in graph.nodes.values() if node.line or node.name in read]
