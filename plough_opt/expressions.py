"""Mathematical functions of numbers, arrays and CasADi expressions, for your own effects and objectives."""

from plough_opt.core.expressions import (
    Expression,
    absolute,
    arcsinh,
    arctan,
    arctan2,
    arctanh,
    cos,
    exp,
    log,
    maximum,
    minimum,
    sin,
    sqrt,
    tan,
    where,
)

__all__ = [
    "Expression", "absolute", "arcsinh", "arctan", "arctan2", "arctanh", "cos", "exp", "log", "maximum", "minimum",
    "sin", "sqrt", "tan", "where",
]  # fmt: skip
