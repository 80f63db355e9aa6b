"""Everything that is wrong with a graph, gathered, so that it is reported in one go."""

from __future__ import annotations

from kinegraph.stream.errors import GraphError
from kinegraph.stream.graph.reading.yaml_lines import Located


class GraphErrors(GraphError):
    """Several things wrong with one graph, by line; `errors` holds them one by one."""

    def __init__(self, errors: list[GraphError]) -> None:
        self.errors = tuple(errors)
        super().__init__("\n".join(map(str, errors)))
        self.line, self.node, self.text = errors[0].line, errors[0].node, "\n".join(error.text for error in errors)


class Problems:
    """Gathers what is wrong with the graph in one file."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._found: list[GraphError] = []
        self.places: dict[str, Located] = {}
        """Where the nodes of parts stand, by their names in the graph, and where the graph uses the parts."""

    def __len__(self) -> int:
        return len(self._found)

    def add(self, text: str, at: Located | None = None, node: str = "", cause: BaseException | None = None) -> None:
        """Something is wrong `at` this place (a line of the file, or a setting of the command line)."""
        origin, file = (at.origin, at.file) if at else ("", "")
        error = GraphError(
            text + self._other_places(node, file),
            path=origin or file or self._path,
            line=None if origin or not at else at.line or None,
            node=node,
        )
        error.__cause__ = cause
        self._found.append(error)

    def _other_places(self, node: str, file: str) -> str:
        """For a node of a part: where the graph uses the part, and where the part has the node, as far as `file` is another."""
        words = node.split(".")
        names = [name for n in range(len(words), 0, -1) if (name := ".".join(words[:n])) in self.places]
        there = [
            f"{name!r} is in {at.file or self._path}:{at.line}"
            for name in names
            if (at := self.places[name]).file != file and at.line
        ]
        return f" ({', '.join(there)})" if there else ""

    def keep(self, error: GraphError) -> None:
        self._found.append(error)

    def stop(self) -> None:
        """Raise what was found, if anything."""
        if len(self._found) == 1:
            raise self._found[0]
        if self._found:
            raise GraphErrors(sorted(self._found, key=lambda error: error.line or 0))
