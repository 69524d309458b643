"""Result of an accuracy study: entries, efficient fronts, advice in a sentence, tables, pictures and files."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from plough_opt.core.errors import InputError
from plough_opt.core.files import figure_with_panels, line_style, shared_legend, written
from plough_opt.core.plain_data import MaybeInfinite
from plough_opt.core.saving import Origin, Saveable
from plough_opt.core.tables import Grid, Page, Part, data_frame

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


AUTO: Final = "auto"
"""Name of the default, which chooses its method and checks the result."""

COMPILED: Final = "auto, compiled"
"""Name of the default in machine code."""

BARE: Final = "dop853, compiled"
"""Name of steps of order 8 in machine code, without a check."""

MACHINE_CODE: Final = "machine code"
"""Family of compiled contestants."""

SEARCH: Final = "search"
"""Family of the searches for the optimum of a design."""

# Names of the references, which are keys of saved studies. Readers see "periodic" in place of "lasting".
MOTION = "motion"
LASTING = "lasting orbit"
DERIVATIVES = "gradient"
OPTIMUM = "optimum"
VARIABLES = "optimum, variables"


# Times that differ by less than this factor are called about equal.
_NOISE = 1.15
# Times that differ by less than this factor are equal within the noise of repetitions.
_EQUAL_TIMES: Final = 1.1
# An error counts as smaller only below this part of another.
_SMALLER: Final = 0.9


@dataclass(frozen=True)
class MethodResult:
    """Result of one method with one setting.

    Attributes:
        family: kind of choice, such as ``"integrator"`` or ``"search"``.
        method: name of the method.
        setting: setting as text, such as ``"tolerance 1e-08"`` or ``"40 steps"``.
        seconds: processor time of one use after a warm-up [s], the least of several; infinite for a failure.
        setup: time to build the method once, with that of a compiler [s].
        errors: relative errors by name [-]; empty for a failure.
        failure: reason why there is no result, or None.
        checked: time of `simulate` with this method, which checks the result [s]; None if not measured.
    """

    family: str
    method: str
    setting: str
    seconds: MaybeInfinite
    setup: float = 0.0
    errors: Mapping[str, MaybeInfinite] = field(default_factory=dict)
    failure: str | None = None
    checked: float | None = None

    @property
    def label(self) -> str:
        """Method and setting."""
        return f"{self.method}, {self.setting}" if self.setting else self.method

    def reaches(self, error: str, wanted: float) -> bool:
        """Return whether there is a result whose error of a name is at most a wanted one [-]."""
        return self.failure is None and self.errors.get(error, math.inf) <= wanted


@dataclass(frozen=True)
class Question:
    """Error by which contestants are ranked.

    Attributes:
        title: what is computed.
        error: key of `MethodResult.errors`.
        families: families of the entries that take part.
        reference: name of the reference, a key of `AccuracyStudy.floors`.
        columns: key of `MethodResult.errors` -> heading, for each column of the table.
        ranked: description of the error, if it is not one of the columns.
        default: default method and setting.
    """

    title: str
    error: str
    families: tuple[str, ...]
    reference: str
    columns: Mapping[str, str]
    ranked: str = ""
    default: tuple[str, str] = ("", "")


@dataclass(frozen=True)
class Thoroughness:
    """Success and time of one effort of a search.

    Attributes:
        search: effort as an argument of `plough_opt.Design.solve`.
        designs: median number of designs tried.
        asked: number of searches, each with a different seed.
        right: number of them that found the best optimum that any search of the study found.
        seconds: median time of a search [s].
    """

    search: str
    designs: int
    asked: int
    right: int
    seconds: float


@dataclass(frozen=True, repr=False, eq=False)
class AccuracyStudy(Saveable):
    """Error against time of every method that can simulate a scene, or of searches for the optimum of a design.

    Times depend on the machine and its load; their ratios are more reliable.

    Attributes:
        title: title of the scene or design.
        duration: simulated time [s]; None for a design.
        wanted: relative error that the advice is for [-].
        entries: entry of every contestant and setting; failures with their reasons.
        floors: name of a reference -> estimate of its own relative error [-]. "motion" and "lasting orbit" are those of
            the averages, "motion, trajectory" and "lasting orbit, trajectory" those of the mount forces; "optimum" is
            that of the objective, and "optimum, variables" that of the variables.
        notes: sentences on what has no reference.
        defaults: name of a reference -> default method and setting.
        versions: versions of packages, and the machine.
        thoroughness: for a design, success and time of each effort of a search.
        origin: the question that the study answers.

    Example:
        >>> import plough_opt as po
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s")
        >>> study = po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01, derivatives=False)
        >>> len(study.entries) > 3
        True
    """

    title: str
    duration: float | None
    wanted: float
    entries: tuple[MethodResult, ...]
    floors: Mapping[str, float]
    notes: tuple[str, ...] = ()
    defaults: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    thoroughness: tuple[Thoroughness, ...] = ()
    origin: Origin = field(default=Origin())
    kind = "accuracy study"

    @property
    def questions(self) -> tuple[Question, ...]:
        """Errors by which methods are ranked, those that have entries and a reference."""
        every = (replace(question, default=self.defaults.get(question.reference, ("", ""))) for question in _QUESTIONS)
        return tuple(question for question in every if question.reference in self.floors and self.of(question))

    def of(self, question: Question) -> list[MethodResult]:
        """Return the entries ranked by an error.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> study = po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01, derivatives=False)
            >>> entries = study.of(study.questions[0])
            >>> all(entry.failure is None for entry in entries)
            True
        """
        return [e for e in self.entries if e.family in question.families and question.error in e.errors]

    @property
    def failures(self) -> list[MethodResult]:
        """Entries without a result."""
        return [entry for entry in self.entries if entry.failure is not None]

    @property
    def refusals(self) -> tuple[str, ...]:
        """Sentence for each reason why entries have no result."""
        labels: dict[str, list[str]] = {}
        for entry in self.failures:
            labels.setdefault(str(entry.failure), []).append(entry.label)
        return tuple(f"no result of {'; '.join(who)}: {reason}" for reason, who in labels.items())

    def front(self, question: Question) -> list[MethodResult]:
        """Return the entries that no other beats in both time and error; errors below the reference's own are equal.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> study = po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01, derivatives=False)
            >>> 0 < len(study.front(study.questions[0])) <= len(study.of(study.questions[0]))
            True
        """
        return efficient(self.of(question), question.error, self.floors[question.reference])

    def advise(self, question: Question) -> str:
        """Return a sentence on what to choose for the wanted error, and how the default compares.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> study = po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01, derivatives=False)
            >>> study.advise(study.questions[0]) == study.advice.splitlines()[0]
            True
        """
        entries, key, wanted = self.of(question), question.error, error_text(self.wanted)
        best = cheapest(entries, key, self.wanted)
        if best is None:
            near = min(entries, key=lambda entry: entry.errors[key])
            found = f"{near.label} with {near.errors[key]:.0e} in {duration_text(near.seconds)}"
            clauses = [f"nothing tried reaches {wanted}; the nearest is {found}"]
        else:
            # "auto" integrates twice by methods that stand here once. It is compared separately below.
            twice = () if best.checked is None else (AUTO, COMPILED)
            others = [entry for entry in entries if entry.method not in (best.method, *twice)]
            second = cheapest(others, key, self.wanted)
            than = ", the only method that reaches it" if others else ""
            if second is not None:
                times = _times(second.seconds / best.seconds)
                cheaper = f"{times}cheaper than" if times else "about as cheap as"
                than = f", {cheaper} {second.label}"
            clauses = [f"for {wanted} take {best.label}: {_result(best, key)}{than}"]
            if best.checked is not None:
                clauses.append(f"{duration_text(best.checked)} with the check of simulate")
        by_setting = {(entry.method, entry.setting): entry for entry in entries}
        aim = f"error {wanted}"
        names = {(AUTO, aim): f"Accuracy(error={wanted})", (COMPILED, aim): f"Accuracy(error={wanted}), compiled=True"}
        for setting, name in (names | {question.default: "the default"}).items():
            if (entry := by_setting.get(setting)) is not None:
                which = f"the default, {entry.label}," if setting == question.default else name
                takes = f"{which} takes {_compared(entry, best, question)}"
                clauses.append(f"that is {name}" if entry is best else takes)
        return f"{question.title}: {'; '.join(clauses)}."

    @property
    def advice(self) -> str:
        """Sentence of advice for each question."""
        return "\n".join(self.advise(question) for question in self.questions)

    def page(self) -> Page:
        """Return a report: a table for each question, entries without a result, notes and advice.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> study = po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01, derivatives=False)
            >>> len(study.page().parts) >= len(study.questions)
            True
        """
        timed = "medians over the seeds, errors the largest of any seed"
        if self.duration is not None:
            timed = "the least of several: a named method integrates once, auto is all of simulate with its check"
        parts: list[Part] = [self.table(question) for question in self.questions]
        parts += [f"Times are {timed}. Set-up is done once."] if parts else []
        if self.thoroughness:
            efforts = Grid.of("What thoroughness costs", "search", "designs tried", "found the best", "median time")
            for row in self.thoroughness:
                efforts.row(row.search, str(row.designs), f"{row.right} of {row.asked}", f"{row.seconds:.2f} s")
            parts += [efforts, "The best is the best design that any of these searches found."]
        parts += [*self.refusals, *(f"note: {note}" for note in self.notes)]
        parts += [self.advise(question) for question in self.questions]
        heading = f"Error against time of {len(self.entries)} contestants, for a wanted error of {self.wanted:.0e}"
        return Page(heading, tuple(parts), (), ", ".join(map(" ".join, self.versions.items())), self.title)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each entry: times [s] and relative errors [-], NaN where there is none.

        Raises:
            InputError: pandas is not installed.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> study = po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01, derivatives=False)
            >>> len(study.to_dataframe()) == len(study.entries)
            True
        """
        names = ("family", "method", "setting", "seconds", "setup", "failure")
        columns: dict[str, Any] = {name: [getattr(entry, name) for entry in self.entries] for name in names}
        errors = dict.fromkeys(key for entry in self.entries for key in entry.errors)
        for key in errors:
            heading = f"error of {key.replace('lasting', 'periodic')}"
            columns[heading] = [entry.errors.get(key, math.nan) for entry in self.entries]
        return data_frame(columns, {name: "s" if name in ("seconds", "setup") else "" for name in columns})

    def table(self, question: Question) -> Grid:
        """Return a table of a question's entries, fastest first, efficient ones marked; it fits 80 characters.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> study = po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01, derivatives=False)
            >>> len(study.table(study.questions[0]).rows) == len(study.of(study.questions[0]))
            True
        """
        reference = f"reference: {self.floors[question.reference]:.0e}"
        for name, floor in self.floors.items():
            if name.startswith(f"{question.reference}, "):
                reference += f", its {name.removeprefix(f'{question.reference}, ')} {floor:.0e}"
        headings = (text if "\n" in text else f"\n{text}" for text in ("time", "set-up", *question.columns.values()))
        table = Grid.of(f"{question.title}: relative error against time\n({reference})", "", "\nmethod and setting",
                        *headings, left=("\nmethod and setting",))  # fmt: skip
        table.caption = (
            f"* efficient: nothing else is both faster and more exact in {question.ranked or question.error}"
        )
        table.plain = True
        front = self.front(question)
        for entry in sorted(self.of(question), key=lambda entry: entry.seconds):
            default = " (default)" if (entry.method, entry.setting) == question.default else ""
            setup = duration_text(float(f"{entry.setup:.2g}")) if entry.setup > 0.0 else ""
            errors = (f"{entry.errors[key]:.0e}".replace("0e+00", "0") if key in entry.errors else ""
                      for key in question.columns)  # fmt: skip
            mark = "*" if entry in front else ""
            table.row(mark, f"{entry.label}{default}", duration_text(entry.seconds), setup, *errors)
        return table

    def plot(self, target: Axes | str | Path | None = None) -> Figure:
        """Draw error against time.

        Args:
            target: file to write (.png, .svg, .pdf), axes for the first question alone, or None.

        Raises:
            InputError: no entry has an error, or the file has no known picture format or cannot be written.

        Example:
            >>> import plough_opt as po
            >>> scene = po.read_problem("problems/cotton_subsoiler.toml").scene()
            >>> study = po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01, derivatives=False)
            >>> len(study.plot().axes) >= len(study.questions)
            True
        """
        from matplotlib.axes import Axes

        if not self.questions:
            why = "; ".join((*self.notes, *self.refusals)) or "it has no entries"
            raise InputError(f"the accuracy study of {self.title!r} has no error to draw: {why}")
        if not isinstance(target, Axes):
            return written(_figure_of(self), target)
        draw(target, self, self.questions[0])
        return cast("Figure", target.get_figure(root=True))

    def also_saved(self) -> dict[str, Any]:
        """Return the advice."""
        return {"advice": self.advice}


