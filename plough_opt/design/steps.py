"""How many steps the runs of a design's program take."""

import math
from collections.abc import Sequence

from plough_opt.core.errors import DomainError
from plough_opt.design.verify import TightEvaluation
from plough_opt.motion.effects import MOST_HARMONICS
from plough_opt.motion.plan import steps_for, summed_rate

# By `summed_rate`: a relative error of averages of some 3e-9, and finer steps where the check finds it wanting.
_PHASE_PER_STEP = 1.15
_MOST_STEPS = 50_000
_FEWEST_STEPS = 20
# Of a periodic orbit, whose harmonics fall off exponentially.
_HARMONICS = 12


def steps_at(exact: TightEvaluation, designs: Sequence[Sequence[float]], refinement: float) -> list[int | None]:
    """Return for each run the steps that the fastest of some designs needs, None where its accuracy is not automatic.

    Args:
        exact: the design's expressions.
        designs: variables and parameters of each, in their units.
        refinement: factor on the steps.

    Raises:
        DomainError: a motion too fast to integrate.
    """
    steps: list[int | None] = []
    for k, run in enumerate(exact.runs):
        if run.integration.accuracy.method != "auto":
            steps.append(None)
            continue
        if _holds_orbit(exact, k):
            steps.append(min(math.ceil(_HARMONICS * refinement), MOST_HARMONICS))
            continue
        fastest = 0.0
        for numbers in designs:
            given = exact.parameters(k, numbers)
            rate = summed_rate(dict(zip(run.integration.names, given, strict=False)))
            fastest = max(fastest, rate * float(given[-1]))
        count = math.ceil(refinement * steps_for(fastest, _PHASE_PER_STEP))
        if count > _MOST_STEPS:
            raise DomainError(
                f"between the bounds the share oscillates up to {fastest / (2 * math.pi):.3g} times in a run,"
                f" which would take {count} integration steps: tighten the bounds on stiffness and mass,"
                " shorten the duration, or take the quasi-static scene"
            )
        steps.append(_with_reserve(count))
    return steps


def fewer(exact: TightEvaluation, steps: Sequence[int | None]) -> list[int | None]:
    """Return numbers of steps, or harmonics, with which runs are roughly right."""
    return [
        own if own is None or _holds_orbit(exact, k) else max(_FEWEST_STEPS, 2 * own // 5)
        for k, own in enumerate(steps)
    ]


def _holds_orbit(exact: TightEvaluation, run: int) -> bool:
    return exact.runs[run].integration.structure.orbit == "periodic"


def _with_reserve(steps: int) -> int:
    """Return at least a tenth more, to two binary digits: where an optimiser goes from a start differs little."""
    enough = math.ceil(1.1 * steps)
    unit = 1 << max(0, enough.bit_length() - 3)
    return -(-enough // unit) * unit
