"""The same problems as designs of the package under test. No other module here imports the package."""

import plough_opt as po
from independent.motion import PATHS
from independent.study import judge, judge_shortfall, name_of


def as_design(problem):
    """Return a problem as a `po.Design`, its run, and the measures of its geometry by name."""
    d = po.Design()
    x = dict(problem.fixed)
    for v in problem.variables:
        x[v.name] = d.variable(v.name, guess=v.guess, lower=v.lower, upper=v.upper, log=v.log)
    soil = po.Soil(*problem.soil)
    share = po.Wedge(x["wedge angle"], x["chisel angle"], x["height"])
    cone = share.equivalent_cone()
    mass = x["frame mass"] + (cone.solid_mass(7850.0) if problem.steel else 0.0)
    damping, ramp = (None if isinstance(x[name], float) and x[name] == 0.0 else x[name]
                     for name in ("damping", "ramp time"))  # fmt: skip
    wave = po.StrengthWave(*problem.wave) if problem.wave else None
    effects = po.Effects(strength_wave=wave, damping=damping, tow_ramp=ramp, start=problem.start)
    run = po.simulate(po.Scene(soil, share, x["stiffness"], mass, x["tow speed"], effects), problem.duration)
    geometry = {"loosened radius": po.loosened_radius(cone, soil), "half angle": cone.half_angle}
    d.minimise(sum(weight * getattr(run, name) for name, weight in problem.objective.items()))
    for r in problem.limits:
        expression = geometry.get(r.measure)
        if expression is None:
            expression = getattr(run, r.measure.replace(" ", "_") if r.measure in PATHS else r.measure)
        d.require(name_of(r), expression, **{r.side: r.limit})
    return d, run, geometry


def verdict_on(problem, truth, **how):
    """Return the verdict on the package's answer to a problem, or a text if there is none.

    Args:
        problem: the problem.
        truth: its truth.
        how: options of `po.Design.solve`.
    """
    try:
        best = as_design(problem)[0].solve(**how)
    except po.InfeasibleDesign as error:
        return judge_shortfall(problem, truth, error.conflicts) if "shortfall" in truth else f"refused: {error}"
    except Exception as error:  # reported like a wrong answer
        return f"{type(error).__name__}: {error}"
    if "shortfall" in truth:
        return f"solved, despite a shortfall of {truth['shortfall']:.2g}"
    return judge(problem, truth, best.variables)
