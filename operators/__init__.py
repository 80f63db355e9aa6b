"""What is done to streams."""
