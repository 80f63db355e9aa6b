"""How a device is reached: how bytes come and go, and the commands that it answers before it measures."""
