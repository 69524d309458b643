"""A program that is written for numbers of steps, with what solves it."""

from __future__ import annotations

from dataclasses import dataclass

from plough_opt.design.active_rows import ActiveRows
from plough_opt.design.ipopt import Solver
from plough_opt.design.nlp import Nlp


@dataclass
class Built:
    """A program that is written for numbers of steps.

    Attributes:
        nlp: objective and requirements.
        rough: the same with fewer steps.
        interpreted: whether it is not in machine code.
        solver: IPOPT on it.
        of_rows: IPOPT on those of its rows that can decide; None where there are few.
        relaxed: IPOPT on the sum of violations, once it was asked for.
    """

    nlp: Nlp
    rough: Nlp
    interpreted: bool
    solver: Solver
    of_rows: ActiveRows | None
    relaxed: Solver | None = None
