"""A component for OpenMDAO: in this process, or as a module of its own that needs casadi and openmdao only."""

import inspect
import keyword
import pprint
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from plough_opt.core.errors import InputError
from plough_opt.core.files import Content, check_new_folder, write_folder
from plough_opt.exchange.component import Component
from plough_opt.exchange.export.serialised import described, serialised

try:
    from plough_opt.exchange.export import openmdao_client
except ModuleNotFoundError as missing:
    if missing.name is None or missing.name.partition(".")[0] != "openmdao":
        raise
    raise InputError("OpenMDAO is not installed: pip install 'plough_opt[openmdao]'") from None


# Names that the module needs itself.
_INNER = {"Any", "FunctionComponent"}
_TAKEN = {"casadi", "numpy", "openmdao", *sys.stdlib_module_names}


class PloughComponent(openmdao_client.FunctionComponent):
    """A component as an ``openmdao.api.ExplicitComponent``: names with underscores, as "share_height"; SI units.

    Its partials are CasADi's exact Jacobian. `add_design` declares design variables, constraints and objective.

    Args:
        component: what `plough_opt.exchange.component` or `Problem.component` returns.
        options: OpenMDAO's own.
    """

    def __init__(self, component: Component, **options: Any) -> None:
        ports = described(component)
        super().__init__(component, ports["inputs"], ports["outputs"], **options)


def write_openmdao(component: Component, path: str | Path) -> Path:
    """Write a component as a Python module and a serialised Function, into a new folder.

    Of a component named ``share`` the folder holds ``share.py``, with a class ``Share`` that is an
    ``openmdao.api.ExplicitComponent`` and takes no arguments, and ``share.casadi``, which it loads. They need
    casadi and openmdao, and not plough_opt.

    Args:
        component: what to write; its name is the module's.
        path: of the folder, which must not exist.

    Returns:
        The path.

    Raises:
        InputError: the folder exists or cannot be written, or a name that no module can have.
    """
    target = check_new_folder(path, "OpenMDAO component")
    name = component.name()
    if keyword.iskeyword(name) or name in _TAKEN or _class_name(name) in _INNER:
        raise InputError(f"a module cannot be named '{name}': name the component otherwise")
    files: dict[str, Content] = {f"{name}.py": _module(component), f"{name}.casadi": serialised(component)}
    return write_folder(target, "OpenMDAO component", files)


def _module(component: Component) -> str:
    """Return the module's text: the class of any Function, and the data of this one."""
    name, ports = component.name(), described(component)
    _, _, client = inspect.getsource(openmdao_client).partition('"""\n')
    imports, _, classes = client.strip().partition("\n\n\n")
    return f'''"""Written by plough_opt {version("plough_opt")}.

{_quoted(str(component))}
"""

from pathlib import Path as _Path
{imports}

_INPUTS = {pprint.pformat(ports["inputs"], width=110, sort_dicts=False)}

_OUTPUTS = {pprint.pformat(ports["outputs"], width=110, sort_dicts=False)}


{classes}


class {_class_name(name)}(FunctionComponent):
    """The component of {name}.casadi, which lies beside this file."""

    def __init__(self, **options):
        function = ca.Function.load(str(_Path(__file__).with_name("{name}.casadi")))
        super().__init__(function, _INPUTS, _OUTPUTS, **options)
'''


def _class_name(name: str) -> str:
    return "".join(part[:1].upper() + part[1:] for part in name.split("_"))


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"""', "'''")
