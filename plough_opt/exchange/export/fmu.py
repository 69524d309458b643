"""Export of a scene as an FMU for model exchange, FMI 3.0: C source, description and binary."""

import hashlib
import io
import math
import platform
import re
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, Literal
from xml.etree import ElementTree

import casadi as ca
import numpy as np

from plough_opt.core.checks import check_choice, check_single
from plough_opt.core.compiler import NOT_FOUND, code_of, compile_library, find_compiler
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import as_number, is_casadi, map_expressions, template_of
from plough_opt.core.files import check_file, text_of, write_file
from plough_opt.core.quantities import BESIDE, EVERY
from plough_opt.core.units import registry
from plough_opt.exchange.building import NamedScene
from plough_opt.motion.driven import DrivenShare
from plough_opt.motion.equation import Structure, parameters
from plough_opt.motion.scene import Scene
from plough_opt.soil.geometry import Wedge

KINDS: Final = {
    "states": ("output", "continuous", "calculated", "NX"),
    "rates": ("local", "continuous", "calculated", ""),
    "outputs": ("output", "continuous", "calculated", "NY"),
    "indicators": ("local", "continuous", "calculated", "NZ"),
    "calculated": ("calculatedParameter", "tunable", "calculated", "NC"),
    "inputs": ("input", "continuous", "exact", "NU"),
    "parameters": ("parameter", "tunable", "exact", "NP"),
    "discrete": ("output", "discrete", "calculated", "ND"),
}
"""Kind of variables -> causality, variability and initial, as FMI defines them, and the macro in the C runtime that
counts them, "" for none; in the order of the C source."""


_CATEGORIES: Final = {"logStatusWarning": "warnings about a run", "logStatusError": "why a call was refused"}
# Relative tolerance proposed for integration: the default error of forces.
_TOLERANCE: Final = 1e-8
# Base units: FMI's symbol -> pint's name.
_BASE_UNITS: Final = {"kg": "kilogram", "m": "meter", "s": "second", "rad": "radian"}
_NAME: Final = re.compile(r"[A-Za-z_]\w{0,62}", re.ASCII)
_SUFFIXES: Final = {"linux": ".so", "darwin": ".dylib", "windows": ".dll"}
_PROCESSORS: Final = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
# A longer source (in characters) is compiled without optimisation, which would take minutes. Only a density profile
# makes one so long, and it is evaluated once in a run.
_MOST_OPTIMISED: Final = 500_000
# Every entry of the archive has the earliest date that zip files allow, so that the same scene gives the same file.
_DATE: Final = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class FmuVariable:
    """A variable of an exported share.

    Attributes:
        name: its name, as in a problem file.
        unit: SI unit, "1" for a pure number, or "" if it is unknown.
        description: its meaning.
        start: value of a parameter or input.
        low: least value.
        high: largest value.
        above: whether the least value itself is excluded.
        below: whether the largest value itself is excluded.
        nominal: order of magnitude; 0: that of the start value.
        shown: unit in which a tool should show it, or "".
        derivative: name of the state whose rate it is, or "".
    """

    name: str
    unit: str
    description: str
    start: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    below: bool = False
    nominal: float = 0.0
    shown: str = ""
    derivative: str = ""

    @property
    def magnitude(self) -> float:
        """Order of magnitude, above 0."""
        return self.nominal or abs(self.start) or 1.0


