"""`python -m kinegraph` is `kinegraph`."""

from kinegraph.stream.cli.main import main

main()
