"""Talking to a device: how bytes come and go, and asking for what must be known before it measures."""
