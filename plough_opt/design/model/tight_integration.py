"""A design's expressions at numbers with every run integrated again tightly, its domain, and its integration steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, lru_cache
from typing import Any, Final, TypeAlias

import casadi as ca
import numpy as np

from plough_opt.core.checks import Call, DomainLimit, declared, recorded_limits
from plough_opt.core.errors import DomainError, InputError, IntegrationError, PloughError
from plough_opt.core.expressions import is_quantity, is_symbolic, map_expressions, with_numbers
from plough_opt.design.declarations import Declarations
from plough_opt.design.model.nlp import Split, Vector, has_own_law, is_own, split
from plough_opt.motion.equation import parameters as parameters_of
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.run import Run
from plough_opt.motion.scene import Scene
from plough_opt.motion.solvers.checks import refuse_drifting_own, refuse_stiff_orbit
from plough_opt.motion.solvers.compiled_steps import compiled_steps
from plough_opt.motion.solvers.integrators import Integration, assemble, integration
from plough_opt.motion.solvers.plan import (
    coarser,
    fewest_steps,
    first_setting,
    kinks_of,
    most_steps,
    phase,
    rates,
    rounded_up,
    steps_for,
    suited,
)
from plough_opt.motion.solvers.steps import Timeline

TIGHT = 1e-12
"""Relative error that the tight integration aims at."""


# Name, smallest and largest value, and unit of a limited expression.
_Kept: TypeAlias = tuple[str, float | None, float | None, str]
_Tight: TypeAlias = Callable[[Integration, tuple[float, ...], bool], Vector]

# Most runs whose results an evaluation caches: enough for a design of some hundred soil samples at a few points.
_MOST_CACHED: Final = 4096


class TightEvaluation:
    """Numeric evaluation of expressions whose runs are integrated again tightly.

    Attributes:
        parts: the expressions, split around their runs.
        runs: the runs in the expressions.
    """

    def __init__(
        self, expressions: Sequence[ca.MX], symbols: Sequence[ca.MX], *, shared: TightEvaluation | None = None
    ) -> None:
        """Split expressions around their runs.

        Args:
            expressions: the expressions.
            symbols: the symbols in them.
            shared: another evaluation of the same design, whose cache of runs and limits this one uses, too.
        """
        self._tight: _Tight = lru_cache(maxsize=_MOST_CACHED)(_tight_results) if shared is None else shared._tight
        self._symbols, self._shared = list(symbols), shared
        self.parts = parts = split(list(expressions), list(symbols))
        self.runs = parts.runs
        self._inputs = [ca.Function("inputs", list(symbols), [run.inputs, run.quantities]) for run in parts.runs]
        # Scenes and calls by their templates. Own laws and profiles take no arrays.
        alike: dict[int, tuple[Any, Callable[[Any], object], list[ca.MX]]] = {}
        self._checked_alike = True
        for meaning, carried in (*((run.template, run.quantities) for run in parts.runs), *parts.labels):
            if isinstance(meaning, Scene):
                template, check = meaning, Scene.check_reaction
                self._checked_alike &= not has_own_law(meaning) and meaning.soil.density_profile is None
            elif not meaning.limited:
                template, check = meaning.template, meaning.run
                self._checked_alike &= not is_own(meaning.law)
            else:
                continue
            alike.setdefault(id(meaning), (template, check, []))[2].append(ca.vec(carried))

        def quantities(*columns: ca.MX) -> ca.Function:
            return ca.Function("quantities", list(symbols), [ca.densify(ca.horzcat(*columns))])

        self._alike = [(template, check, quantities(*columns)) for template, check, columns in alike.values()]
        # Scenes without integration, and calls of laws, each with the Function that gives its quantities.
        labels = [(meaning, quantities(ca.vec(carried))) for meaning, carried in parts.labels]
        self._scenes = [(meaning, of) for meaning, of in labels if isinstance(meaning, Scene)]
        self._calls = [(meaning, of) for meaning, of in labels if isinstance(meaning, Call) and not meaning.limited]
        self._algebra = ca.Function("algebra", [*symbols, *parts.results], list(parts.expressions))

    @cached_property
    def _declared(self) -> list[tuple[DomainLimit, Any]]:
        return _declared_limits(self.parts, self._symbols) if self._shared is None else self._shared._declared

    @cached_property
    def limits(self) -> list[tuple[str, ca.MX, float | None, float | None, str]]:
        """Limits of the laws in the expressions, as arguments of a `Requirement`."""
        limits: dict[_Kept, list[ca.MX]] = {}
        for limit, value in self._declared:
            if not value.is_symbolic():
                limits.setdefault((limit.name, *limit.kept, limit.unit), []).append(value)
        return [
            (name, ca.vertcat(*values), low, high, unit)
            for (name, low, high, unit), values in sorted(limits.items(), key=lambda item: item[0][0])
        ]

    @cached_property
    def _bare(self) -> tuple[list[DomainLimit], ca.Function]:
        """Limits on single symbols, which the bounds of variables must keep, and the Function that gives these."""
        bare = [(limit, value) for limit, value in self._declared if value.is_symbolic()]
        column = ca.vertcat(ca.MX(), *(value for _, value in bare))
        return [limit for limit, _ in bare], ca.Function("bare", self._symbols, [column])

    def inputs(self, run: int, numbers: Sequence[float]) -> tuple[Vector, Scene]:
        """Return a run's parameters, with the duration last, and its scene at numbers.

        Raises:
            DomainError: the scene lies outside the model's domain.
        """
        parameters, quantities = self.given(run, numbers)
        return parameters, with_numbers(self.runs[run].template, quantities.tolist())

    def given(self, run: int, numbers: Sequence[float]) -> tuple[Vector, Vector]:
        """Return a run's parameters, with the duration last, and its scene's quantities at numbers."""
        parameters, quantities = self._inputs[run](*map(float, numbers))
        return parameters.full().ravel(), quantities.full().ravel()

    def scenes(self, numbers: Sequence[float]) -> list[Scene]:
        """Return the scenes of all runs, and then the `quasi_static_scenes`.

        Raises:
            DomainError: a scene lies outside the model's domain.
        """
        return [*(self.inputs(k, numbers)[1] for k in range(len(self.runs))), *self.quasi_static_scenes(numbers)]

    def quasi_static_scenes(self, numbers: Sequence[float]) -> list[Scene]:
        """Return the scenes in the expressions, at numbers, that are evaluated without integration.

        Raises:
            DomainError: a scene lies outside the model's domain.
        """
        return [with_numbers(template, quantities(*numbers).nonzeros()) for template, quantities in self._scenes]

    def check_calls(self, numbers: Sequence[float]) -> None:
        """Raise DomainError if these numbers take a law in the expressions, or a symbol in it, out of its domain."""
        for call, quantities in self._calls:
            call.run(with_numbers(call.template, quantities(*numbers).nonzeros()))
        for limit, value in self._bare_values(numbers):
            limit.check(value)

    def _bare_values(self, numbers: Sequence[float]) -> Iterator[tuple[DomainLimit, float]]:
        """Yield the limits on single symbols with the symbols' values."""
        limits, symbols = self._bare
        yield from zip(limits, symbols(*numbers).full().ravel().tolist(), strict=True)

    def surely_inside(self, numbers: Sequence[float]) -> bool:
        """Return whether no scene and no law refuses these numbers, if that can be told from all at once."""
        numbers = [*map(float, numbers)]
        return (
            self._checked_alike
            and all(limit.holds(value) for limit, value in self._bare_values(numbers))
            and all(_keep_limits(template, check, of(*numbers).full()) for template, check, of in self._alike)
        )

    def refusal(self, numbers: Sequence[float]) -> str:
        """Return why a scene or a law refuses these numbers; empty if none does."""
        if self.surely_inside(numbers):
            return ""
        try:
            if refused := _refusal_of(self.scenes(numbers)):
                return refused
            self.check_calls(numbers)
        except PloughError as error:
            return str(error)
        return ""

    def followed(self, run: int, parameters: Vector, scene: Scene) -> Run:
        """Return a tightly integrated run.

        Args:
            run: number of the run.
            parameters: its parameters, with the duration last: see `inputs`.
            scene: its scene.
        """
        own = self.runs[run].integration
        stacked = self._tight(own, tuple(parameters.tolist()), False)
        outputs, equation = own.timeline.outputs + 1, own.equation
        states, means, variances = np.split(stacked, [-equation.averages, -equation.squared])
        states = states.reshape(outputs, -1)
        fractions, duration = own.timeline.output_fractions, float(parameters[-1])
        return assemble(
            scene, parameters_of(scene), duration, fractions, states, means, variances, Accuracy(error=TIGHT)
        )

    def values(self, numbers: Sequence[float], *, check: bool = False) -> list[Vector]:
        """Return the expressions' values.

        Args:
            numbers: values of the symbols.
            check: whether to integrate by the method that checks the integration.

        Raises:
            DomainError: a run has no finite result because these numbers lie outside the model's domain.
            IntegrationError: a run has no finite result although they lie inside it.
        """
        results = []
        for k, run in enumerate(self.runs):
            parameters, _ = self.given(k, numbers)
            if np.all(np.isfinite(parameters)):
                results.append(self._tight(run.integration, tuple(parameters.tolist()), check))
            if len(results) <= k or not np.all(np.isfinite(results[-1])):
                if refusal := self.refusal(numbers):
                    raise DomainError(refusal)
                _, scene = self.inputs(k, numbers)
                raise IntegrationError(f"the motion of a {scene.describe()} has no finite result")
        return [np.asarray(result) for result in self._algebra.call([*map(ca.DM, numbers), *results])]


