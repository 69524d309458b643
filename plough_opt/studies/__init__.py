"""Studies of many designs: fronts, uncertain soil, calibration, sweeps, accuracy, other laws beside."""
