"""Commands of motion graphs."""
