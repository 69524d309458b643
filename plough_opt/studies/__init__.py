"""Studies of many runs or designs: trade-offs, uncertain soil, calibration, sweeps, accuracy."""
