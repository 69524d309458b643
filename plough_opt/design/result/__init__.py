"""Results: optima, their reports, sensitivities and catalogue values."""
