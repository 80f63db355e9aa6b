"""Every figure of the docs, measured against peers in one run: `make bench`."""