def _declared_limits(parts: Split, symbols: Sequence[ca.MX]) -> list[tuple[DomainLimit, Any]]:
    """Return the limits that the scenes and the laws in split expressions declare on expressions, each once."""
    holders = [(run.template, run.quantities) for run in parts.runs]
    for meaning, carried in parts.labels:
        arguments = meaning.template[0] if isinstance(meaning, Call) else (meaning,)
        of_scene = arguments and isinstance(arguments[0], Scene)
        if of_scene or meaning.limited:
            holders.append((arguments[0] if of_scene else meaning, ca.vec(carried)))
    # A scene is met for every property of it that a design uses: it is the same if it has equal quantities anywhere.
    place = np.random.default_rng(0).uniform(0.1, 0.9, len(symbols))
    at = ca.Function("carried", list(symbols), [quantities for _, quantities in holders]).call([*place])
    once = {
        (repr(holder), tuple(np.asarray(x).ravel())): (holder, own)
        for (holder, own), x in zip(holders, at, strict=True)
    }
    found: list[tuple[DomainLimit, Any]] = []
    unlimited: set[int] = set()  # templates, which many scenes of a design share
    for holder, quantities in once.values():
        if id(holder) not in unlimited:
            found += (limits := _limits_of(holder, quantities))
            unlimited |= set() if limits else {id(holder)}
    for limit, value in found:
        if not is_symbolic(value):
            limit.check(value)
    return [(limit, value) for limit, value in found if is_symbolic(value)]


