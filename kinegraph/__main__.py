"""`python -m stream` is `kinegraph`."""

from kinegraph.stream.cli.main import main

main()
