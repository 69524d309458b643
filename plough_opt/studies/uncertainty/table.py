"""Tables of designs for uncertain soil: the soil, the robust design beside the nominal one, the fresh samples."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from plough_opt.core.kept import Origin
from plough_opt.core.quantities import QUANTITIES
from plough_opt.core.tables import Grid
from plough_opt.design import Optimum
from plough_opt.motion.vocabulary import MEASURES
from plough_opt.studies.uncertainty.distribution import SoilDistribution
from plough_opt.studies.uncertainty.variance import SobolIndices
from plough_opt.studies.uncertainty.verification import Check

# Parts of a variance below this are shown as 0.
_NONE: Final = 5e-4


def soil_table(field: SoilDistribution, origin: Origin) -> Grid:
    """Return the uncertain properties of a soil."""
    table = Grid.of(
        f"Uncertain soil: {field.soil.name}", "property", "nominal", "mean", "standard deviation", "correlated with",
        left=("correlated with",),
    )  # fmt: skip
    for name, (mean, spread) in field.moments.items():
        key = f"soil.{name}"
        values = (float(getattr(field.soil, name)), mean, spread)
        display = origin.display(key, QUANTITIES[key].unit, *values)
        pairs = [(pair, value) for pair, value in field.correlation.items() if name in pair]
        others = ", ".join(f"{pair[0] if pair[1] == name else pair[1]} {value:+.2g}" for pair, value in pairs)
        table.row(key, *map(display.text, values), others)
    return table


def design_table(best: Optimum, nominal: Optimum) -> Grid:
    """Return the variables of the robust design beside those of the nominal one."""
    title = f"Design: robust objective {best.objective:.9g} ({best.status})"
    table = Grid.of(title, "variable", "robust", "nominal", "bounds", "", mark="")
    for limit in best.limits:
        if limit.kind == "bound":
            values = (limit.shown.text(one.variables[limit.name], 6) for one in (best, nominal))
            table.row(limit.name, *values, limit.limits, "at its bound" if limit.active else "")
    return table


def limits_table(best: Optimum, requirements: Mapping[str, tuple[str, str]], origin: Origin) -> Grid:
    """Return the requirements of the robust design.

    Args:
        best: the robust design.
        requirements: name -> its limits, and in which soils it meets them.
        origin: with the units.
    """
    title = "Requirements of the robust design"
    table = Grid.of(title, "requirement", "limits", "in", "value", "margin", "", left=("in",), mark="")
    for limit in best.limits:
        if limit.kind == "requirement" and limit.name in requirements:
            limits, how = requirements[limit.name]
            display = origin.display(limit.name, limit.unit, limit.value)
            own = replace(limit, display=display)
            decides = "decides" if limit.active else ""
            table.row(limit.name, limits, how, display.text(limit.value), own.margin_text(), decides)
    return table


def checks_table(checks: Sequence[Check], nominal: Sequence[Check], samples: int, origin: Origin) -> Grid:
    """Return the checks of a design by fresh samples, and of another one if its checks are given."""
    beside = ["nominal design"] if nominal else []
    title = f"What {samples} fresh samples say" + (", of the robust design and of the nominal one" if nominal else "")
    table = Grid.of(
        title, "result", "measure", "the optimiser saw", "fresh samples", "95 % interval", *beside, "",
        left=("measure",), fold=("measure",),
    )  # fmt: skip
    for k, check in enumerate(checks):
        ends = [None if end is None else value_text(origin, check, end) for end in (check.low, check.high)]
        interval = "" if None in ends else f"{ends[0]} to {ends[1]}"
        numbers = [value_text(origin, check, x) for x in (check.seen, check.fresh)]
        other = [value_text(origin, nominal[k], nominal[k].fresh)] if nominal else []
        table.row(check.result, check.text, *numbers, interval, *other, check.verdict)
    return table


def remarks_on(check: Check, origin: Origin) -> list[str]:
    """Return remarks on a measure: the number of worse soils, and the effect of its smoothing."""
    found = [] if check.worse is None else [f"{check.result}, {check.text}: of the fresh samples {check.note}."]
    if check.width:
        width, rounding = value_text(origin, check, check.width, True), value_text(origin, check, check.rounding)
        found.append(f"{check.result}, {check.text}: rounded off over {width}, which changes it by {rounding}.")
    return found


def value_text(origin: Origin, check: Check, value: float, of_result: bool = False) -> str:
    """Return a measure's value, or with ``of_result`` one in the result's own unit, as the question shows it."""
    if check.text.startswith("probability") and not of_result:
        return f"{100.0 * value:.2f} %"
    unit = MEASURES[check.result].unit.symbol if check.result in MEASURES else ""
    return origin.display(check.result, unit, check.seen).text(value)


def indices_table(indices: Mapping[str, SobolIndices]) -> Grid:
    """Return the part of each result's variance that each property explains, alone and with others."""
    names = next(iter(indices.values())).names
    title = "Sobol indices of the robust design: part of each result's variance, alone / with others"
    table = Grid.of(title, "result", *names, fold=names)
    for own in indices.values():
        parts = [f"{_percent(a)} / {_percent(b)}" for a, b in zip(own.first, own.total, strict=True)]
        table.row(own.result, *parts)
    return table


def _percent(part: float) -> str:
    return "0 %" if abs(part) < _NONE else f"{100.0 * part:.1f} %"