@dataclass(frozen=True)
class FmuModel:
    """An exported share.

    Attributes:
        of_kind: variables by kind. "parameters" holds those that an equation depends on, "calculated" what depends on
            the parameters alone, "discrete" what changes only at events.
        functions: Functions by name; arguments and results are columns: states x, inputs u, discrete variables d,
            parameters p, and the numbers q in the equation of motion. ``derive`` (p) -> (q, calculated);
            ``begin`` (u, q) -> (x, d); ``evaluate`` (t, x, u, d, q) -> (rates, outputs, indicators); ``happen``
            (t, x, u, d, q) -> (x, d) after all events up to now. The first three have directional derivatives.
            ``forward_...`` takes the same arguments and a seed for each of x, u, p and q among them, and returns the
            change of all continuous results in one column; ``reverse_...`` takes the same arguments and a seed for
            that column, and returns the sensitivities to each. A soil with a density profile has neither.
    """

    of_kind: Mapping[str, tuple[FmuVariable, ...]]
    functions: Mapping[str, ca.Function]

    @property
    def visible(self) -> tuple[FmuVariable, ...]:
        """Variables whose causality is "output": states, forces and discrete variables."""
        return tuple(one for kind, (causality, *_) in KINDS.items() if causality == "output"
                     for one in self.of_kind[kind])  # fmt: skip

    @cached_property
    def references(self) -> dict[str, str]:
        """Name -> value reference of each variable, in the order of the C source; time is number 0."""
        variables = chain.from_iterable(self.of_kind[kind] for kind in KINDS)
        return {name: str(k) for k, name in enumerate(["time", *(variable.name for variable in variables)])}


def model_of(named: NamedScene, *, by_speed: bool) -> FmuModel:
    """Return the model of a numeric scene with motion from a start.

    Args:
        named: the scene.
        by_speed: whether the input is the strut's speed; otherwise it is the strut's position, which must suffice.
    """
    scene, structure = named.scene, Structure.of(named.scene)
    symbols, symbolic = _with_parameters(named)
    from_scene = parameters(symbolic)
    numbers, given = {name: ca.SX.sym(name) for name in from_scene}, ca.SX.sym("input")
    if by_speed:
        share = DrivenShare(scene, structure, numbers | {"tow_speed": given})
    else:
        share = DrivenShare(scene, structure, numbers, given)
    expressions = _varying(share, scene, given) | {"calculated": _calculated(scene, symbolic)}
    x, u, d, *now, calculated = (
        _column(expressions[kind].values())
        for kind in ("states", "inputs", "discrete", "rates", "outputs", "indicators", "calculated")
    )
    moment, first, after = [share.time, x, u, d], [*map(_column, share.start())], [*map(_column, share.after_events())]
    # Keep only the numbers that occur in the equations, and only the parameters that these numbers depend on.
    in_equations = _symbols_in(*first, *now, *after)
    used = [name for name, symbol in numbers.items() if hash(symbol) in in_equations]
    q, from_p = (_column(source[name] for name in used) for source in (numbers, from_scene))
    needed = _symbols_in(from_p, calculated)
    used_parameters = {variable: symbol for variable, symbol in symbols.items() if hash(symbol) in needed}
    p = _column(used_parameters.values())
    graphs = {
        "derive": ([p], [from_p, calculated]),
        "begin": ([u, q], first),
        "evaluate": ([*moment, q], now),
        "happen": ([*moment, q], after),
    }
    # The quadratures of a density profile take hundreds of thousands of operations, their derivatives many more.
    if scene.soil.density_profile is None:
        graphs |= _derivatives("derive", *graphs["derive"], [p])
        graphs |= _derivatives("begin", [u, q], first[:1], [u, q])
        graphs |= _derivatives("evaluate", *graphs["evaluate"], [x, u, q])
    functions = {
        name: ca.Function(name, arguments, [*map(ca.densify, found)], {"cse": True})
        for name, (arguments, found) in graphs.items()
    }
    of_kind = {kind: tuple(found) for kind, found in expressions.items()} | {"parameters": tuple(used_parameters)}
    return FmuModel(of_kind, functions)


def _column(values: Any) -> ca.SX:
    """Return expressions as one column, which may be empty."""
    return ca.vertcat(ca.SX(0, 1), *values)


def _symbols_in(*expressions: ca.SX) -> set[int]:
    """Return the hashes of all symbols in some columns."""
    return {hash(symbol) for symbol in ca.symvar(ca.vertcat(*expressions))}


