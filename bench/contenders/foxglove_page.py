"""The Foxglove SDK's WebSocket server: 16 channels at 2000 Hz in 10-sample chunks, a JSON message per sample. Prints its port."""

from __future__ import annotations

import json
import time

import foxglove
import numpy as np

RATE_HZ, CHANNELS, CHUNK = 2000, 16, 10


def main() -> None:
    names = [f"c{k}" for k in range(CHANNELS)]
    properties = {name: {"type": "number"} for name in names}
    schema = json.dumps({"type": "object", "properties": properties}).encode()
    kind = foxglove.Schema(name="board", encoding="jsonschema", data=schema)
    context = foxglove.Context()
    channel = foxglove.Channel("board", schema=kind, message_encoding="json", context=context)
    server = foxglove.start_server(name="board", host="127.0.0.1", port=0, context=context)
    print(server.port, flush=True)
    noise = np.random.default_rng(1).normal(scale=50, size=(RATE_HZ, CHANNELS)).tolist()
    begun, sent = time.time_ns(), 0
    while True:
        last = begun + (sent + CHUNK - 1) * 10**9 // RATE_HZ
        time.sleep(max(0, last - time.time_ns()) / 1e9)
        for number in range(sent, sent + CHUNK):
            stamp = begun + number * 10**9 // RATE_HZ
            message = dict(zip(names, noise[number % RATE_HZ], strict=True))
            channel.log(json.dumps(message).encode(), log_time=stamp)
        sent += CHUNK


if __name__ == "__main__":
    main()