_FORCES = {"mean draft": "mean\ndraft", "RMS": "RMS", "last force": "last\nforce", "trajectory": "trajec-\ntory"}
_LARGER = "the larger of mean draft and RMS"
_QUESTIONS = (
    Question("averages of the motion", "averages", ("integrator", "model"), MOTION, _FORCES, _LARGER),
    Question("averages of the motion, in machine code", "averages", (MACHINE_CODE,), MOTION, _FORCES, _LARGER),
    Question("averages of the periodic orbit", "lasting averages", ("integrator", "model"), LASTING,
             {f"lasting {key}": heading for key, heading in _FORCES.items()}, _LARGER),
    Question("gradients of the averages", "gradient", ("derivatives",), DERIVATIVES,
             {"gradient of mean draft": "of mean\ndraft", "gradient of RMS": "of\nRMS"}, _LARGER),
    Question("objective of the optimum", "objective", (SEARCH,), OPTIMUM, {"objective": "objective"}),
    Question("variables of the optimum", "variables", (SEARCH,), VARIABLES, {"variables": "variables"}),
)  # fmt: skip


def _times(ratio: float) -> str:
    """Return a ratio of times in words; empty near 1, because times are noisy."""
    if 1.0 / _NOISE < ratio < _NOISE:
        return ""
    return f"{ratio:.0f} times " if ratio >= 9.5 else f"{ratio:.1f} times "


