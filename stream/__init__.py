"""kinegraph's engine: what flows, how it flows, when it flows. It knows no device and no operator."""

if __name__ != "kinegraph.stream":
    raise ImportError("import kinegraph.stream: this folder is a part of the package kinegraph")
