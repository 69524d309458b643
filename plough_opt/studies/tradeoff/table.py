"""A front as tables: its designs by parts, what a little more costs, what decides where, and what has no result."""

from collections.abc import Sequence

from plough_opt.core.tables import Column, Grid, Page
from plough_opt.motion.vocabulary import called
from plough_opt.studies.tradeoff.front import Front


def front_page(front: Front) -> Page:
    """Return a front as tables and sentences."""
    everywhere = [name for name in front.points[0].active if all(name in point.active for point in front.points)]
    parts: list[Grid | str] = [_table(front, everywhere)]
    for hole in front.holes:
        start, end = (_place(front, place) for place in (hole.start, hole.end))
        doubt = "" if hole.settled else "; the optimiser failed within, so that some may be missing"
        parts.append(f"Hole: no efficient design between {start}, and {end}{doubt}.")
    if front.knee is not None:
        number = front.points.index(front.knee)
        costs = "; ".join(front.in_words(number, of, by).partition(": ")[2] for of, by in _pairs(front))
        parts.append(f"Knee (bold), at {_place(front, front.knee.objectives)}: {costs}.")
    if everywhere:
        parts.append(f"Limits that decide every design: {', '.join(map(called, everywhere))}.")
    parts += [front.search] if front.search else []
    parts += [f"No certified design near {'; '.join(places)}: {reason}." for reason, places in _failures(front).items()]
    gap = max(point.gap for point in front.points)
    residual = max((point.residual for point in front.points if point.confirmed), default=0.0)
    footer = (
        f"{len(front.dominated)} further local optima are dominated, {len(front.needles)} are needles; first-order"
        f" conditions met to {residual:.0e}, re-integrated tightly: gap {gap:.0e}; {front.seconds:.1f} s,"
        f" {front.building:.1f} s of them for building"
    )
    names = ", ".join(called(goal.name) for goal in front.goals)
    return Page(f"Front of {len(front.points)} designs: {names}", tuple(parts), front.notes, footer, front.title)


def _table(front: Front, everywhere: Sequence[str]) -> Grid:
    """Return the table of a front, its knee bold.

    Args:
        front: the front.
        everywhere: limits that decide every design, which no row repeats.
    """
    pairs = _pairs(front)
    what = [f"of {called(front.goals[of].name)} for 1 % {_more(front, by)}" for of, by in pairs]
    heads = ["1 % costs"] if len(pairs) == 1 else [f"cost ({letter})" for letter in "abc"]
    lines = [f"{head}: {text}" for head, text in zip(heads, what, strict=True)]
    limits = list(dict.fromkeys(name for point in front.points for name in point.active if name not in everywhere))
    if limits:
        lines.append("limits: " + ", ".join(f"{k} {called(name)}" for k, name in enumerate(limits, start=1)))
    unconfirmed = not all(point.confirmed for point in front.points)
    branches = any(point.branch for point in front.points)
    axes = [*zip((*front.goals, *front.variables), (*front.objectives.T, *front.designs.T), strict=True)]
    displays = [front.display(axis) for axis, _ in axes]
    # What a surface has is just as wide as 120 characters with headings of one word in a line.
    between = " " if len(pairs) == 1 else "\n"
    headings = [
        *(display.heading(called(axis.name)) for (axis, _), display in zip(axes, displays, strict=True)),
        *(f"{head} [%]" for head in heads),
    ]
    columns = [Column(heading.replace(" ", between), fold=True) for heading in headings]
    columns += [Column("branch", left=True, fold=True)] if branches else []
    columns += [Column("status", left=True, fold=True)] if unconfirmed else []
    columns += [Column("limits", left=True)] if limits else []
    table = Grid(tuple(columns), caption="\n".join(lines))
    for part in front.parts:
        for k in part:
            point = front.points[k]
            values = [display.number(float(own[k])) for (_, own), display in zip(axes, displays, strict=True)]
            values += ["" if (cost := front.cost(k, *pair)) is None else f"{cost:.3g}" for pair in pairs]
            values += [point.branch] if branches else []
            values += ["" if point.confirmed else "unconfirmed"] if unconfirmed else []
            decided = " ".join(str(number) for number, name in enumerate(limits, start=1) if name in point.active)
            values += [decided] if limits else []
            table.row(*values, bold=point is front.knee, end=k == part[-1])
    return table


def _failures(front: Front) -> dict[str, list[str]]:
    """Return why the optimiser failed, in words, and near which places."""
    found: dict[str, list[str]] = {}
    for failure in front.failures:
        # Before the colon is IPOPT's own word.
        reason = failure.reason.partition(": ")[2] or failure.reason
        found.setdefault(reason, []).append(_place(front, failure.objectives))
    return found


def _pairs(front: Front) -> list[tuple[int, int]]:
    """Return pairs of objectives: the one that gives way, and the one that gains."""
    count = len(front.goals)
    return [(of, by) for by in range(count) for of in range(by + 1, count)]


def _more(front: Front, number: int) -> str:
    goal = front.goals[number]
    return f"{'more' if goal.maximise else 'less'} {called(goal.name)}"


def _place(front: Front, values: Sequence[float]) -> str:
    *first, last = front.cells(values)
    return f"{', '.join(first)} and {last}"
