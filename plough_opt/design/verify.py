"""Expressions of a design at numbers, with every run integrated anew and tightly; its domain, and its steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.errors import DomainError, InputError, IntegrationError, PloughError
from plough_opt.core.labels import Call, Limit
from plough_opt.design.declarations import Declarations, Requirement
from plough_opt.design.split import split
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.assembly import assemble
from plough_opt.motion.compiled_steps import compiled_steps
from plough_opt.motion.effects import MOST_HARMONICS
from plough_opt.motion.embedding import with_numbers
from plough_opt.motion.equation import signals
from plough_opt.motion.integrators import Integration, integration
from plough_opt.motion.judgement import refuse_drifting_own, refuse_stiff_orbit
from plough_opt.motion.plan import checked, kink_of, most_steps, phase, steps_for, suited, summed_rate
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.timeline import Timeline

Vector = NDArray[np.float64]

TIGHT = 1e-12
"""Relative error that the re-integration aims at."""


_Tight: TypeAlias = Callable[[Integration, tuple[float, ...], bool], Vector]

# Runs at numbers that an evaluation remembers: those of a design over some hundred samples at a few points, and checks.
_MOST_KEPT: Final = 4096


class TightEvaluation:
    """Expressions of symbols as numeric functions, through runs that are re-integrated tightly.

    Attributes:
        runs: the runs in the expressions.
        limits: the limits of theories that the expressions rest on, with what must stay within them.
    """

    def __init__(
        self,
        expressions: Sequence[ca.MX],
        symbols: Sequence[ca.MX],
        *,
        beside: TightEvaluation | None = None,
    ) -> None:
        """Split expressions around their runs.

        Args:
            expressions: the expressions.
            symbols: that they hold.
            beside: another evaluation, whose runs are not integrated again where this one has the same.
        """
        self._tight: _Tight = lru_cache(maxsize=_MOST_KEPT)(_tight_results) if beside is None else beside._tight
        parts = split(list(expressions), list(symbols))
        self.runs = parts.runs
        self._inputs = [ca.Function("inputs", list(symbols), [run.inputs, run.quantities]) for run in parts.runs]
        limits: dict[Limit, list[ca.MX]] = {}
        # Scenes that are not integrated, and laws, each with what gives its quantities.
        self._scenes: list[tuple[Scene, ca.Function]] = []
        self._calls: list[tuple[Call, ca.Function]] = []
        for meaning, carried in parts.labels:
            quantities = ca.Function("quantities", list(symbols), [ca.densify(ca.vec(carried))])
            if isinstance(meaning, Limit):
                limits.setdefault(meaning, []).append(carried)
            elif isinstance(meaning, Scene):
                self._scenes.append((meaning, quantities))
            elif isinstance(meaning, Call):
                self._calls.append((meaning, quantities))
        self.limits = {limit: ca.vertcat(*limits[limit]) for limit in sorted(limits, key=lambda limit: limit.name)}
        self._algebra = ca.Function("algebra", [*symbols, *parts.results], list(parts.expressions))

    def inputs(self, run: int, numbers: Sequence[float]) -> tuple[Vector, Scene]:
        """Return a run's parameters, the duration last, and its scene at numbers.

        Raises:
            DomainError: the scene lies outside the model's domain.
        """
        parameters, quantities = self.given(run, numbers)
        return parameters, with_numbers(self.runs[run].embedding.template, quantities.tolist())

    def given(self, run: int, numbers: Sequence[float]) -> tuple[Vector, Vector]:
        """Return a run's parameters, the duration last, and its scene's quantities at numbers."""
        parameters, quantities = (result.full().ravel() for result in self._inputs[run](*map(float, numbers)))
        return parameters, quantities

    def quasi_static_scenes(self, numbers: Sequence[float]) -> list[Scene]:
        """Return the scenes at numbers that the expressions hold and that are not integrated.

        Raises:
            DomainError: a scene lies outside the model's domain.
        """
        return [with_numbers(template, quantities(*numbers).nonzeros()) for template, quantities in self._scenes]

    def check_calls(self, numbers: Sequence[float]) -> None:
        """Refuse numbers that lead a law in the expressions beyond its domain.

        Raises:
            DomainError: they do.
        """
        for call, quantities in self._calls:
            call.check(quantities(*numbers).nonzeros())

    def followed(self, run: int, parameters: Vector, scene: Scene) -> Run:
        """Return a run from a start, as it was re-integrated.

        Args:
            run: its number.
            parameters: its parameters, the duration last: see `inputs`.
            scene: its scene.
        """
        own = self.runs[run].integration
        stacked = self._tight(own, tuple(parameters.tolist()), False)
        outputs, observed = own.timeline.outputs + 1, signals(own.structure)
        states, means, variances = np.split(stacked, [-observed.count - observed.squared, -observed.squared])
        states = states.reshape(outputs, -1)
        fractions = own.timeline.output_fractions
        return assemble(scene, float(parameters[-1]), fractions, states, means, variances, Accuracy(error=TIGHT))

    def __call__(self, numbers: Sequence[float]) -> tuple[list[Vector], list[Vector]]:
        """Return the expressions' values, and the same by the method that checks the integration.

        Raises:
            DomainError: a run has no finite result at these numbers, which lie outside the model's domain.
            IntegrationError: the same, within it.
        """
        return self.values(numbers), self.values(numbers, check=True)

    def values(self, numbers: Sequence[float], *, check: bool = False) -> list[Vector]:
        """Return the expressions' values, or the same by the method that checks the integration.

        Raises:
            DomainError: a run has no finite result at these numbers, which lie outside the model's domain.
            IntegrationError: the same, within it.
        """
        results = []
        for k, run in enumerate(self.runs):
            parameters, _ = self.given(k, numbers)
            results.append(self._tight(run.integration, tuple(parameters.tolist()), check))
            if not np.all(np.isfinite(results[-1])):
                _, scene = self.inputs(k, numbers)
                raise IntegrationError(f"the motion of a {scene.describe()} has no finite result")
        return [np.asarray(result) for result in self._algebra.call([*map(ca.DM, numbers), *results])]


def _tight_results(own: Integration, inputs: tuple[float, ...], check: bool) -> Vector:
    """Return a run's stacked results at numbers by a tight adaptive method, or by the one that checks it.

    Args:
        own: how the run was written in the design; only its structure and output times are kept.
        inputs: its parameters, the duration last.
        check: whether the method that checks is asked for.
    """
    p, duration = dict(zip(own.names, inputs[:-1], strict=True)), inputs[-1]
    total = phase(p, duration)
    outputs, kink = own.timeline.outputs, kink_of(p.get("ramp_time", 0.0), duration)
    accuracy = checked(suited(own.structure, total)[0], TIGHT, p, duration)[int(check)]
    timeline = Timeline(outputs, accuracy.steps or most_steps(total), kink, aligned=False)
    # Steps of order 8 in machine code, where there is a compiler, give the same numbers.
    by_code = own.structure.stepped and accuracy.order_8
    code = compiled_steps(own.structure) if by_code else None
    parts: Sequence[Vector] | None = None if code is None else code(timeline, list(inputs))
    if parts is None:
        function = integration(own.structure, accuracy, timeline).function
        parts = [np.asarray(part).T for part in function.call([ca.DM(inputs)])]
    return np.concatenate([part.ravel() for part in parts])


def values_at_guess(
    declared: Declarations, exact: TightEvaluation, implied: Sequence[Requirement], p: Vector
) -> list[Vector]:
    """Return objective and requirements at the guess.

    Args:
        declared: the design.
        exact: gives them at numbers.
        implied: the last of the requirements, which theories bring.
        p: parameters.

    Raises:
        InputError: one has no value there, or a theory has ended.
    """
    guess = np.array([v.guess for v in declared.variables])
    place = declared.describe(guess)
    try:
        found = exact.values([*guess, *p])
    except (PloughError, RuntimeError) as error:
        raise InputError(f"the model cannot be evaluated at the start ({place}): {error}") from error
    for limit, value in zip(implied, found[len(found) - len(implied) :], strict=True):
        if limit.margin(value) < 0.0:
            raise InputError(
                f"at the start ({place}) '{limit.name}' is {float(np.max(value)):.6g}, where the theory ends at"
                f" {limit.high:.6g}: start below, and let the bounds reach below"
            )
    names = ["the objective", *(f"requirement '{r.name}'" for r in declared.requirements)]
    for name, value in zip(names, found, strict=True):
        if not np.all(np.isfinite(value)):
            raise InputError(f"{name} is not a finite number at the start ({place}): start elsewhere")
    return found


def corners(declared: Declarations) -> list[tuple[str, list[float]]]:
    """Return the guess, and the guess with each variable at each of its bounds, with a clause for each."""
    guess = [v.guess for v in declared.variables]
    found = [("at the guess", guess)]
    for k, v in enumerate(declared.variables):
        for side, bound in (("lower", v.lower), ("upper", v.upper)):
            found.append((f"at the {side} bound of '{v.name}'", [*guess[:k], bound, *guess[k + 1 :]]))
    return found


def check_bounds(declared: Declarations, exact: TightEvaluation, p: Vector) -> None:
    """Refuse bounds between which a scene leaves the model's domain.

    Raises:
        DomainError: it does at one of the `corners`.
    """
    for clause, values in corners(declared):
        try:
            numbers = [*values, *p]
            scenes = [exact.inputs(k, numbers)[1] for k in range(len(exact.runs))]
            for scene in (*scenes, *exact.quasi_static_scenes(numbers)):
                scene.check_reaction()
            exact.check_calls(numbers)
            for run, scene in zip(exact.runs, scenes, strict=True):
                own = run.integration
                if own.structure.orbit != "transient" and own.accuracy.method == "auto":
                    refuse_drifting_own(scene)
                    refuse_stiff_orbit(scene)
        except (DomainError, IntegrationError) as error:
            raise DomainError(f"{clause}: {error}") from None


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
            given, _ = exact.given(k, numbers)
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


def rough_steps(exact: TightEvaluation, steps: Sequence[int | None]) -> list[int | None]:
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
