"""Result of a study: entries, the efficient front, advice in a sentence, tables, pictures and files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plough_opt.core.saving import Origin, Saveable
from plough_opt.core.tables import Column, Grid, Page, Part, data_frame
from plough_opt.studies.accuracy.contest import Entry, cheapest, duration_text, efficient
from plough_opt.studies.accuracy.methods import AUTO, COMPILED, MACHINE_CODE, error_text
from plough_opt.studies.accuracy.optimum import REPORTED, REQUIREMENTS, TRUE, VARIABLES

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOTION, LASTING, DERIVATIVES, PROFILE, COURSE, CONTACT, OPTIMUM = (
    "motion",
    "lasting orbit",
    "gradient",
    "density profile",
    "quasi-static course",
    "elastic contact",
    "optimum",
)
"""Names of the references."""

# Ratio of times that says nothing.
_NOISE = 1.15


@dataclass(frozen=True)
class Question:
    """One error by which contestants are ranked.

    Attributes:
        title: what is computed.
        error: key of `Entry.errors`.
        families: of the entries that take part.
        reference: name of the reference, a key of `AccuracyStudy.floors`.
        columns: of a table: keys of `Entry.errors`, and what stands above them.
        ranked: what the error is, if it is none of the columns.
        default: method and setting that the toolkit takes by default.
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
    """Cost of a thorough search: how often one effort finds the best optimum of a design, against its time.

    Attributes:
        search: as `plough_opt.Design.solve` takes it.
        designs: tried, the median over the seeds.
        asked: how many searches with seeds of their own were made.
        right: how many of them came to the best that any search of the study found.
        seconds: median time of one [s].
    """

    search: str
    designs: int
    asked: int
    right: int
    seconds: float


