"""Soil and share: properties, geometry, the plastic gas, the elastic medium, strength along the path."""
