"""The seven laws on every operator, and the tests of what tests."""
