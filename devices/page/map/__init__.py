"""A map of recorded motion in a browser: its server, and the graph in a process of its own that answers queries."""
