"""Everything that is wrong with a graph, gathered, so that it is reported in one go."""

from __future__ import annotations

from stream.errors import GraphError
from stream.graph.yaml_lines import Located


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

    def __len__(self) -> int:
        return len(self._found)

    def add(self, text: str, at: Located | None = None, node: str = "", cause: BaseException | None = None) -> None:
        """Something is wrong `at` this place (a line of the file, or a setting of the command line)."""
        origin = at.origin if at else ""
        error = GraphError(
            text, path=origin or self._path, line=None if origin or not at else at.line or None, node=node
        )
        error.__cause__ = cause
        self._found.append(error)

    def keep(self, error: GraphError) -> None:
        self._found.append(error)

    def stop(self) -> None:
        """Raise what was found, if anything."""
        if len(self._found) == 1:
            raise self._found[0]
        if self._found:
            raise GraphErrors(sorted(self._found, key=lambda error: error.line or 0))
