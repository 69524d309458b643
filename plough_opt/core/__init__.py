"""Foundations: expressions, quantities and units, domains, errors, files, the compiler."""