def _derivatives(
    name: str, arguments: list[ca.SX], results: list[ca.SX], by: list[ca.SX]
) -> dict[str, tuple[list[ca.SX], list[ca.SX]]]:
    """Return arguments and results of the products of a Jacobian with seeds, forward and reverse.

    Args:
        name: name of the differentiated Function.
        arguments: its arguments.
        results: those of its results that are differentiated.
        by: those of its arguments by which they are differentiated.
    """
    unknown, known = _column(results), _column(by)
    seeds, seed = [ca.SX.sym("seed", part.numel()) for part in by], ca.SX.sym("seed", unknown.numel())
    ends = np.cumsum([0, *(part.numel() for part in by)]).tolist()
    reverse = ca.vertsplit(ca.jtimes(unknown, known, seed, True), ends)
    return {
        f"forward_{name}": ([*arguments, *seeds], [ca.jtimes(unknown, known, _column(seeds))]),
        f"reverse_{name}": ([*arguments, seed], reverse),
    }


def _quantities(named: NamedScene) -> Iterator[FmuVariable]:
    """Yield the named quantities of a scene as parameters."""
    for name, value in named.values.items():
        one, is_ramp = EVERY[name], name == "effects.tow_ramp"
        # A model has the equations of a ramp or not: without them its duration stays 0, with them it is above 0.
        if not is_ramp or named.scene.effects.ramps:
            yield FmuVariable(name, one.unit or "1", one.meaning, float(value), one.low, one.high, one.above or is_ramp,
                           one.below, shown=one.shown)  # fmt: skip


def _with_parameters(named: NamedScene) -> tuple[dict[FmuVariable, ca.SX], Scene]:
    """Return a symbol for each parameter of a scene, and the scene with these symbols.

    Beside the named quantities, the numbers of a density profile and of a user's own effects are parameters.
    """
    symbols = {variable: ca.SX.sym(variable.name) for variable in _quantities(named)}
    scene, _ = named.replaced({variable.name: symbol for variable, symbol in symbols.items()})

    def numbered(part: Any, path: str) -> Any:
        symbolic, values = template_of(part)
        for k, (value, symbol) in enumerate(zip(values, template_of(symbolic)[1], strict=True), start=1):
            name = f"{path}.parameters[{k}]"
            symbols[FmuVariable(name, "", f"number {k} of {type(part).__name__}", float(value))] = symbol
        return symbolic

    if (profile := scene.soil.density_profile) is not None:
        profile = replace(profile, parameters=numbered(profile.parameters, "soil.density_profile"))
        scene = replace(scene, soil=replace(scene.soil, density_profile=profile))
    own = tuple(numbered(effect, f"effects.own[{k}]") for k, effect in enumerate(scene.effects.own, start=1))
    return symbols, replace(scene, effects=replace(scene.effects, own=own))


def _varying(share: DrivenShare, scene: Scene, given: ca.SX) -> dict[str, Mapping[FmuVariable, Any]]:
    """Return, by kind, the variables that change during a run with their expressions.

    Args:
        share: the share at one moment.
        scene: the numeric scene, which gives the orders of magnitude.
        given: the input.
    """
    nominal, by_speed, events = _magnitudes(scene), share.by_speed, share.structure.events

    def variable(name: str, unit: str, description: str, shown: str = "", **more: Any) -> FmuVariable:
        return FmuVariable(name, unit, description, nominal=nominal.get(unit, 0.0), shown=shown, **more)

    travel = variable("travel", "m", "travel L of the share")
    speed = variable("speed", "m/s", "speed L' of the share", "km/h")
    deflection = variable("deflection", "m", "deflection z of the mount's spring, compression positive", "mm")
    place = variable("strut_position", "m", "path s of the strut")
    ramp = ", to which it rises in the time effects.tow_ramp" if share.structure.ramp else ""
    driven = variable("strut_speed", "m/s", f"speed s' of the strut{ramp}", "km/h", start=float(scene.tow_speed))
    travel_rate = variable("der(travel)", "m/s", "rate of the travel", derivative="travel")
    acceleration = variable("der(speed)", "m/s^2", "acceleration L'' of the share", derivative="speed")
    swing = variable("der(deflection)", "m/s", "rate z' of the deflection", derivative="deflection")
    pull = variable("mount_force", "N", "mount force P of spring and damper on the share", "kN")
    resistance = variable("soil_resistance", "N", "resistance F of the soil with its added mass", "kN")
    opening = variable("opening", "m", "how far the share is behind its furthest travel")
    mode = variable("mode", "1", "0: the share slips, 1: it sticks, 2: it is behind its furthest travel")
    furthest = variable("furthest_travel", "m", "furthest travel when the share last turned back")
    buried = variable("buried", "1", "1 once the whole share was in the soil, before that 0")
    event = "negative once an event has happened"
    indicators = {variable(f"event_indicator[{k}]", "", event): one for k, one in enumerate(share.indicators, start=1)}
    return {
        "states": {travel: share.travel, speed: share.speed} | ({deflection: share.deflection} if by_speed else {}),
        "rates": {travel_rate: share.speed, acceleration: share.acceleration}
        | ({swing: share.strut_speed - share.speed} if by_speed else {}),
        "outputs": {pull: share.pull, resistance: share.resistance}
        | ({place: share.travel + share.deflection} if by_speed else {deflection: share.deflection})
        | ({opening: share.opening} if events else {}),
        "indicators": indicators,
        "inputs": {driven if by_speed else place: given},
        "discrete": ({mode: share.mode, furthest: share.furthest} if events else {})
        | ({buried: share.entered} if share.structure.entry else {}),
    }


