"""A design's program with certain numbers of integration steps, and the IPOPT solvers of it."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from plough_opt.design.forms import as_machine_code, relaxed
from plough_opt.design.ipopt import Solver, Vector
from plough_opt.design.nlp import Nlp


@dataclass(frozen=True, eq=False)
class BuiltProgram:
    """A program with certain numbers of integration steps; its solvers are built when first needed.

    Attributes:
        steps: for each run, the number of steps, or None for the method it was written with.
        rough_steps: the same for the rough program.
        write: builds the program from numbers of steps.
        owner: for each row of the requirements, the number of its requirement.
        limits: scaled lower and upper limits of the rows.
        compiled: whether to translate the program into machine code.
        errors: cache of the errors of derivatives, by scaled design and parameters.
    """

    steps: list[int | None]
    rough_steps: list[int | None]
    write: Callable[[list[int | None]], Nlp]
    owner: Sequence[int]
    limits: tuple[Vector, Vector]
    compiled: bool
    errors: dict[Hashable, float] = field(default_factory=dict)

    @cached_property
    def plain(self) -> Nlp:
        """The program, interpreted."""
        return self.write(self.steps)

    @cached_property
    def nlp(self) -> Nlp:
        """The program, in machine code if ``compiled`` and if there is a compiler."""
        return (as_machine_code(self.plain) if self.compiled else None) or self.plain

    @cached_property
    def rough(self) -> Nlp:
        """The program with two fifths of the steps, enough to tell the sign of the Lagrangian's curvatures."""
        return self.write(self.rough_steps)

    @cached_property
    def solver(self) -> Solver:
        """IPOPT on the program."""
        return Solver(self.nlp, *self.limits)

    @cached_property
    def relaxed(self) -> Solver:
        """IPOPT on the sum of the requirements' violations."""
        return Solver(relaxed(self.nlp, self.owner), *self.limits)
