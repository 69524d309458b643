"""Machine: the runs of several shares in one frame, all towed at the same speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from plough_opt.core.checks import check_kind, mapping_of, shown
from plough_opt.core.errors import InputError, merge
from plough_opt.core.expressions import Expression
from plough_opt.core.files import drawn
from plough_opt.core.saving import Origin, Saveable
from plough_opt.core.tables import Grid, Page
from plough_opt.motion.run import Run, response_table

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


def without_repetition(sentences: Sequence[str]) -> list[str]:
    """Return sentences without repetition; those that differ only in their numbers become one with their ranges."""
    notes: dict[str, str] = {}
    for text in sentences:
        merge(notes, text)
    return list(notes.values())


@dataclass(frozen=True, repr=False, eq=False)
class Machine(Saveable):
    """The runs of several shares in one frame.

    Attributes:
        runs: name of a share -> its run.
        origin: the question behind the runs.

    Raises:
        InputError: there are no runs, or one of them is not a `Run`.

    Example:
        >>> import plough_opt as po
        >>> soil, share = po.named_soil("serozem"), po.Wedge("30 deg", "15 deg", "25 cm")
        >>> runs = {
        ...     name: po.simulate(po.Scene(soil, share, stiffness, 30.0, 2.0, po.Effects(motion=False)), 1.0)
        ...     for name, stiffness in (("front", 5e4), ("rear", 1e5))
        ... }
        >>> machine = po.Machine(runs)
        >>> round(float(machine.mean_draft / runs["front"].mean_draft), 9)
        2.0
    """

    runs: Mapping[str, Run]
    origin: Origin = field(default=Origin())
    kind = "machine"

    def __post_init__(self) -> None:
        runs = mapping_of("runs", self.runs, "a share's name -> its run")
        for name, run in runs.items():
            check_kind(f"the run of {shown(name)}", run, Run, "a Run, as returned by po.simulate")
        if not runs:
            raise InputError("a machine needs the run of at least one share")

    @property
    def mean_draft(self) -> Expression:
        """Sum of the mean drafts of all shares [N]."""
        return sum(run.mean_draft for run in self.runs.values())

    @property
    def tow_power(self) -> Expression:
        """Sum of the tow powers of all shares [W]."""
        return sum(run.tow_power for run in self.runs.values())

    @property
    def error_estimate(self) -> float:
        """Largest relative error estimate of the runs [-]."""
        return max(run.error_estimate for run in self.runs.values())

    @property
    def seconds(self) -> float:
        """Computing time of all runs and their checks [s]."""
        return sum(run.seconds for run in self.runs.values())

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the runs of all shares, without repetition."""
        return tuple(without_repetition([text for run in self.runs.values() for text in run.warnings]))

    def page(self) -> Page:
        """Return the results of all shares side by side, and those of the frame.

        Example:
            >>> import plough_opt as po
            >>> machine = po.read_problem("problems/two_shares.toml", ["scene.duration=0.2 s"]).machine()
            >>> [part.title for part in machine.page().parts if hasattr(part, "title")]
            ['Response']
        """
        trust = f"relative error about {self.error_estimate:.0e}, {self.seconds:.2f} s"
        return Page(
            f"{len(self.runs)} shares in one frame", (self.response(),), self.warnings, trust, self.origin.title
        )

    def response(self) -> Grid:
        """Return the table of results: a column for each share, and one for the sums; a row has one unit.

        Example:
            >>> import plough_opt as po
            >>> machine = po.read_problem("problems/two_shares.toml", ["scene.duration=0.2 s"]).machine()
            >>> machine.response().rows[0]
            ('mean draft', '1.993 kN', '1.845 kN', '3.839 kN')
        """
        return response_table(self.runs, self.origin)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each share and output time, in SI units; ``attrs["units"]`` has the units.

        Raises:
            InputError: the runs are symbolic, or pandas is not installed.

        Example:
            >>> import plough_opt as po
            >>> machine = po.read_problem("problems/two_shares.toml", ["scene.duration=0.2 s"]).machine()
            >>> sorted(set(machine.to_dataframe()["share"]))
            ['front', 'rear']
        """
        frames = {name: run.to_dataframe() for name, run in self.runs.items()}
        import pandas

        found = pandas.concat(frames, names=["share", None]).reset_index("share").reset_index(drop=True)
        found.attrs["units"] = next(iter(frames.values())).attrs["units"]
        return found

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw mount force and deflection of every share over time.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: the file name has no known ending, or the file cannot be written.

        Example:
            >>> import plough_opt as po
            >>> machine = po.read_problem("problems/two_shares.toml", ["scene.duration=0.2 s"]).machine()
            >>> len(machine.plot().axes)
            2
        """
        return drawn("plot_machine", self, target=target)
