"""When a sample was made: a device's time, counter or order mapped onto the session's clock, and what was lost between."""