def _limits_of(holder: Scene | Call, quantities: ca.MX) -> Sequence[tuple[DomainLimit, Any]]:
    """Return the limits of a scene, or of a call of a law, with expressions in the place of its quantities."""
    # Constants are numbers again.
    values = iter([x if ca.symvar(x) else float(ca.evalf(x)) for x in ca.vertsplit(quantities)])

    def fill(template: Any) -> Any:
        return map_expressions(template, lambda _: next(values), is_quantity)

    if isinstance(holder, Scene):
        scene: Scene = fill(holder)
        return scene.limits()
    with recorded_limits() as record:
        holder.run(fill(holder.template))
    return declared(record)


def _keep_limits(template: Any, check: Callable[[Any], object], quantities: Vector) -> bool:
    """Return whether objects that differ only in numbers keep every limit; all are checked at once, as arrays.

    False also if one of their classes takes no arrays.

    Args:
        template: a scene or arguments of a law, with a placeholder for each quantity.
        check: raises an error if such an object is not valid, and checks domains by `check_domain`.
        quantities: a row for each, with a column for each object.
    """
    values = iter([row if np.ptp(row) else float(row[0]) for row in quantities])
    try:
        with recorded_limits() as limits:
            check(map_expressions(template, lambda _: next(values), is_quantity))
    except Exception:  # a user's own class may raise any error for arrays
        return False
    return all(np.all(limit.holds(value)) for limit, value in limits)


