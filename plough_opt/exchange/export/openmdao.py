"""A component for OpenMDAO: in this process, or as a Python module that needs only casadi and openmdao."""

import inspect
import keyword
import pprint
import re
import sys
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import Any

import casadi as ca
import numpy as np

from plough_opt.core.errors import InputError
from plough_opt.core.files import Content, check_new_folder, text_of, write_folder
from plough_opt.core.process import optional
from plough_opt.exchange.component import Component
from plough_opt.exchange.export.c import described, serialised

optional("openmdao.api")
import openmdao.api as om  # noqa: E402, the line above says how to install it

# Names that the written module uses, which its class must not have.
_RESERVED_CLASSES = {"Any", "FunctionComponent"}
# Names of other modules, which the written module must not hide.
_RESERVED_MODULES = {"casadi", "numpy", "openmdao", *sys.stdlib_module_names}
# The example at the end of a docstring.
_EXAMPLE = re.compile(r"\n\n( *)Example:\n(?:\1 .*\n|\n)+")


# The source of this class and of `units_of` is copied into the written module: they must not use plough_opt.
class FunctionComponent(om.ExplicitComponent):  # type: ignore[misc]
    """A CasADi Function of scalars as an explicit component, with CasADi's exact derivatives as its partials.

    Args:
        function: the Function; its inputs and outputs have OpenMDAO's names.
        inputs: a dictionary for each input: argument, unit, lower, upper, value.
        outputs: a dictionary for each output: argument, unit, lower, upper (None: no limit), value, size.
    """

    def __init__(self, function: ca.Function, inputs: Any, outputs: Any, **options: Any) -> None:
        super().__init__(**options)
        self._graph, self._sources, self._results = function, inputs, outputs
        x = ca.MX.sym("x", len(inputs))
        values = ca.vertcat(*function.call(ca.vertsplit(x)))
        self._graph_slopes = ca.Function("slopes", [x], [ca.densify(ca.jacobian(values, x))])

    def setup(self) -> None:
        """Declare inputs, outputs, and the partials that are not always zero."""
        for port in self._sources:
            self.add_input(port["argument"], val=port["value"], units=units_of(port["unit"]))
        for k, port in enumerate(self._results):
            shape = (port["size"],)
            self.add_output(port["argument"], val=port["value"], shape=shape, units=units_of(port["unit"]))
            for j, source in enumerate(self._sources):
                if self._graph.jac_sparsity(k, j).nnz():
                    self.declare_partials(port["argument"], source["argument"])
        # `check_partials` uses central differences, with a relative step that suits 0.1 rad as well as 1e6 N/m.
        self.set_check_partial_options("*", method="fd", form="central", step=5e-6, step_calc="rel_element")

    def compute(self, inputs: Any, outputs: Any) -> None:
        """Evaluate the Function."""
        found = self._graph.call(self._values(inputs))
        for port, value in zip(self._results, found, strict=True):
            array = value.full().ravel()
            if not np.all(np.isfinite(array)):
                raise om.AnalysisError(f"'{port['argument']}' has no finite value at {self._values(inputs)}")
            outputs[port["argument"]] = array

    def compute_partials(self, inputs: Any, partials: Any) -> None:
        """Evaluate CasADi's Jacobian."""
        jacobian = self._graph_slopes(self._values(inputs)).full()
        row = 0
        for k, port in enumerate(self._results):
            for j, source in enumerate(self._sources):
                if self._graph.jac_sparsity(k, j).nnz():
                    partials[port["argument"], source["argument"]] = jacobian[row : row + port["size"], j : j + 1]
            row += port["size"]

    def _values(self, inputs: Any) -> list[float]:
        """Return the values of the inputs.

        Raises:
            AnalysisError: an input is outside its bounds, for which steps and checks were not chosen. The driver then
                tries another step.
        """
        values = [float(inputs[port["argument"]].item()) for port in self._sources]
        for value, port in zip(values, self._sources, strict=True):
            slack = 1e-6 * (port["upper"] - port["lower"])  # optimisers relax bounds by this
            if not port["lower"] - slack <= value <= port["upper"] + slack:
                bounds = f"{port['lower']:g} and {port['upper']:g}, the bounds of the component"
                raise om.AnalysisError(f"{port['argument']} = {value:g} must lie between {bounds}")
        return values

    def add_design(self, model: Any, objective: str, prefix: str = "") -> None:
        """Make every input a design variable between its bounds, and every output with limits a constraint.

        Args:
            model: the group whose driver chooses.
            objective: name of the output to minimise.
            prefix: path of this component in the model, with a dot at its end; "" if its names are promoted.

        Example:
            >>> import openmdao.api as om
            >>> import plough_opt as po
            >>> problem = po.read_problem("problems/reference.toml", ["effects.motion=false"])
            >>> share = po.export.PloughComponent(component=problem.component(outputs=["mean_draft"]))
            >>> driven = om.Problem(reports=False)
            >>> driven.model = om.Group()
            >>> _ = driven.model.add_subsystem("share", share, promotes=["*"])
            >>> share.add_design(driven.model, "mean_draft")
            >>> _ = driven.setup()
            >>> len(driven.model.get_design_vars())
            3
        """
        names = [port["argument"] for port in self._results]
        if objective not in names:
            raise ValueError(f"no output is named '{objective}': one of {', '.join(names)} can be the objective")
        for port in self._sources:
            lower, upper = port["lower"], port["upper"]
            model.add_design_var(prefix + port["argument"], lower=lower, upper=upper, ref0=lower, ref=upper)
        for port in self._results:
            limits = {side: port[side] for side in ("lower", "upper") if port[side] is not None}
            if limits and port["argument"] != objective:
                model.add_constraint(prefix + port["argument"], ref=max(map(abs, limits.values())) or 1.0, **limits)
        size = self._results[names.index(objective)]["value"]
        model.add_objective(prefix + objective, ref=abs(size) or 1.0)


