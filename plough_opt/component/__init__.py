"""Components: a scene as one CasADi Function of named inputs and outputs, with units and bounds."""

from plough_opt.component.building import build, component
from plough_opt.component.function import Component
from plough_opt.component.ports import Input, Output, Port

__all__ = ["Component", "Input", "Output", "Port", "build", "component"]
