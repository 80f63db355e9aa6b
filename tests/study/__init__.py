"""Many recordings at once, and the Python face: batch, notebooks."""
