"""Components: a scene as one CasADi Function of named inputs and outputs, with units and bounds."""

from plough_opt.exchange.component.building import build, component
from plough_opt.exchange.component.component import Component, Input, Output, Port

__all__ = ["Component", "Input", "Output", "Port", "build", "component"]
