"""The bench's scripts run, and measure what they say."""
