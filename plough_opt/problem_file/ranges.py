"""Ranges and lists of quantities with units, such as "5..45 kPa:9", "10..1000 kN/m:7 log" or "5 kPa, 10 kPa"."""

import re
from fractions import Fraction

from plough_opt.core.errors import InputError
from plough_opt.core.units import Display, Unit, display_of
from plough_opt.studies.sweep.points import Axis, Range, axis_of

_RANGE = re.compile(r"(?P<lower>.+?)\.\.(?P<upper>[^:]*?)(?::(?P<count>[^:]*?))?(?P<log>\s+log)?\s*")
_NUMBER = re.compile(r"\s*[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


def read_axis(text: str, unit: Unit, *, sampled: bool = False) -> tuple[Axis, Display]:
    """Return the values or the range in SI that a text describes, and the unit in which it is written.

    The unit is written once, at the end, or with every number. The steps of a grid are exact in decimal numbers of that
    unit: the values are those that a user would write into a file.

    Args:
        text: ``lower..upper:count`` for a grid or ``lower..upper`` for a sample, either followed by `` log`` for a
            logarithmic scale; or values separated by commas.
        unit: SI unit of the quantity.
        sampled: whether the text must be the range of a sample.

    Raises:
        InputError: the text has none of these forms, a unit is wrong, the ends are not in order, or there are fewer
            than two values.
    """
    match = _RANGE.fullmatch(text)
    if match is None and ".." in text:
        raise InputError(f'"{text}" is not a range: {_how(unit)}')
    if match is None and sampled:
        raise InputError(f'"{text}" is not a range, which a sample needs: {_how(unit)}')
    if match is None:
        return _read_list(text, unit)
    if sampled and match["count"] is not None:
        raise InputError(f'"{text}" has a number of values, which a sample does not use: remove it')
    log = match["log"] is not None
    written = match["upper"].strip()
    (lower, low), (upper, high) = (_split(part, written, unit) for part in (match["lower"], written))
    count = None if match["count"] is None else _count(match["count"].strip(), unit)
    if low != high:  # the ends have different units, so the steps are even in SI
        lower, upper, low = lower * low, upper * high, 1.0
    try:
        found = Range(lower, upper, count, log)
    except InputError as error:
        raise InputError(f'"{text}": {error}') from None
    shown = display_of(f"1 {_unit(written)}".strip() if _unit(written) else written, unit)
    if count is None and not sampled:
        raise InputError(f'"{text}" has no number of values: {_how(unit)}')
    if count is None:
        return Range(lower * low, upper * low, None, log), shown
    values = found.values() if log else _even(lower, upper, found.count or 2)
    return tuple(value * low for value in values), shown


def _read_list(text: str, unit: Unit) -> tuple[Axis, Display]:
    parts = [part.strip() for part in text.split(",")]
    if len(parts) < 2:
        raise InputError(f'"{text}" is one value: fix it with --set, or {_how(unit)}')
    numbers = [_split(part, parts[-1], unit) for part in parts]
    axis = axis_of(text, [number * factor for number, factor in numbers])
    return axis, display_of(parts[-1] if unit.symbol else 1.0, unit)


def _split(part: str, last: str, unit: Unit) -> tuple[float, float]:
    """Return a number and its unit's factor to SI; a number without a unit takes that of the last quantity."""
    part = with_unit(part.strip(), last)
    unit.parse(part)  # raises InputError for a number that is too large
    return unit.split(part)


def with_unit(part: str, last: str) -> str:
    """Return a written quantity; append the unit of the last one if it has none."""
    return f"{part} {_unit(last)}" if _NUMBER.fullmatch(part) and _unit(last) else part


def _even(lower: float, upper: float, count: int) -> list[float]:
    """Return evenly spaced numbers without binary rounding, such as 0.3 (not 0.30000000000000004) after 0.1 and 0.2."""
    first, last = Fraction(repr(lower)), Fraction(repr(upper))
    return [float(first + (last - first) * Fraction(k, count - 1)) for k in range(count)]


def _unit(written: str) -> str:
    """Return the unit of a written quantity."""
    match = _NUMBER.match(written)
    return "" if match is None else written[match.end() :].strip()


def _count(written: str, unit: Unit) -> int:
    try:
        return int(written)
    except ValueError:
        raise InputError(f'":{written}" is not a number of values: {_how(unit)}') from None


def _how(unit: Unit) -> str:
    """Return a clause that explains how ranges are written."""
    symbol = f" {unit.symbol}" if unit.symbol else ""
    return (
        f'write "1..5{symbol}:9" for nine values, "1..5{symbol}:9 log" for equal factors, "1{symbol}, 3{symbol}" for'
        f' these, or "1..5{symbol}" with a number of samples'
    )