def units_of(unit: str) -> str | None:
    """Return a unit as OpenMDAO spells it: powers with two asterisks, None for a pure number."""
    return unit.replace("^", "**") or None


class PloughComponent(FunctionComponent):
    """A component as an ``openmdao.api.ExplicitComponent``, in SI units; names are like "share_height".

    Its partials are CasADi's exact Jacobian. `add_design` declares design variables, constraints and objective.

    Args:
        component: a component made by `plough_opt.component` or `Problem.component`.
        options: options of OpenMDAO's class.

    Example:
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s")
        >>> component = po.component(scene, 0.5, inputs=["scene.stiffness"], outputs=["mean_draft"])
        >>> type(po.export.PloughComponent(component=component)).__name__
        'PloughComponent'
    """

    def __init__(self, component: Component, **options: Any) -> None:
        ports = described(component)
        super().__init__(component, ports["inputs"], ports["outputs"], **options)


def write_openmdao(component: Component, path: str | Path) -> Path:
    """Write a component as a Python module and a serialised Function, into a new folder.

    For a component named ``share`` the folder holds ``share.py`` and ``share.casadi``. The module defines a class
    ``Share``, an ``openmdao.api.ExplicitComponent`` without arguments, which loads ``share.casadi``. Both need casadi
    and openmdao, but not plough_opt.

    Args:
        component: the component; its name becomes the module's.
        path: path of the folder, which must not exist.

    Returns:
        The path.

    Raises:
        InputError: the folder exists or cannot be written, or the component's name cannot be a module's.

    Example:
        >>> import tempfile
        >>> import plough_opt as po
        >>> soil = po.named_soil("serozem")
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(soil, share, "50 kN/m", "30 kg", "2 m/s")
        >>> component = po.component(scene, 0.5, inputs=["scene.stiffness"], outputs=["mean_draft"])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = po.export.write_openmdao(component, f"{folder}/share.py")
        >>> path.name
        'share.py'
    """
    target = check_new_folder(path, "OpenMDAO component")
    name = component.name()
    if keyword.iskeyword(name) or name in _RESERVED_MODULES or _class_name(name) in _RESERVED_CLASSES:
        raise InputError(f"a module cannot be named '{name}': give the component another name")
    files: dict[str, Content] = {f"{name}.py": _module(component), f"{name}.casadi": serialised(component)}
    return write_folder(target, "OpenMDAO component", files)


def _module(component: Component) -> str:
    """Return the module's text: `FunctionComponent`, `units_of`, and the data of this component."""
    name, ports = component.name(), described(component)
    classes = "\n\n".join(inspect.getsource(one) for one in (FunctionComponent, units_of)).rstrip()
    tables = {key: pprint.pformat(ports[key], width=110, sort_dicts=False) for key in ("inputs", "outputs")}
    about = str(component).replace("\\", "\\\\").replace('"""', "'''")  # so that it does not end its docstring
    return Template(text_of(__package__, "openmdao_module.txt")).substitute(
        version=version("plough_opt"), about=about, name=name, kind=_class_name(name), **tables,
        classes=_EXAMPLE.sub("\n", classes),  # the examples import plough_opt
    )  # fmt: skip


def _class_name(name: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in name.split("_"))
