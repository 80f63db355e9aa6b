"""kinegraph's engine: what flows, how it flows, when it flows. It knows no device and no operator."""
