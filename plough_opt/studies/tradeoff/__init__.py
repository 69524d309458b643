"""Trade-offs: fronts of designs that cannot improve in one objective without getting worse in another."""

from plough_opt.studies.tradeoff.assembly import trade_off
from plough_opt.studies.tradeoff.front import Goal
from plough_opt.studies.tradeoff.result import TradeOff

__all__ = ["Goal", "TradeOff", "trade_off"]
