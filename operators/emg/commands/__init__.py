"""Before a session: electrodes are checked, and amplitudes are related to a calibration, by commands on recordings."""
