"""A ward: all beds of a site on one page, who needs attention first; alarms, graphs that are rolled out, nights."""