def _tight_results(own: Integration, inputs: tuple[float, ...], check: bool) -> Vector:
    """Return a run's stacked results by a tight method, or by the method that checks it.

    Args:
        own: the run's integration in the design, of which only the structure and the output times are used.
        inputs: the run's parameters, with the duration last.
        check: whether to use the method that checks.
    """
    profile, outputs = own.structure.profile, own.timeline.outputs
    times: tuple[float, ...] = () if profile is None else profile.profile.times
    p, duration = dict(zip(own.names, inputs[:-1], strict=True)) | {"speed_pieces": len(times)}, inputs[-1]
    total = phase(p, duration)
    kinks = kinks_of((p["ramp_time"],) if "ramp_time" in p else times, duration)
    accuracy = first_setting(suited(own.structure, total)[0], TIGHT, rates(p).summed * duration, fewest_steps(p))
    accuracy = coarser(accuracy) if check else accuracy
    timeline = Timeline(outputs, accuracy.steps or most_steps(total), kinks, aligned=False)
    # Compiled steps of order 8 give the same numbers in less time.
    by_code = own.structure.stepped and accuracy.order_8
    code = compiled_steps(own.structure) if by_code else None
    parts: Sequence[Vector] | None = None if code is None else code(timeline, list(inputs))
    if parts is None:
        function = integration(own.structure, accuracy, timeline).function
        parts = [np.asarray(part).T for part in function.call([ca.DM(inputs)])]
    return np.concatenate([part.ravel() for part in parts])


def values_at_guess(declared: Declarations, exact: TightEvaluation, own: int, p: Vector) -> list[Vector]:
    """Return objective and requirements at the guess.

    Args:
        declared: the design.
        exact: its objective and requirements.
        own: number of requirements that the user declared; limits of theories follow.
        p: parameters.

    Raises:
        InputError: one of them cannot be evaluated there, or a theory's limit is exceeded.
    """
    guess = [v.guess for v in declared.variables]
    at = f"at the start ({declared.describe(np.array(guess))})"
    try:
        values = exact.values([*guess, *p])
    except (PloughError, RuntimeError) as error:
        raise InputError(f"the model cannot be evaluated {at}: {error}") from error
    refusal = exact.refusal([*guess, *p])
    for limit, value in zip(declared.requirements[own:], values[1 + own :], strict=True):
        worst = float(value.ravel()[np.argmin(limit.margins(value.ravel()))])
        if limit.margins(np.array(worst)) < 0.0:
            side = f"up to {limit.high:.6g}" if worst > limit.high else f"from {limit.low:.6g}"
            raise InputError(
                f"{at} '{limit.name}' is {worst:.6g}, but the theory holds only {side}: start there, and let the bounds"
                f" reach there ({refusal})"
            )
    if refusal:
        raise InputError(f"the model cannot be evaluated {at}: {refusal}")
    names = ["the objective", *(f"requirement '{r.name}'" for r in declared.requirements)]
    for name, value in zip(names, values, strict=True):
        if not np.all(np.isfinite(value)):
            raise InputError(f"{name} is not a finite number {at}: choose another guess")
    return values


def _refusal_of(scenes: Sequence[Scene]) -> str:
    """Return why the law of one of the scenes refuses it; empty if none does."""
    for scene in scenes:
        try:
            scene.check_reaction()
        except PloughError as error:
            source = scene.law.label
            return str(error) if source in str(error) else f"{source}: {error}"
    return ""


