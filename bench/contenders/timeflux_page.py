"""timeflux_ui: 16 channels at 2000 Hz to a browser through its UI node, 30 turns of its scheduler a second. Prints its port."""

from __future__ import annotations

import socket
import time
import warnings

import numpy as np
import pandas as pd
from timeflux.core.graph import Graph
from timeflux.core.node import Node
from timeflux.core.scheduler import Scheduler
from timeflux_ui.nodes.ui import UI

RATE_HZ, CHANNELS, TURNS_HZ = 2000, 16, 30

warnings.simplefilter("ignore")


class Board(Node):
    """What has come since the last turn, stamped as it was due."""

    def __init__(self) -> None:
        self._begun, self._sent = time.time_ns(), 0
        self._noise = np.random.default_rng(1).normal(scale=50, size=(RATE_HZ, CHANNELS))

    def update(self) -> None:
        due = (time.time_ns() - self._begun) * RATE_HZ // 10**9
        if due > self._sent:
            numbers = np.arange(self._sent, due)
            index = pd.DatetimeIndex(self._begun + numbers * (10**9 // RATE_HZ))
            columns = [f"c{k}" for k in range(CHANNELS)]
            self.o.data = pd.DataFrame(self._noise[numbers % RATE_HZ], index, columns)
            self._sent = due


def main() -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    nodes = {"board": Board(), "ui": UI(host="127.0.0.1", port=port)}
    edges = [{"source": "board", "target": "ui:board"}]
    path = Graph({"nodes": [{"id": name} for name in nodes], "edges": edges}).traverse()
    print(port, flush=True)
    Scheduler(path, nodes, TURNS_HZ).run()


if __name__ == "__main__":
    main()
