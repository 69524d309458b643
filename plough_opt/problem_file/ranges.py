"""Values and ranges of a quantity as a user writes them: "5..45 kPa:9", "5 kPa, 10 kPa"."""

import re
from fractions import Fraction
from typing import Final

from plough_opt.core.errors import InputError, about
from plough_opt.core.units import Display, Unit, display_of
from plough_opt.studies.sweep.points import Axis, Range, axis_of

_RANGE: Final = re.compile(
    r"(?P<lower>.+?)\.\.(?P<upper>[^:]*?)(?::\s*(?P<count>[^:]*?))?(?P<log>\s+log)?\s*",
)
_NUMBER: Final = re.compile(r"\s*[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")


def read_axis(text: str, unit: Unit, *, sampled: bool) -> tuple[Axis, Display]:
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
    symbol, match = f" {unit.symbol}".rstrip(), _RANGE.fullmatch(text)
    how = f'"1..5{symbol}:9" for nine values, "1..5{symbol}:9 log" for equal factors, "1{symbol}, 3{symbol}" for these'
    how = f'write {how}, or "1..5{symbol}" with a number of samples'
    if match is None and not sampled and ".." not in text:
        return _read_list(text, unit, how)
    count = match and match["count"]
    if match is None or sampled != (count is None) or not (sampled or str(count).strip().isdecimal()):
        wanted = "the range of a sample" if sampled else "a range with a number of values"
        raise InputError(f'"{text}" is not {wanted}: {how}')
    log, last = match["log"] is not None, match["upper"].strip()
    (lower, low), (upper, high) = (_split(part, last, unit) for part in (match["lower"], last))
    if low != high:  # the ends have different units, so the steps are even in SI
        lower, upper, low = lower * low, upper * high, 1.0
    with about(f'"{text}":'):
        axis = Range(lower, upper, None if sampled else int(str(count)), log)
    shown = display_of(f"1 {_unit(last)}" if _unit(last) else last, unit)
    if axis.count is None:
        return Range(lower * low, upper * low, None, log), shown
    first, step = Fraction(repr(lower)), (Fraction(repr(upper)) - Fraction(repr(lower))) / (axis.count - 1)
    values = axis.values() if log else [float(first + step * k) for k in range(axis.count)]
    return tuple(value * low for value in values), shown


def _read_list(text: str, unit: Unit, how: str) -> tuple[Axis, Display]:
    """Return the values that a text lists, and the unit in which the last one is written."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) == 2 and re.match(r"[0-9]", text.partition(",")[2]) and _NUMBER.fullmatch(parts[0]):
        point, blank = text.replace(",", "."), ", ".join(parts)
        either = f'write "{point}" with a decimal point, or "{blank}" with a blank'
        raise InputError(f'"{text}" may be one number with a decimal comma, or two: {either}')
    if len(parts) < 2:
        raise InputError(f'"{text}" is one value: fix it with --set, or {how}')
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


def _unit(written: str) -> str:
    """Return the unit of a written quantity."""
    match = _NUMBER.match(written)
    return "" if match is None else written[match.end() :].strip()
