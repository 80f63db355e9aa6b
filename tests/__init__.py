"""The tests, in rooms by subject; what stands here are commands (`python -m tests.NAME`) that make or check something."""
