"""Components: a scene as one CasADi Function of named inputs and outputs, with units and bounds."""

from plough_opt.exchange.component.building import build, component
from plough_opt.exchange.component.function import Component
from plough_opt.exchange.component.ports import Input, Output, Port

__all__ = ["Component", "Input", "Output", "Port", "build", "component"]
