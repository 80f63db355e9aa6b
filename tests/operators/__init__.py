"""Operators for any signal: filters, alignment, gaps, thresholds."""
