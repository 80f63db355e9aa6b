"""kinegraph's engine: what flows, how it flows, when it flows. It knows no device and no operator."""

if __name__ != "kinegraph.stream":
    raise ImportError("the package is kinegraph.stream: write `from kinegraph.stream import ...`")
