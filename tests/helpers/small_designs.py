"""Designs with a few variables and no run, whose optima are known by hand."""

import plough_opt as po


def design(**variables):
    """Return a design and the symbols of its variables.

    Args:
        variables: name -> guess, lower bound, upper bound and optionally the unit.
    """
    d = po.Design()
    symbols = [
        d.variable(name, guess=guess, lower=lower, upper=upper, unit="".join(unit))
        for name, (guess, lower, upper, *unit) in variables.items()
    ]
    return d, *symbols