def _result(entry: MethodResult, key: str) -> str:
    return f"{duration_text(entry.seconds)}, error {entry.errors[key]:.0e}"


def _compared(entry: MethodResult, best: MethodResult | None, question: Question) -> str:
    """Return time and error of an entry, and its time relative to the best entry, with the check of the latter."""
    checks = entry.method in (AUTO, COMPILED) and question.reference == MOTION
    text = _result(entry, question.error) + (", checked" if checks else "")
    if best is None:
        return text
    ratio = entry.seconds / (best.seconds if best.checked is None else best.checked)
    if not _times(ratio):
        return f"{text}, about as long"
    return f"{text}, {_times(ratio)}as long" if ratio > 1.0 else f"{text}, {_times(1.0 / ratio)}faster"


def efficient(entries: Sequence[MethodResult], error: str, floor: float = 0.0) -> list[MethodResult]:
    """Return the entries that no other beats in both time and one error, from the fastest to the most exact.

    A slower entry must have an error smaller by at least a tenth.

    Args:
        entries: entries of one contest; failures are left out.
        error: key of `MethodResult.errors`.
        floor: error of the reference itself [-], below which errors do not differ.
    """
    ranked = (entry for entry in entries if entry.failure is None and error in entry.errors)
    front: list[MethodResult] = []
    least = math.inf
    for entry in sorted(ranked, key=lambda entry: (entry.seconds, entry.errors[error])):
        wrong = max(entry.errors[error], floor)
        if wrong < _SMALLER * least:
            front.append(entry)
            least = wrong
    return front


