"""The process that answers queries: a graph of its own, which reads queries from its standard input, a line each."""

from __future__ import annotations

import json
import signal
import sys
from threading import Thread

from kinegraph.stream.cli.commands import logs
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load_text

GRAPH = """
nodes:
  queries: {use: devices.page.map.queries.PoseQueries}
  near: {use: operators.maps.pose_map.retrieve.Retrieve, from: queries, model: %s}
  answers: {use: devices.page.map.answers.PoseAnswers, from: near}
"""


def listen(session: Session) -> None:
    """Pass on queries until the input ends."""
    for line in sys.stdin:
        try:
            session.tell("queries", line.strip())
        except KinegraphError as error:
            print(error, file=sys.stderr)
    session.stop()


def main(model: str) -> None:
    session = Session(load_text(GRAPH % json.dumps(model), "map"))
    Thread(target=listen, args=(session,), daemon=True).start()
    session.run()


if __name__ == "__main__":
    logs.set_up()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the page, which then closes our standard input
    main(sys.argv[1])
