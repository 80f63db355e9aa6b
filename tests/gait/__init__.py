"""EMG, contacts, gait cycles and steps, to whole treadmill sessions."""