def _magnitudes(scene: Scene) -> dict[str, float]:
    """Return unit -> order of magnitude, above 0, of variables with this unit."""
    speed, frequency = float(scene.tow_speed), float(scene.natural_frequency)
    force = abs(float(scene.steady_resistance)) or speed * math.sqrt(scene.stiffness * scene.inertia) or 1.0
    length = force / float(scene.stiffness)
    return {"N": force, "m": length, "m/s": speed or length * frequency, "m/s^2": force / float(scene.inertia)}


def _calculated(scene: Scene, symbolic: Scene) -> dict[FmuVariable, ca.SX]:
    """Return the variables that depend on the parameters alone, with their expressions from the symbolic scene."""
    found = {}

    def add(path: str, name: str, unit: str, description: str, shown: str = "") -> None:
        value = attrgetter(path)
        found[FmuVariable(name, unit, description, nominal=abs(float(value(scene))), shown=shown)] = value(symbolic)

    if isinstance(scene.share, Wedge):
        add("cone.half_angle", "share.half_angle", "rad", "half angle beta of the equivalent cone", shown="deg")
    if not scene.law.lacks("loosened_radius"):
        add("loosened_radius", "share.loosened_radius", "m", "radius r* of the compaction front at the share's base")
    add("reaction.static", "share.static_resistance", "N", "static resistance F0", shown="kN")
    if scene.effects.inertial_drag:
        add("reaction.drag", "share.drag_coefficient", "N*s^2/m^2", "resistance Fd per squared speed")
    if scene.effects.added_mass and not scene.law.lacks("added_mass"):
        add("reaction.added_mass", "share.added_mass", "kg", "mass m_a of soil that the share carries along")
    return found


def model_description(model: FmuModel, name: str, token: str, description: str, duration: float | None) -> bytes:
    """Return modelDescription.xml.

    Args:
        model: the exported share.
        name: name of model and binary.
        token: instantiation token in the C source.
        description: what the FMU is, in a sentence.
        duration: proposed duration of a simulation [s], or None.
    """
    has_derivatives = str("forward_derive" in model.functions).lower()
    abilities = dict.fromkeys(("canGetAndSetFMUState", "canSerializeFMUState", "needsCompletedIntegratorStep"), "true")
    abilities |= dict.fromkeys(("providesDirectionalDerivatives", "providesAdjointDerivatives"), has_derivatives)
    end = {} if duration is None else {"stopTime": repr(float(duration))}
    content = [
        _tag("ModelExchange", modelIdentifier=name, **abilities),
        _tag("UnitDefinitions", *_units(model)),
        _tag("LogCategories", *(_tag("Category", name=one, description=text) for one, text in _CATEGORIES.items())),
        _tag("DefaultExperiment", startTime="0.0", tolerance=repr(_TOLERANCE), **end),
        _tag("ModelVariables", *_variables(model)),
        _tag("ModelStructure", *_structure(model)),
    ]
    about = {"fmiVersion": "3.0", "modelName": name, "instantiationToken": token, "description": description}
    about |= {"generationTool": f"plough_opt {version('plough_opt')}", "variableNamingConvention": "structured"}
    root = _tag("fmiModelDescription", *content, **about)
    return _xml(root)


