"""Run: the results of a simulation, as numbers or as expressions for a design."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from plough_opt.core.checks import check_domain, check_kind, mapping_of, shown
from plough_opt.core.errors import InputError, merge
from plough_opt.core.expressions import Column, Expression, is_casadi
from plough_opt.core.files import drawn, from_above
from plough_opt.core.plain_data import Complex, MaybeInfinite
from plough_opt.core.saving import Origin, Saveable
from plough_opt.core.tables import Grid, Page, data_frame
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.scene import Scene, quantities_of

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

ARRAYS: Final = {
    "time": "s", "travel": "m", "speed": "m/s", "deflection": "m", "mount_force": "N", "soil_resistance": "N",
    "opening": "m", "mode": "",
}  # fmt: skip
"""Name of an array over the output times -> its unit."""

ARRAY_OF_PEAK: Final = {"peak_force": "mount_force", "peak_deflection": "deflection"}
"""Peak -> the array that it is of, whose limit in a problem file, and so whose unit, applies to it."""


@dataclass(frozen=True, repr=False, eq=False)
class Run(Saveable):
    """Simulated run: arrays over the output times, averages, and an error estimate.

    For a numeric scene every value is a float or an array of n + 1 outputs. For a symbolic scene every value is a
    CasADi expression (arrays are columns), and the run has no error estimate, computing time or peaks.

    Attributes:
        scene: the scene.
        duration: simulated time [s].
        time: output times [s].
        travel: L of the share [m]; 0 at the unloaded spring's position when the strut is at 0.
        speed: L' of the share [m/s].
        deflection: z of the spring, compression positive [m].
        mount_force: P = k0 z + c z' of spring and damper on the share [N]. Under the print's repelling spring the force
            on the share is -k0 z + c z'; the spring's part then has the opposite sign of P(t) = k0 (V0 t - L) in the
            print's figures.
        soil_resistance: F on the share, including the added mass's part [N].
        opening: distance of the share behind its furthest point, which is the gap ahead of it [m]; 0 unless under
            `StickSlip`.
        mode: 0 while the share slips, 1 while it sticks, 2 in a gap; 0 unless under `StickSlip`.
        averages: mean draft and other averages; each is also an attribute of the run.
        accuracy: method and setting used.
        checks: error estimate, computing time and warnings of a numeric run; each is also an attribute of the run.
        origin: the question behind the run.

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
        """Return a summary in one line, without the arrays."""
        if self.checks is None:
            return "<Run: expressions of a scene's symbols>"
        return (
            f"<Run: {self.duration:g} s in {len(self.time) - 1} intervals by {self.accuracy.method}, mean draft"
            f" {self.mean_draft:.6g} N, RMS {self.force_rms:.6g} N, error estimate {self.error_estimate:.1e}>"
        )

    def page(self) -> Page:
        """Return the results of a numeric run as a table, with its warnings and error estimate.

        Example:
            >>> import plough_opt as po
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> run.page().parts[0].rows[0][0]
            'mean draft'
        """
        if self.checks is None:
            return Page(repr(self))
        head = f"{self.duration:g} s of a {self.scene.describe()}, by {self.accuracy.method}"
        trust = f"relative error about {self.error_estimate:.0e}, {self.seconds:.2f} s"
        return Page(head, (self.response(),), self.warnings, trust, self.origin.title)

    def response(self) -> Grid:
        """Return the table of results of a numeric run; a row has one unit, that of the question if it has one.

        Example:
            >>> import plough_opt as po
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> run.response().rows[0]
            ('mean draft', '1.993 kN')
        """
        return response_table({"": self}, self.origin)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each output time of a numeric run, in SI units; ``attrs["units"]`` has the units.

        Raises:
            InputError: the run is symbolic, or pandas is not installed.

        Example:
            >>> import plough_opt as po
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> table = run.to_dataframe()
            >>> len(table), table.attrs["units"]["mount_force"]
            (401, 'N')
        """
        self._numeric("data frame")
        return data_frame({name: getattr(self, name) for name in ARRAYS}, ARRAYS)

    def plot(self, target: str | Path | None = None) -> Figure:
        """Draw forces, deflection and speed over time.

        Args:
            target: file to write (.png, .svg, .pdf), or None.

        Raises:
            InputError: the run is symbolic, the file name has no known ending, or the file cannot be written.

        Example:
            >>> import plough_opt as po
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> [axes.get_ylabel() for axes in run.plot().axes]
            ['force [kN]', 'deflection [m]', 'speed [km/h]']
        """
        self._numeric("picture")
        return drawn("plot_run", self, target=target)

    def animate(self, target: str | Path, *, slower: float = 5.0) -> Path:
        """Write an animation of the motion: the share behind its strut, and its deflection.

        Args:
            target: file to write: .gif, or .html with buttons and keys to play and step (needs jinja2).
            slower: factor by which a GIF plays slower than the motion; an HTML page lets the reader choose.

        Returns:
            The path.

        Raises:
            InputError: the run is symbolic, nothing changes in it, the file name has another ending, or the file cannot
                be written.
            DomainError: ``slower`` is not above 0.

        Example:
            >>> run.animate("out/share.gif", slower=10)  # doctest: +SKIP
        """
        self._numeric("animation")
        path: Path = from_above("animation", "write_animation")(self, target, slower)
        return path

    def to_json(self, page: Page | None = None) -> str:
        """Return a numeric run as JSON: see `Saveable.to_json`.

        Raises:
            InputError: the run is symbolic.

        Example:
            >>> import json
            >>> import plough_opt as po
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> json.loads(run.to_json())["kind"]
            'run'
        """
        self._numeric("file")
        return super().to_json(page)

    def also_saved(self) -> dict[str, Any]:
        """Return derived results, and the scene's quantities by their names in problem files."""
        names = ("error_estimate", "seconds", "warnings", "peak_force", "peak_deflection")
        section = None if self.scene.law.lacks("loosened_radius") else self.specific_draft
        quantities = {name: x for name, x in quantities_of(self.scene).items() if x is not None}
        return {**{name: getattr(self, name) for name in names}, "specific_draft": section,
                "ambient_share": self.scene.ambient_share, "quantities": quantities}  # fmt: skip

    def check_saved(self) -> None:
        """Raise ValueError if an array has another length than the times, or an average is not a number."""
        if self.checks is None:
            raise ValueError("a numeric run has its checks")
        for name in ARRAYS:
            if np.shape(getattr(self, name)) != np.shape(self.time) or np.ndim(self.time) != 1:
                raise ValueError(f"{name} must have a number for each output time")
        for name in Averages.__dataclass_fields__:
            if np.ndim(getattr(self.averages, name)):
                raise ValueError(f"averages.{name} must be a number")

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
        """Mean draft per loosened section pi r*^2 at the share's base [N/m^2].

        Raises:
            InputError: the law of resistance, such as the elastic medium, gives no loosened radius.
            DomainError: the share is so small that its section is zero in floating point.
        """
        section = math.pi * self.scene.loosened_radius**2
        check_domain("loosened section", section, "m^2", above=0.0, why="use a larger share")
        return self.mean_draft / section

    @property
    def peak_force(self) -> float:
        """Largest mount force at an output time [N], of a numeric run."""
        return self._peak("peak_force")

    @property
    def peak_deflection(self) -> float:
        """Largest deflection at an output time [m], of a numeric run."""
        return self._peak("peak_deflection")

    @property
    def error_estimate(self) -> float:
        """Estimated relative error [-] of every result of a numeric run, each on its own scale: see `simulate`."""
        return self._numeric("error estimate").error_estimate

    @property
    def seconds(self) -> float:
        """Computing time of a numeric run and its check [s]."""
        return self._numeric("computing time").seconds

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about limits of the theory, a retreating share, or an error that was not reached."""
        if self.checks is None:
            return ("a symbolic run cannot be checked: simulate the scene with numbers, for instance by best(run)",)
        return (*self.scene.warnings(), *self.checks.notes)

    @property
    def floquet(self) -> tuple[complex, ...]:
        """Floquet multipliers of a periodic orbit [-]: factors by which deviations grow over one wavelength.

        Raises:
            InputError: the run is symbolic, or not a periodic orbit.
        """
        multipliers = self._numeric("Floquet multipliers").floquet
        if not multipliers:
            raise InputError("only a periodic orbit has Floquet multipliers: use orbit = 'periodic'")
        return multipliers

    @property
    def settles(self) -> Settled:
        """Motion to which a share settles from equilibrium: this periodic orbit, or another one.

        Raises:
            InputError: the run is symbolic, or not a periodic orbit.
        """
        found = self._numeric("motion to which a share settles").settles
        if found is None:
            raise InputError(
                "only runs of a periodic orbit say to which motion a share settles: use orbit = 'periodic'"
            )
        return found

    def _numeric(self, what: str) -> Checks:
        """Return the checks of a numeric run; raise InputError for a symbolic one, which does not have ``what``."""
        if self.checks is None:
            raise InputError(
                f"a symbolic run has no {what}: simulate the scene with numbers, for instance by best(run)"
            )
        return self.checks

    def _peak(self, name: str) -> float:
        array = ARRAY_OF_PEAK[name]
        values = getattr(self, array)
        if is_casadi(values):
            raise InputError(
                f"a symbolic run has no {name}, which is not differentiable: limit run.{array} at every output instead"
            )
        return float(np.max(values))


WITHOUT_RANDOM: Final = " without random strength"
"""What follows the names of RMS and peaks of a motion in a soil of random strength, which no motion includes."""


def response_table(runs: Mapping[str, Any], origin: Origin) -> Grid:
    """Return the table of results of numeric runs side by side; a row has one unit.

    Args:
        runs: heading of a column -> run. For several runs a last column has the sums of additive results.
        origin: the question behind the runs, whose units the table uses.
    """
    every, several = [*runs.values()], len(runs) > 1
    scenes = [run.scene for run in every]
    names = {
        "N": ("mean_draft", "force_rms", "peak_force"),
        "m": ("peak_deflection", "mean_deflection", "displacement_rms"),
        "W": ("tow_power",),
    }
    units = {
        unit: origin.common(unit, {ARRAY_OF_PEAK.get(name, name): max((_result(run, name) for run in every), key=abs)
                                   for name in own})
        for unit, own in names.items()
    }  # fmt: skip
    grid = Grid.of("Response", "", *runs, *(["together"] if several else []))

    def row(label: str, name: str, unit: str, adds: bool = False) -> None:
        values = [_result(run, name) for run in every]
        shown = units.get(unit) or origin.common(unit, {name: max(values, key=abs)})
        together = [shown.result(sum(values)) if adds else ""] if several else []
        grid.row(label, *map(shown.result, values), *together)

    row("mean draft", "mean_draft", "N", adds=True)
    # Simulated motions do not include random strength.
    random = all(scene.effects.random_strength is not None for scene in scenes)
    without = WITHOUT_RANDOM if random else ""
    row(f"RMS of the mount force{without}", "force_rms", "N")
    row("mean deflection", "mean_deflection", "m")
    row(f"RMS of the deflection{without}", "displacement_rms", "m")
    row("tow power", "tow_power", "W", adds=True)
    if random:
        row("stationary RMS of the mount force", "stationary_force_rms", "N")
        row("stationary RMS of the deflection", "stationary_displacement_rms", "m")
    if not any(scene.law.lacks("loosened_radius") for scene in scenes):
        row("draft per loosened section", "specific_draft", "Pa")
        row("loosened radius", "loosened_radius", "m")
    row(f"peak mount force{without}", "peak_force", "N")
    row(f"peak deflection{without}", "peak_deflection", "m")
    if random and all(scene.effects.motion for scene in scenes):
        row("mount force exceeded in 5 % of passes of 1 km", "stationary_peak_force", "N")
        row("deflection exceeded in 5 % of passes of 1 km", "stationary_peak_deflection", "m")
    if all(scene.effects.orbit == "periodic" for scene in scenes):
        settled = {True: "comes to this orbit", False: "comes to another motion", None: "has not settled"}
        rest = [""] if several else []
        grid.row("largest Floquet multiplier", *(f"{max(map(abs, run.floquet)):.4g}" for run in every), *rest)
        grid.row("a share from equilibrium", *(settled[run.settles.orbit] for run in every), *rest)
    return grid


def _result(run: Any, name: str) -> float:
    """Return a result of a run, or of its scene if the run does not have it."""
    return float(getattr(run if hasattr(type(run), name) else run.scene, name))


@dataclass(frozen=True)
class Settled:
    """Motion to which a share settles from equilibrium.

    Attributes:
        orbit: whether it is the periodic orbit; None if the share has not settled within the simulated wavelengths.
        wavelengths: number of simulated wavelengths.
        period: period of the motion in wavelengths; None if it does not repeat itself.
        force_rms: RMS of the mount force [N] of that motion.
        averaged: number of wavelengths in that RMS: the period, or the last simulated ones without a period.
        distance: distance from the orbit at the end, relative to half the range of the orbit [-].
        retreats: whether the share moves backwards in that motion.
    """

    orbit: bool | None
    wavelengths: int
    period: int | None
    force_rms: float
    averaged: int
    distance: float
    retreats: bool

    @property
    def text(self) -> str:
        """Predicate of a sentence about a share that starts from equilibrium."""
        after, back = f"after {self.wavelengths} wavelengths", ", in which it retreats" if self.retreats else ""
        if self.orbit:
            return f"comes to this orbit ({after} it is within {100.0 * self.distance:.1g} % of the orbit's range)"
        if self.orbit is None:
            return f"has not settled {after}; RMS over the last {self.averaged}: {self.force_rms:.4g} N{back}"
        if self.period is None:
            return f"is driven away without bound (within {self.wavelengths} wavelengths)"
        kind = "another motion of the wave's own period" if self.period == 1 else f"a period-{self.period} motion"
        return f"comes to {kind} of RMS {self.force_rms:.4g} N{back} ({after})"


@dataclass(frozen=True)
class Averages:
    """Time averages of a run. Each RMS is the standard deviation about the mean.

    Attributes:
        mean_draft: mean of the mount force P [N].
        force_rms: RMS of P [N].
        mean_deflection: mean of the spring's deflection z [m].
        displacement_rms: RMS of z [m].
        tow_power: mean of P s' [W].
    """

    mean_draft: Expression
    force_rms: Expression
    mean_deflection: Expression
    displacement_rms: Expression
    tow_power: Expression


@dataclass(frozen=True)
class Checks:
    """Error estimate, computing time and warnings of a numeric run.

    Attributes:
        error_estimate: estimated relative error [-] of every result: see `plough_opt.simulate`.
        seconds: computing time [s].
        notes: warnings about this run, besides those about its scene.
        floquet: Floquet multipliers of a periodic orbit [-].
        settles: for a periodic orbit, the motion to which a share settles from equilibrium.
    """

    error_estimate: MaybeInfinite
    seconds: float
    notes: tuple[str, ...]
    floquet: tuple[Complex, ...] = ()
    settles: Settled | None = None


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
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> machine = po.Machine({"front": run, "rear": run})
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
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> machine = po.Machine({"front": run, "rear": run})
            >>> machine.response().rows[0]
            ('mean draft', '1.993 kN', '1.993 kN', '3.987 kN')
        """
        return response_table(self.runs, self.origin)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each share and output time, in SI units; ``attrs["units"]`` has the units.

        Raises:
            InputError: the runs are symbolic, or pandas is not installed.

        Example:
            >>> import plough_opt as po
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> machine = po.Machine({"front": run, "rear": run})
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
            >>> run = po.read_problem("problems/cotton_subsoiler.toml", ["scene.duration=0.2 s"]).simulate()
            >>> machine = po.Machine({"front": run, "rear": run})
            >>> len(machine.plot().axes)
            2
        """
        return drawn("plot_runs", self.runs, self.origin, target=target)
