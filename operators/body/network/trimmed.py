"""Removes a network's unread outputs and the layers that only they need; the other outputs keep every bit."""

from __future__ import annotations

from collections.abc import Collection

Shape = tuple[int, ...]


def trimmed(content: bytes, kept: Collection[Shape]) -> bytes:
    """A model of LiteRT's, of which only the outputs of the shapes `kept` are left.

    In BlazePose the mask of the person, which is computed in the network's largest layers, takes almost half of its time. `content` is
    a model that LiteRT has accepted: it is not checked again. Raises ValueError where a shape is not there.
    """
    import flatbuffers
    from ai_edge_litert import schema_py_generated as schema

    model = schema.ModelT.InitFromPackedBuf(content, 0)
    graph = model.subgraphs[0]
    shapes = [tuple(int(size) for size in graph.tensors[output].shape) for output in graph.outputs]
    if missing := set(kept) - set(shapes):
        raise ValueError(f"it has no output of the shape {min(missing)}, but {', '.join(map(str, shapes))}")
    graph.outputs = [output for output, shape in zip(graph.outputs, shapes, strict=True) if shape in kept]
    wanted, needed = {int(output) for output in graph.outputs}, []
    for operator in reversed(graph.operators):  # they stand in the order in which they are computed
        if not wanted.isdisjoint(map(int, operator.outputs)):
            needed.append(operator)
            wanted.update(map(int, operator.inputs))
    graph.operators = needed[::-1]
    model.signatureDefs = []  # they name outputs that may be gone
    builder = flatbuffers.Builder(len(content))
    builder.Finish(model.Pack(builder), b"TFL3")
    return bytes(builder.Output())