def _tag(name: str, /, *content: ElementTree.Element, **attributes: str) -> ElementTree.Element:
    """Return an element with its attributes and its children, both in the given order."""
    element = ElementTree.Element(name, attributes)
    element.extend(content)
    return element


def _xml(root: ElementTree.Element) -> bytes:
    """Return an element as an indented XML document."""
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"


def _spelled(unit: str) -> str:
    """Return a unit in FMI's spelling, such as N.s/m or m/s2."""
    return unit.replace("^", "").replace("*", ".")


def _units(model: FmuModel) -> Iterator[ElementTree.Element]:
    """Yield the variables' units in SI base units, each with the display units that its variables propose."""
    shown: dict[str, set[str]] = {"s": set()}
    for kind in KINDS:
        for variable in model.of_kind[kind]:
            shown.setdefault(variable.unit, set()).add(variable.shown)
    for unit in filter(None, shown):
        one = registry().Quantity(1.0, unit)
        powers = dict(one.to_base_units().unit_items())
        base = {symbol: f"{powers[name]:g}" for symbol, name in _BASE_UNITS.items() if name in powers}
        displays = (
            _tag("DisplayUnit", name=other, factor=repr(one.to(other).magnitude))
            for other in sorted(shown[unit] - {""})
        )
        yield _tag("Unit", _tag("BaseUnit", **base), *displays, name=_spelled(unit))


def _variables(model: FmuModel) -> Iterator[ElementTree.Element]:
    """Yield time and every variable."""
    time = {"name": "time", "valueReference": "0", "causality": "independent", "variability": "continuous"}
    yield _tag("Float64", **time, unit="s", description="time")
    for kind, (causality, variability, initial, _) in KINDS.items():
        for variable in model.of_kind[kind]:
            attributes = {
                "name": variable.name,
                "valueReference": model.references[variable.name],
                "causality": causality,
                "variability": variability,
                "initial": initial,
                "description": variable.description,
                "nominal": repr(variable.magnitude),
                "unit": _spelled(variable.unit),
                "displayUnit": variable.shown,
                "min": repr(variable.low) if math.isfinite(variable.low) else "",
                "max": repr(variable.high) if math.isfinite(variable.high) else "",
                "start": repr(variable.start) if initial == "exact" else "",
                "derivative": model.references.get(variable.derivative, ""),
                "reinit": "true" if variable.name == "speed" and model.of_kind["discrete"] else "",
            }
            yield _tag("Float64", **{name: text for name, text in attributes.items() if text})


def _structure(model: FmuModel) -> Iterator[ElementTree.Element]:
    """Yield outputs, rates, initial unknowns and event indicators."""
    of_kind, reference = model.of_kind, model.references
    unknown = (*model.visible, *of_kind["rates"], *of_kind["calculated"])
    for name, variables in (
        ("Output", model.visible),
        ("ContinuousStateDerivative", of_kind["rates"]),
        ("InitialUnknown", sorted(unknown, key=lambda variable: int(reference[variable.name]))),
        ("EventIndicator", of_kind["indicators"]),
    ):
        for variable in variables:
            yield _tag(name, valueReference=reference[variable.name])


