"""What the cell does in Maintenance: calibrate, verify, test for hysteresis, be taught with a golden assembly."""
