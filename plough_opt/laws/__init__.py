"""Resistance laws: the force of the soil on a share, this model's and others'."""