def c_source(model: FmuModel, *, pushes: bool, by_speed: bool) -> tuple[str, str]:
    """Return the C source of an FMU, and its instantiation token.

    Args:
        model: the exported share.
        pushes: whether the contact law lets soil push a retreating share; the FMU then logs a warning if it retreats.
        by_speed: whether the strut's speed is the input.
    """
    # CasADi's functions are static: only the runtime in the same source calls them.
    code = code_of("share", model.functions.values(), casadi_int="long long")
    equations = f"#define CASADI_SYMBOL_EXPORT static\n{code}"
    parts = (_constants(model, pushes, by_speed), equations, text_of(__package__, "fmu_runtime.c"))
    # The token covers what is computed; names and units are in the description only.
    token = hashlib.sha256("".join(parts).encode()).hexdigest()[:32]
    return "\n".join((f'#define TOKEN "{token}"', *parts)), token


def _constants(model: FmuModel, pushes: bool, by_speed: bool) -> str:
    """Return the C of sizes and options, and of the variables' domains, start values and orders of magnitude."""
    of_kind, functions = model.of_kind, model.functions
    counts = {macro: len(of_kind[kind]) for kind, (*_, macro) in KINDS.items() if macro} | {
        "NQ": functions["derive"].numel_out(0),
        "NW": max(function.sz_w() for function in functions.values()),
        "PUSHES": int(pushes),
        "NEEDS_SPEED": int(by_speed),
        "HAS_DERIVATIVES": int("forward_derive" in functions),
    }
    limits = ",\n".join(
        f'  {{"{one.name}", {_row((one.low, one.high))}, {int(one.above)}, {int(one.below)}}}'
        for one in of_kind["parameters"]
    )
    starts = _row(variable.start for kind in ("inputs", "parameters") for variable in of_kind[kind])
    lines = [
        *(f"#define {name} {count}" for name, count in counts.items()),
        "#include <math.h>",
        "typedef struct { const char *name; double low, high; int above, below; } Limits;",
        f"static const Limits limits[] = {{\n{limits}}};",
        f"static const double starts[] = {{{starts}}};",
        f"static const double nominals[] = {{{_row(variable.magnitude for variable in of_kind['states'])}}};",
    ]
    return "\n".join(lines)


def _row(values: Iterable[float]) -> str:
    """Return numbers as elements of a C initialiser."""
    infinite = {math.inf: "INFINITY", -math.inf: "-INFINITY"}
    return ", ".join(infinite.get(value, repr(float(value))) for value in values)


def write_fmu(
    scene: Scene,
    path: str | Path,
    *,
    strut: Literal["speed", "position"] = "speed",
    steel_density: float | None = None,
    duration: float | None = None,
    name: str = "plough_share",
    binary: bool = True,
) -> Path:
    """Write the moving share of a scene as an FMU, FMI 3.0 for model exchange.

    The input is the strut's speed or position. The outputs are travel, speed, deflection, mount force and soil
    resistance. Every number of soil, share, mount and effects is a parameter, which may change at events ("tunable");
    see docs/howto/fmu.md. The importing tool integrates the FMU; event indicators mark stick, slip and entry. The FMU
    computes its start from the parameters and from the input at that time.

    Args:
        scene: a numeric scene with motion from a start. Its tow speed is the input's default.
        path: path of the FMU, ending in .fmu; an existing file is replaced, and nothing is written if anything fails.
        strut: which motion of the strut is the input, ``"speed"`` [m/s] or ``"position"`` [m].
        steel_density: density of the share's material [kg/m^3]. The share's own mass is then a part of the scene's and
            follows the parameters of its shape. None: the whole mass is one parameter.
        duration: proposed duration of a simulation [s].
        name: name of the model, a C identifier.
        binary: whether to compile for this machine; otherwise the FMU contains C source only, which a tool may compile.

    Returns:
        The path.

    Raises:
        DomainError: a duration or density outside its domain.
        InputError: a scene that is not an initial value problem, or that holds symbols or arrays; the strut's position
            as input where its speed is needed; a name that is not a C identifier; a missing compiler; or a path that
            cannot be written.

    Example:
        >>> import tempfile
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = po.export.write_fmu(scene, f"{folder}/share.fmu", binary=False)
        >>> path.name
        'share.fmu'
    """
    target, scene, by_speed = check_file(path, "FMU", ".fmu"), _numeric(scene), strut == "speed"
    _check(scene, strut, duration, name)
    model = model_of(NamedScene(scene, steel_density=steel_density), by_speed=by_speed)
    source, token = c_source(model, pushes=scene.effects.contact == "resisting", by_speed=by_speed)
    description = f"{scene.describe()}; the strut's {strut} is the input"
    files = _tag("SourceFileSet", _tag("SourceFile", name=f"{name}.c"), language="C11")
    built = _tag("BuildConfiguration", files, modelIdentifier=name)  # how a tool compiles it for its platform
    content = {
        "modelDescription.xml": model_description(model, name, token, description, duration),
        "sources/buildDescription.xml": _xml(_tag("fmiBuildDescription", built, fmiVersion="3.0")),
        f"sources/{name}.c": source.encode(),
    }
    if binary:
        folder, suffix = _platform()
        content[f"binaries/{folder}/{name}{suffix}"] = _compiled(source)
    return write_file(target, "FMU", _archive(content))