def cheapest(entries: Sequence[MethodResult], error: str, wanted: float) -> MethodResult | None:
    """Return the fastest entry whose error is at most the wanted one [-], or None.

    Of each method only the coarsest such setting counts, because a finer one cannot be faster but by the noise of the
    clock. If several methods are equally fast within that noise, it is the first of them, so that the choice is
    repeatable.

    Args:
        entries: entries, those of a method from coarse to fine.
        error: key of `MethodResult.errors`.
        wanted: error to reach [-].
    """
    good: dict[tuple[str, str], MethodResult] = {}
    for entry in entries:
        if entry.reaches(error, wanted):
            good.setdefault((entry.family, entry.method), entry)
    least = min((entry.seconds for entry in good.values()), default=math.inf)
    return next((entry for entry in good.values() if entry.seconds <= _EQUAL_TIMES * least), None)


def duration_text(seconds: float) -> str:
    """Return a time with its unit."""
    # Rounding may make a thousandth a little less, which still is one of the larger unit.
    for least, unit in ((1.0, "s"), (1e-3, "ms")):
        if seconds >= 0.99 * least:
            return f"{seconds / least:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def error_text(error: float) -> str:
    """Return an error as text with the fewest digits, from 1 to 3, that give its value."""
    return min((f"{error:.{digits}e}" for digits in range(3)), key=lambda text: (float(text) != error, len(text)))


