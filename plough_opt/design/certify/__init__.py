"""Certificates of optima: accuracy, active limits, curvature, and the spread within tolerances."""
