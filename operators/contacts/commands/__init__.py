"""Commands of the gait laboratory."""
