"""Commands of mesh steering."""