# --- the picture: a panel for each question, on logarithmic axes ---

# Methods that studies of a motion have, each with the same style in every picture.
_METHODS: Final = (
    AUTO, COMPILED, BARE, "dop853", "erk", "rosenbrock", "cvodes", "collocation", "idas", "rk", "quasi-static",
    "periodic orbit",
)  # fmt: skip
_FLOOR, _FRONT = "#DDDDDD", "#F0C808"
# Ratio of the times at the ends of an axis -> digits to number on an axis that spans less.
_DIGITS: Final = {6.0: (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0), 60.0: (1.0, 2.0, 5.0)}
# Smaller errors are drawn at this one, since 0 has no place on a logarithmic axis.
_LEAST: Final = 1e-19


def draw(axes: Axes, study: AccuracyStudy, question: Question) -> None:
    """Draw error against time of a question's entries, each method with a label for a legend."""
    entries, floor = study.of(question), study.floors[question.reference]

    def points(chosen: Sequence[MethodResult], least: float = _LEAST) -> tuple[list[float], list[float]]:
        return [e.seconds for e in chosen], [max(e.errors[question.error], least) for e in chosen]

    for number, method in enumerate(dict.fromkeys(entry.method for entry in entries)):
        chosen = sorted((e for e in entries if e.method == method), key=lambda e: -e.errors[question.error])
        style = line_style(_METHODS.index(method) if method in _METHODS else len(_METHODS) + number)
        axes.plot(*points(chosen), linewidth=1.0, markersize=5.5, zorder=3, label=method, **style)
    axes.step(*points(study.front(question), max(floor, _LEAST)), where="post", color=_FRONT, linewidth=6.0, alpha=0.75,
              zorder=1, solid_capstyle="round", label="efficient front")  # fmt: skip
    default = [entry for entry in entries if (entry.method, entry.setting) == question.default]
    axes.plot(*points(default), "o", markersize=15, markerfacecolor="none", markeredgecolor="black",
              markeredgewidth=1.1, zorder=4, label="the default")  # fmt: skip
    _dress(axes, question.title, points(entries)[1], floor, study.wanted)


def _dress(axes: Axes, title: str, errors: Sequence[float], floor: float, wanted: float) -> None:
    """Set scales, limits and labels, and draw the reference's own error and the wanted error."""
    from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

    axes.set(xscale="log", yscale="log", title=title, xlabel="time of one use", ylabel="relative error")
    low = 10.0 ** math.floor(math.log10(min(floor, *errors)) - 0.7)
    high = 10.0 ** math.ceil(math.log10(max(wanted, *errors)) + 0.3)
    axes.set_ylim(low, high)
    axes.axhline(wanted, color="black", linestyle=(0, (4, 3)), linewidth=1.0, zorder=2, label="wanted error")
    axes.axhspan(_LEAST**2, floor, facecolor=_FLOOR, edgecolor="#999999", hatch="///", linewidth=0.0, zorder=0,
                 label="below the reference's own error")  # fmt: skip
    # Powers of ten alone would leave a short axis a single number.
    left, right = axes.get_xlim()
    digits = next((digits for ratio, digits in _DIGITS.items() if right < ratio * left), (1.0,))
    axes.xaxis.set_major_locator(LogLocator(subs=digits, numticks=8))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(EngFormatter(unit="s"))
    axes.yaxis.set_major_locator(LogLocator(numticks=8))
    axes.grid(alpha=0.25)


def _figure_of(study: AccuracyStudy) -> Figure:
    """Return a figure with a panel for each question, and a legend: below two panels, or else in its own panel."""
    questions = study.questions
    below = len(questions) == 2
    height = 4.7 if below else 4.1
    figure, panels = figure_with_panels(len(questions) if below else len(questions) + 1, 2, (5.4, height))
    for axes, question in zip(panels, questions, strict=False):
        draw(axes, study, question)
    if below:
        shared_legend(figure, panels, frameon=False, loc="outside lower center", ncols=4)
    else:
        panels[-1].set_axis_off()
        shared_legend(panels[-1], panels[:-1], frameon=False, loc="center", ncols=2)
    if study.title:
        figure.suptitle(study.title)
    return figure
