"""How a graph runs: one deterministic thread, supervised sources, lanes, the journal; live and in replay."""