@dataclass(frozen=True, repr=False)
class AccuracyStudy(Saveable):
    """Error against time of everything that can do a scene.

    Times are those of this machine at this hour: their ratios say more than they do.

    Attributes:
        title: of the scene.
        duration: simulated time [s]; None of a design.
        wanted: relative error that the advice is about [-].
        entries: every contestant with every setting; failures with the reason.
        floors: name of a reference -> its own estimated relative error [-]; of a motion that of its averages, and
            by the key "motion, trajectory" that of its mount forces, of an optimum that of the objective, and by
            "optimum, variables" that of the variables.
        notes: sentences on what has no reference.
        defaults: what is ranked, in the order of `questions`: method and setting that the toolkit takes by default.
        versions: of packages, and the machine.
        thoroughness: of a design, what each effort of a search finds, and in what time.
        origin: what made it.

    Example:
        >>> import plough_opt as po
        >>> still = po.Effects(motion=False)
        >>> share = po.Wedge("30 deg", "15 deg", "25 cm")
        >>> scene = po.Scene(po.named_soil("serozem"), share, "50 kN/m", "30 kg", "2 m/s", still)
        >>> study = po.study_accuracy(scene, "0.1 s", thin=True, allowance=0.01)
        >>> len(study.entries) > 3
        True
    """

    title: str
    duration: float | None
    wanted: float
    entries: tuple[Entry, ...]
    floors: Mapping[str, float]
    notes: tuple[str, ...] = ()
    defaults: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    thoroughness: tuple[Thoroughness, ...] = ()
    origin: Origin = field(default=Origin(), compare=False)
    kind = "accuracy study"

    @property
    def questions(self) -> tuple[Question, ...]:
        """The error by which the methods are ranked."""
        found = (replace(question, default=self.defaults.get(question.reference, ("", ""))) for question in _QUESTIONS)
        return tuple(question for question in found if question.reference in self.floors and self.of(question))

    def of(self, question: Question) -> list[Entry]:
        """Return the entries that answer a question: those of another optimum than the reference's do not."""
        return [entry for entry in self._listed(question) if not entry.elsewhere]

    def _listed(self, question: Question) -> list[Entry]:
        return [e for e in self.entries if e.family in question.families and question.error in e.errors]

    @property
    def failures(self) -> list[Entry]:
        """Contestants without a result."""
        return [entry for entry in self.entries if entry.failure is not None]

    @property
    def refusals(self) -> tuple[str, ...]:
        """A sentence for each reason for which contestants have no result, or are not ranked."""
        labels: dict[str, list[str]] = {}
        for entry in self.entries:
            if entry.failure is not None:
                labels.setdefault(f"no result of {{}}: {entry.failure}", []).append(entry.label)
            elif entry.elsewhere:
                labels.setdefault(f"not ranked, {{}}: {entry.elsewhere}", []).append(entry.label)
        return tuple(sentence.replace("{}", "; ".join(who), 1) for sentence, who in labels.items())

    def front(self, question: Question) -> list[Entry]:
        """Return the entries that no other beats in both time and error, the reference's own error counted as none."""
        return efficient(self.of(question), question.error, self.floors[question.reference])

    def advise(self, question: Question) -> str:
        """Return in a sentence what to take for the wanted error, and what the default does."""
        entries, key = self.of(question), question.error
        best = cheapest(entries, key, self.wanted)
        if best is None:
            nearest = min(entries, key=lambda entry: entry.errors[key])
            advice = (
                f"nothing tried reaches {error_text(self.wanted)}; nearest comes {nearest.label} with"
                f" {nearest.errors[key]:.0e} in {duration_text(nearest.seconds)}"
            )
        else:
            advice = f"for {error_text(self.wanted)} take {best.label}: {_result(best, key)}"
            # "auto" integrates twice by what stands here once, and is described below.
            twice = () if best.checked is None else (AUTO, COMPILED)
            others = [entry for entry in entries if entry.method not in (best.method, *twice)]
            second = cheapest(others, key, self.wanted)
            if second is not None:
                advice += f", {_cheaper(second.seconds / best.seconds)} {second.label}"
            elif others:
                advice += ", the only method that reaches it"
            if best.checked is not None:
                advice += f"; {duration_text(best.checked)} by simulate, which checks it"
        return f"{question.title}: {advice}{self._defaults_beside(question, best)}."

    def _defaults_beside(self, question: Question, best: Entry | None) -> str:
        """Return clauses on what `simulate` takes when it is given the wanted error, and when it is given nothing."""
        found = {(entry.method, entry.setting): entry for entry in self.of(question)}
        setting = f"error {error_text(self.wanted)}"
        aimed = found.get((AUTO, setting)) or found.get((COMPILED, setting))
        default = found.get(question.default)
        clauses = ""
        if aimed is not None and aimed is not default:
            name = f"Accuracy(error={error_text(self.wanted)})"
            name += ", compiled=True" if aimed.method == COMPILED else ""
            clauses += f"; that is {name}" if aimed is best else f"; {name} takes {_beside(aimed, best, question)}"
        if default is not None and default is best:
            return f"{clauses}; that is the default"
        if default is not None:
            clauses += f"; the default, {default.label}, takes {_beside(default, best, question)}"
        return clauses

    @property
    def advice(self) -> str:
        """A sentence for each question."""
        return "\n".join(self.advise(question) for question in self.questions)

    def page(self) -> Page:
        """Return a table for each question, what had no result and why, and the advice."""
        timed = "one local solve; ≠ ended in another optimum"
        if self.duration is not None:
            timed = "a named method integrates once, auto is all of simulate, which checks itself"
        parts: list[Part] = [self.table(question) for question in self.questions]
        parts.append(f"Times are medians after a warm-up: {timed}. Set-up is done once.")
        if self.thoroughness:
            efforts = Grid.of("What thoroughness costs", "search", "designs tried", "found the best", "time")
            for row in self.thoroughness:
                efforts.row(row.search, str(row.designs), f"{row.right} of {row.asked}", f"{row.seconds:.2f} s")
            parts += [efforts, "Found is the best design that any of these searches came to."]
        parts += [*self.refusals, *(f"note: {note}" for note in self.notes)]
        parts += [self.advise(question) for question in self.questions]
        heading = f"Error against time of {len(self.entries)} contestants, for a wanted error of {self.wanted:.0e}"
        return Page(heading, tuple(parts), (), ", ".join(map(" ".join, self.versions.items())), self.title)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a row for each contestant: times [s] and relative errors; NaN where it has none.

        Raises:
            InputError: pandas is not installed.
        """
        names = ("family", "method", "setting", "seconds", "setup", "failure")
        columns: dict[str, Any] = {name: [getattr(entry, name) for entry in self.entries] for name in names}
        errors = dict.fromkeys(key for entry in self.entries for key in entry.errors)
        columns |= {f"error of {key}": [entry.errors.get(key, math.nan) for entry in self.entries] for key in errors}
        return data_frame(columns, {name: "s" if name in ("seconds", "setup") else "" for name in columns})

    def table(self, question: Question) -> Grid:
        """Return the entries of a question from the fastest to the slowest, the efficient ones marked: 80 wide."""
        reference = f"reference: {self.floors[question.reference]:.0e}"
        for name, floor in self.floors.items():
            if name.startswith(f"{question.reference}, "):
                reference += f", its {name.removeprefix(f'{question.reference}, ')} {floor:.0e}"
        headings = ("time", "set-up", *question.columns.values())
        table = Grid(
            (
                Column(left=True),
                Column("\nmethod and setting", left=True),
                *(Column(heading if "\n" in heading else f"\n{heading}") for heading in headings),
            ),
            f"{question.title}: relative error against time\n({reference})",
            f"* efficient: nothing else is both faster and more exact in {question.ranked or question.error}",
            plain=True,
        )
        front = self.front(question)
        for entry in sorted(self._listed(question), key=lambda entry: entry.seconds):
            errors = (f"{entry.errors[key]:.0e}".replace("0e+00", "0") if key in entry.errors else ""
                      for key in question.columns)  # fmt: skip
            table.row(
                "≠" if entry.elsewhere else "*" if entry in front else "",
                entry.label + (" (default)" if (entry.method, entry.setting) == question.default else ""),
                duration_text(entry.seconds),
                duration_text(float(f"{entry.setup:.2g}")) if entry.setup > 0.0 else "",
                *errors,
            )
        return table

    def plot(self, target: Axes | str | Path | None = None) -> Figure:
        """Draw error against time: into axes (the first question), into a file, or into a new figure.

        Raises:
            InputError: a file of no known picture format, or one that cannot be written.
        """
        from matplotlib.axes import Axes
        from matplotlib.figure import Figure

        from plough_opt.core.files import save_figure
        from plough_opt.studies.accuracy.picture import draw, figure_of

        panels = [self.panel(question) for question in self.questions]
        if isinstance(target, Axes):
            draw(target, panels[0])
            whole = target.get_figure(root=True)
            assert isinstance(whole, Figure)  # axes that were removed from theirs have none
            return whole
        figure = figure_of(panels, self.title)
        if target is not None:
            save_figure(figure, target)
        return figure

    def panel(self, question: Question) -> Any:
        """Return what a picture of a question shows."""
        from plough_opt.studies.accuracy.picture import Panel

        return Panel(
            title=question.title,
            error=question.error,
            entries=self.of(question),
            front=self.front(question),
            floor=self.floors[question.reference],
            wanted=self.wanted,
            default=question.default,
        )

    def also_saved(self) -> dict[str, Any]:
        """Return the advice."""
        return {"advice": self.advice}


_FORCES = {"mean draft": "mean\ndraft", "RMS": "RMS", "last force": "last\nforce", "trajectory": "trajec-\ntory"}
_OF_OPTIMA = {REPORTED: "reported\nvalue", TRUE: "true\nvalue", VARIABLES: "varia-\nbles",
              REQUIREMENTS: "broken\nlimits"}  # fmt: skip
_VALUE = "the reported value; the true one is integrated tightly anew"
_LARGER = "the larger of mean draft and RMS"
_QUESTIONS = (
    Question("averages of the motion", "averages", ("integrator", "model"), MOTION, _FORCES, _LARGER),
    Question("averages of the motion, in machine code", "averages", (MACHINE_CODE,), MOTION, _FORCES, _LARGER),
    Question("averages of the lasting orbit", "lasting averages", ("integrator", "model"), LASTING,
             {f"lasting {key}": heading for key, heading in _FORCES.items()}, _LARGER),
    Question("gradients of the averages", "gradient", ("derivatives",), DERIVATIVES,
             {"gradient of mean draft": "of mean\ndraft", "gradient of RMS": "of\nRMS"}, _LARGER),
    Question("quasi-static averages", "averages", ("quadrature",), COURSE, _FORCES, _LARGER),
    Question("resistance by a density profile", "reaction", ("quadrature",), PROFILE,
             {"static resistance": "static\nresistance", "drag": "drag", "added mass": "added\nmass"},
             "the largest of these"),
    Question("elastic contact force", "contact force", ("quadrature",), CONTACT, {"contact force": "contact\nforce"},
             "that"),
    Question("optimum of the design", REPORTED, ("transcription", "integrator", "derivatives"), OPTIMUM, _OF_OPTIMA,
             _VALUE),
    Question("optimum of the design, in machine code", REPORTED, ("compiled",), OPTIMUM, _OF_OPTIMA, _VALUE),
)  # fmt: skip


def _times(ratio: float) -> str:
    """Return a ratio in words; times are too noisy for what is near one."""
    if 1.0 / _NOISE < ratio < _NOISE:
        return ""
    return f"{ratio:.0f} times " if ratio >= 9.5 else f"{ratio:.1f} times "


def _cheaper(ratio: float) -> str:
    return f"{_times(ratio)}cheaper than" if _times(ratio) else "about as cheap as"


def _result(entry: Entry, key: str) -> str:
    return f"{duration_text(entry.seconds)}, error {entry.errors[key]:.0e}"


def _beside(entry: Entry, best: Entry | None, question: Question) -> str:
    """Return what an entry takes, and how long that is beside the best, of a named integrator with its check."""
    checks = entry.method in (AUTO, COMPILED) and question.reference == MOTION
    text = _result(entry, question.error) + (", checked" if checks else "")
    if best is None:
        return text
    ratio = entry.seconds / (best.seconds if best.checked is None else best.checked)
    if not _times(ratio):
        return f"{text}, about as long"
    return f"{text}, {_times(ratio)}as long" if ratio > 1.0 else f"{text}, {_times(1.0 / ratio)}faster"
