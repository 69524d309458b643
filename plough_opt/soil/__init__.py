"""Soil and share: soil properties, share geometry, plastic gas, elastic medium, strength along the path."""
