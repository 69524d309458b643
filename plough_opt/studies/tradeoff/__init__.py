"""Trade-offs: the curve of designs of which none is better in one objective without being worse in another."""

from plough_opt.studies.tradeoff.front import Goal
from plough_opt.studies.tradeoff.result import TradeOff
from plough_opt.studies.tradeoff.trade import trade_off

__all__ = ["Goal", "TradeOff", "trade_off"]
