"""Searches for the basins of a design and the optima in them."""
