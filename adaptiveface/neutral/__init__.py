"""Capture the neutral face (section 3): fuse depth frames, fit the identity, wrap the model onto the scan."""
