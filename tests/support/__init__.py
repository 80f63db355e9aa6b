"""What tests of several rooms use: parts of graphs, recordings made up, real brokers and browsers."""

from pathlib import Path

SUPPORT = Path(__file__).resolve().parent
"""Where `parts.X`, `camera_part.Camera` and `graph_parts.X` of a graph's YAML lie."""
