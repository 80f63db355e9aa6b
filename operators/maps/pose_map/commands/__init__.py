"""Commands of the map of poses."""
