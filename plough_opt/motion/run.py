"""Run: what a simulation found, as numbers or as expressions of a design."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from plough_opt.core.checks import check_domain
from plough_opt.core.errors import InputError
from plough_opt.core.expressions import Column, Expression, is_casadi
from plough_opt.core.files import drawn, from_above
from plough_opt.core.saving import Origin, Saveable
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.motion.accuracy import Accuracy
from plough_opt.motion.averages import Averages, Checks, Settled
from plough_opt.motion.scene import Scene
from plough_opt.motion.scene_quantities import quantities_of

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

OUTPUTS: Final = {
    "time": "s", "travel": "m", "speed": "m/s", "deflection": "m", "mount_force": "N", "soil_resistance": "N",
    "opening": "m", "mode": "",
}  # fmt: skip
"""Arrays of a run over its output times -> their units."""

# Peaks -> the names under which files limit them, and write their units.
_LIMITED: Final = {"peak_force": "mount_force", "peak_deflection": "deflection"}


@dataclass(frozen=True, repr=False, eq=False)
class Run(Saveable):
    """A simulated run: arrays over the output times, averages, and how far they can be trusted.

    Of a numeric scene every value is a float or an array of n + 1 outputs; of a symbolic scene each is
    a CasADi expression (arrays: a column), and the run has no error estimate, time taken or peak of its own.

    Attributes:
        scene: the scene.
        duration: simulated time [s].
        time: output times [s].
        travel: L of the share [m]; 0 at the unloaded spring's position when the strut is at 0.
        speed: L' of the share [m/s].
        deflection: z of the spring, compression positive [m].
        mount_force: P = k0 z + c z' of spring and damper on the share [N]. Under the print's repelling spring the
            force on the share is -k0 z + c z'; the P(t) = k0 (V0 t - L) of its figures is then the negative of the
            spring's part.
        soil_resistance: F on the share, the added mass's part included [N].
        opening: how far the share is behind its furthest point, with a gap ahead [m]; zero but under `StickSlip`.
        mode: 0 where the share slips, 1 where it sticks, 2 in a gap; zero but under `StickSlip`.
        averages: mean draft and the like; each is also an attribute of the run.
        accuracy: method and setting that were used.
        checks: error estimate, time taken and warnings of a numeric run, each also an attribute of the run.
        origin: what made it.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> run = po.simulate(scene, "1 s")
        >>> bool(run.mean_draft == run.force_rms)
        False
    """

    scene: Scene
    duration: Expression
    time: Column
    travel: Column
    speed: Column
    deflection: Column
    mount_force: Column
    soil_resistance: Column
    opening: Column
    mode: Column
    averages: Averages
    accuracy: Accuracy
    checks: Checks | None = None
    origin: Origin = field(default=Origin())
    kind = "run"

    def __repr__(self) -> str:
        """Return in a line what was found; the arrays would fill pages."""
        if self.checks is None:
            return "<Run: expressions of a scene's symbols>"
        return (
            f"<Run: {self.duration:g} s in {len(self.time) - 1} intervals by {self.accuracy.method}, mean draft"
            f" {self.mean_draft:.6g} N, RMS {self.force_rms:.6g} N, error estimate {self.error_estimate:.1e}>"
        )

    def page(self) -> Page:
        """Return the results of a numeric run as a table, with what a reader must know."""
        if self.checks is None:
            return Page(repr(self))
        head = f"{self.duration:g} s of a {self.scene.describe()}, by {self.accuracy.method}"
        trust = f"relative error about {self.error_estimate:.0e}, {self.seconds:.2f} s"
        return Page(head, (self.response(),), self.warnings, trust, self.origin.title)

    def response(self) -> Grid:
        """Return the table of the results of a numeric run, each in one unit: see `Origin`."""
        return response_table({"": self}, self.origin)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each output time of a numeric run, SI; ``attrs["units"]`` has the units.

        Raises:
            InputError: a symbolic run, or pandas is not installed.
        """
        self._known("data frame")
        return data_frame({name: getattr(self, name) for name in OUTPUTS}, OUTPUTS)

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw forces, deflection and speed over time.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: a symbolic run, a file name without a known ending, or a place that cannot be written.
        """
        self._known("picture")
        return drawn("plot_run", self, target=target)

    def animate(self, target: str | Path, *, slower: float = 5.0) -> Path:
        """Write the motion as a picture that moves: the share behind its strut, and its deflection.

        Args:
            target: file to write: .gif, or .html with buttons and keys to play and step (needs jinja2).
            slower: how many times slower than the motion a GIF plays; in a page that is chosen.

        Returns:
            The path.

        Raises:
            InputError: a symbolic run, one in which nothing changes, another ending, or a place that cannot be written.
            DomainError: ``slower`` is not above 0.

        Example:
            >>> run.animate("out/share.gif", slower=10)  # doctest: +SKIP
        """
        self._known("animation")
        path: Path = from_above("animation", "write_animation")(self, target, slower)
        return path

    def to_json(self, page: Page | None = None) -> str:
        """Return a numeric run as JSON: see `Saveable.to_json`.

        Raises:
            InputError: a symbolic run.
        """
        self._known("file")
        return super().to_json(page)

    def also_saved(self) -> dict[str, Any]:
        """Return results that follow from the others, and the scene's quantities by their names in files."""
        names = ("error_estimate", "seconds", "warnings", "peak_force", "peak_deflection")
        section = None if self.scene.law.lacks("loosened_radius") else self.specific_draft
        quantities = {name: x for name, x in quantities_of(self.scene).items() if x is not None}
        return {**{name: getattr(self, name) for name in names}, "specific_draft": section,
                "ambient_share": self.scene.ambient_share, "quantities": quantities}  # fmt: skip

    def check_saved(self) -> None:
        """Refuse arrays of other lengths than the times, and averages that are not numbers."""
        if self.checks is None:
            raise ValueError("a numeric run has its checks")
        for name in OUTPUTS:
            if np.shape(getattr(self, name)) != np.shape(self.time) or np.ndim(self.time) != 1:
                raise ValueError(f"{name} must have a number for each output time")
        for name in Averages.__dataclass_fields__:
            if np.ndim(getattr(self.averages, name)):
                raise ValueError(f"averages.{name} must be a number")

    def picture(self) -> Figure | None:
        """Return the picture for a notebook; a symbolic run has none."""
        return None if self.checks is None else self.plot()

    @property
    def mean_draft(self) -> Expression:
        """Time average of the mount force P [N]."""
        return self.averages.mean_draft

    @property
    def force_rms(self) -> Expression:
        """Standard deviation of the mount force about its mean [N]."""
        return self.averages.force_rms

    @property
    def mean_deflection(self) -> Expression:
        """Time average of the spring's deflection [m]."""
        return self.averages.mean_deflection

    @property
    def displacement_rms(self) -> Expression:
        """Standard deviation of the spring's deflection about its mean [m]."""
        return self.averages.displacement_rms

    @property
    def tow_power(self) -> Expression:
        """Time average of the power P s' that the strut delivers [W]."""
        return self.averages.tow_power

    @property
    def specific_draft(self) -> Expression:
        """Mean draft per loosened section pi r*^2 at the share's base [N/m^2]; the elastic medium has none.

        Raises:
            DomainError: a share so small that its section is zero in floating point.
        """
        section = math.pi * self.scene.loosened_radius**2
        check_domain("loosened section", section, "m^2", above=0.0, why="take a larger share")
        return self.mean_draft / section

    @property
    def peak_force(self) -> float:
        """Largest mount force at an output time [N]; of a numeric run only."""
        return self._peak("peak_force", self.mount_force, "mount_force")

    @property
    def peak_deflection(self) -> float:
        """Largest deflection at an output time [m]; of a numeric run only."""
        return self._peak("peak_deflection", self.deflection, "deflection")

    @property
    def error_estimate(self) -> float:
        """Estimated relative error [-] of every result, each on its own scale: see `simulate`. Of numbers only."""
        return self._known("error estimate").error_estimate

    @property
    def seconds(self) -> float:
        """Time that the run and its check took [s]. A numeric run only."""
        return self._known("time taken").seconds

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings: limits of the theory, a retreating share, an accuracy that was not reached."""
        if self.checks is None:
            return ("a symbolic run cannot be checked: simulate the scene with numbers, for instance best(run)",)
        return (*self.scene.warnings(), *self.checks.notes)

    @property
    def floquet(self) -> tuple[complex, ...]:
        """Floquet multipliers of a periodic orbit [-]: factors by which deviations grow in one wavelength.

        Raises:
            InputError: a run of expressions, or one that is not a periodic orbit.
        """
        multipliers = self._known("Floquet multipliers").floquet
        if not multipliers:
            raise InputError("only a periodic orbit has Floquet multipliers: take orbit = 'periodic'")
        return multipliers

    @property
    def settles(self) -> Settled:
        """To which motion a share comes that starts from equilibrium: this periodic orbit, or what else.

        Raises:
            InputError: a run of expressions, or one that is not a periodic orbit.
        """
        found = self._known("motion to which a share settles").settles
        if found is None:
            raise InputError("only a periodic orbit says to which motion a share settles: take orbit = 'periodic'")
        return found

    def _known(self, what: str) -> Checks:
        if self.checks is None:
            raise InputError(f"a symbolic run has no {what}: simulate the scene with numbers, for instance best(run)")
        return self.checks

    def _peak(self, name: str, values: Column, array: str) -> float:
        if is_casadi(values):
            raise InputError(
                f"a symbolic run has no {name}, which has no derivative: limit run.{array} itself, at every output"
            )
        return float(np.max(values))


def response_table(runs: Mapping[str, Any], origin: Origin) -> Grid:
    """Return the table of results of numeric runs side by side, each row in one unit: see `Origin`.

    Args:
        runs: heading of a column -> run; of several the sum stands behind them, of what adds up.
        origin: of the runs.
    """
    every, several = [*runs.values()], len(runs) > 1
    scenes = [run.scene for run in every]
    names = {
        "N": ("mean_draft", "force_rms", "peak_force"),
        "m": ("peak_deflection", "mean_deflection", "displacement_rms"),
        "W": ("tow_power",),
    }
    units = {
        unit: origin.common(unit, {_LIMITED.get(name, name): max((_result(run, name) for run in every), key=abs)
                                   for name in own})
        for unit, own in names.items()
    }  # fmt: skip
    grid = Grid.of("Response", "", *runs, *(["together"] if several else []))

    def row(label: str, name: str, unit: str, adds: bool = False) -> None:
        values = [_result(run, name) for run in every]
        shown = units.get(unit) or origin.common(unit, {name: max(values, key=abs)})
        together = [shown.text(sum(values)) if adds else ""] if several else []
        grid.row(label, *map(shown.text, values), *together)

    row("mean draft", "mean_draft", "N", adds=True)
    row("RMS of the mount force", "force_rms", "N")
    row("mean deflection", "mean_deflection", "m")
    row("RMS of the deflection", "displacement_rms", "m")
    row("tow power", "tow_power", "W", adds=True)
    if all(scene.effects.random_strength is not None for scene in scenes):
        row("stationary RMS of the mount force", "stationary_force_rms", "N")
        row("stationary RMS of the deflection", "stationary_displacement_rms", "m")
    if not any(scene.law.lacks("loosened_radius") for scene in scenes):
        row("draft per loosened section", "specific_draft", "Pa")
        row("loosened radius", "loosened_radius", "m")
    row("peak mount force", "peak_force", "N")
    row("peak deflection", "peak_deflection", "m")
    if all(scene.effects.orbit == "periodic" for scene in scenes):
        comes = {True: "comes to this orbit", False: "comes to another motion", None: "has not settled"}
        rest = [""] if several else []
        grid.row("largest Floquet multiplier", *(f"{max(map(abs, run.floquet)):.4g}" for run in every), *rest)
        grid.row("a share from equilibrium", *(comes[run.settles.orbit] for run in every), *rest)
    return grid


def _result(run: Any, name: str) -> float:
    return float(getattr(run if hasattr(type(run), name) else run.scene, name))
