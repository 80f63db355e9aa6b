"""What an operator knows of its input: its channels, its markers, and whether samples are missing."""