def _check(scene: Scene, strut: str, duration: float | None, name: str) -> None:
    """Raise InputError or DomainError if a scene or an option cannot be exported."""
    check_choice("strut", strut, ("speed", "position"), ", the FMU's input")
    if not _NAME.fullmatch(name):
        raise InputError(f"name = {name!r} must be a C identifier: letters, digits and _, at most 63, no digit first")
    if not scene.effects.motion:
        raise InputError("a scene without motion has nothing to integrate: an FMU needs effects with motion = True")
    if scene.effects.tow_profile is not None:
        raise InputError("the input of an FMU is the strut's motion: leave tow_profile out")
    if scene.effects.orbit != "transient":
        raise InputError("a periodic orbit has no start to integrate from: use effects with orbit = 'transient'")
    structure, by_place = Structure.of(scene), strut == "position"
    if by_place and structure.damper:
        raise InputError("a damper in the mount needs the strut's speed: use strut = 'speed', or leave damping out")
    if by_place and structure.ramp:
        raise InputError("tow_ramp prescribes the strut's motion too: use strut = 'speed', or leave tow_ramp out")
    if duration is not None:
        BESIDE["scene.duration"].check(duration)
    scene.check_reaction()


def _numeric(scene: Scene) -> Scene:
    """Return the scene with every number as a float; raise InputError if it holds symbols or arrays."""
    check_single("an FMU", scene)
    plain: Scene = map_expressions(scene, lambda value: float(as_number(value)), is_casadi)
    return plain


def _platform() -> tuple[str, str]:
    """Return folder and suffix of binaries for this machine, as FMI 3.0 names them."""
    system, processor = platform.system().lower(), platform.machine().lower()
    if system not in _SUFFIXES or processor not in _PROCESSORS:
        raise InputError(f"FMI 3.0 does not define binaries for {system} on {processor}: use binary=False (--sources)")
    return f"{_PROCESSORS[processor]}-{system}", _SUFFIXES[system]


def _compiled(source: str) -> bytes:
    """Return the shared library of a C source.

    Raises:
        InputError: there is no compiler, or it fails.
    """
    command = find_compiler()
    if command is None:
        raise InputError(f"{NOT_FOUND}: install one, or leave the compilation to the tool by binary=False (--sources)")
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "share"
        optimisation = "-O0" if len(source) > _MOST_OPTIMISED else "-O1"
        flags = ("-std=c11", optimisation, "-fvisibility=hidden", "-ffp-contract=off")
        problem = compile_library(source, (*command, *flags), made, ("-lm",))
        if problem is not None:
            remedy = "set $CC to another compiler, or use binary=False (--sources)"
            raise InputError(f"{command[0]} could not compile the FMU ({problem}): {remedy}")
        return made.read_bytes()


def _archive(content: dict[str, bytes]) -> bytes:
    """Return files as one zip archive."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, data in content.items():
            archive.writestr(zipfile.ZipInfo(name, _DATE), data, zipfile.ZIP_DEFLATED)
    return packed.getvalue()
