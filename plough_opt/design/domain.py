"""Whether a design's guess has a value, and whether its bounds stay within the model's domain."""

from collections.abc import Sequence

import numpy as np

from plough_opt.core.errors import DomainError, InputError, IntegrationError, PloughError
from plough_opt.design.declarations import Declarations, Requirement
from plough_opt.design.verify import TightEvaluation, Vector
from plough_opt.motion.judgement import refuse_drifting_own, refuse_stiff_orbit


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
