"""`python -m stream` is `kinegraph`."""

from stream.cli import main

main()