def corners(declared: Declarations) -> list[tuple[str, list[float]]]:
    """Return the guess, and the guess with each variable in turn at each bound, each with a phrase that says where."""
    guess = [v.guess for v in declared.variables]
    found = [("at the guess", guess)]
    for k, v in enumerate(declared.variables):
        for side, bound in (("lower", v.lower), ("upper", v.upper)):
            found.append((f"at the {side} bound of '{v.name}'", [*guess[:k], bound, *guess[k + 1 :]]))
    return found


def check_bounds(declared: Declarations, exact: TightEvaluation, p: Vector) -> None:
    """Raise DomainError if a scene or a law leaves the model's domain at one of the `corners`.

    Limits that the design keeps as requirements do not count, and undefined laws are skipped.
    """
    transient = all(run.integration.structure.orbit == "transient" for run in exact.runs)
    for clause, values in corners(declared):
        try:
            numbers = [*values, *p]
            if transient and exact.surely_inside(numbers):
                continue
            scenes = exact.scenes(numbers)
            for scene in scenes:
                scene.check_bounds()
            exact.check_calls(numbers)
            if _refusal_of(scenes):
                continue
            for run, scene in zip(exact.runs, scenes[: len(exact.runs)], strict=True):
                own = run.integration
                if own.structure.orbit != "transient" and own.accuracy.method == "auto":
                    refuse_drifting_own(scene)
                    refuse_stiff_orbit(scene)
        except (DomainError, IntegrationError) as error:
            raise DomainError(f"{clause}: {error}") from None


class Steps:
    """Bounds of the numbers of integration steps."""

    # With the rate by `Rates.summed` [rad]. It leaves a relative error of about 3e-9 in averages; the check at the
    # optimum demands finer steps if that is not enough.
    phase_per_step: Final = 1.15
    most: Final = 50_000
    fewest_if_rough: Final = 20  # of a run that only has to show the sign of a curvature
    exponent: Final = 0.125  # An error e times too large takes e to this power times as many: the method has order 8.
    most_factor: Final = 3.0  # of one refinement


def steps_at(exact: TightEvaluation, designs: Sequence[Sequence[float]], refinement: float) -> list[int | None]:
    """Return for each run the number of steps that the fastest of several designs needs.

    It is None for a run whose accuracy is not automatic.

    Args:
        exact: the design's expressions.
        designs: variables and parameters of each design, in their units.
        refinement: factor on the number of steps.

    Raises:
        DomainError: a motion is too fast to integrate.
    """
    steps: list[int | None] = []
    for k, run in enumerate(exact.runs):
        if run.integration.accuracy.method != "auto":
            steps.append(None)
            continue
        fastest = 0.0
        for numbers in designs:
            given, _ = exact.given(k, numbers)
            rate = rates(dict(zip(run.integration.names, given, strict=False))).summed
            fastest = max(fastest, rate * float(given[-1]))
        count = math.ceil(refinement * steps_for(fastest, Steps.phase_per_step))
        if count > Steps.most:
            raise DomainError(
                f"between the bounds the share oscillates up to {fastest / (2 * math.pi):.3g} times in a run,"
                f" which would take {count} integration steps: tighten the bounds on stiffness and mass,"
                " shorten the duration, or use the quasi-static scene"
            )
        # A tenth more: starts that differ little thus get equal numbers of steps, and the optimiser the same functions.
        steps.append(rounded_up(math.ceil(1.1 * count)))
    return steps


def rough_steps(steps: Sequence[int | None]) -> list[int | None]:
    """Return the numbers of steps for rough runs: two fifths."""
    return [own and max(Steps.fewest_if_rough, 2 * own // 5) for own in steps]


def steps_factor(excess: float) -> float:
    """Return the factor on the number of steps that reduces an error by the factor ``excess``, with a margin."""
    return min(Steps.most_factor, 1.1 * excess**Steps.exponent) if excess < math.inf else Steps.most_factor
