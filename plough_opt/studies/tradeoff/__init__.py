"""Trade-offs: fronts of designs that cannot improve in one objective without getting worse in another."""

from plough_opt.studies.tradeoff.front import Goal
from plough_opt.studies.tradeoff.result import TradeOff
from plough_opt.studies.tradeoff.trade import trade_off

__all__ = ["Goal", "TradeOff", "trade_off"]
