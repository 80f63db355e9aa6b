"""How a graph runs: one deterministic thread, supervised sources, workers, the session_log; live and in replay."""
