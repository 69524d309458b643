"""Result of an accuracy study: entries, efficient fronts, advice in a sentence, tables, pictures and files."""

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

# Names of the references, which are keys of saved studies.
MOTION = "motion"
LASTING = "lasting orbit"
DERIVATIVES = "gradient"
PROFILE = "density profile"
COURSE = "quasi-static course"
CONTACT = "elastic contact"
OPTIMUM = "optimum"

# Times that differ by less than this factor are called about equal.
_NOISE = 1.15


@dataclass(frozen=True)
class Question:
    """Error by which contestants are ranked.

    Attributes:
        title: what is computed.
        error: key of `Entry.errors`.
        families: families of the entries that take part.
        reference: name of the reference, a key of `AccuracyStudy.floors`.
        columns: key of `Entry.errors` -> heading, for each column of the table.
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


@dataclass(frozen=True, repr=False)
class AccuracyStudy(Saveable):
    """Error against time of every method that can simulate a scene or solve a design.

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
    origin: Origin = field(default=Origin())
    kind = "accuracy study"

    @property
    def questions(self) -> tuple[Question, ...]:
        """Errors by which methods are ranked, those that have entries and a reference."""
        found = (replace(question, default=self.defaults.get(question.reference, ("", ""))) for question in _QUESTIONS)
        return tuple(question for question in found if question.reference in self.floors and self.of(question))

    def of(self, question: Question) -> list[Entry]:
        """Return the entries ranked by an error, without those that ended in another optimum than the reference."""
        return [entry for entry in self._listed(question) if not entry.elsewhere]

    def _listed(self, question: Question) -> list[Entry]:
        return [e for e in self.entries if e.family in question.families and question.error in e.errors]

    @property
    def failures(self) -> list[Entry]:
        """Entries without a result."""
        return [entry for entry in self.entries if entry.failure is not None]

    @property
    def refusals(self) -> tuple[str, ...]:
        """Sentence for each reason why entries have no result, or are not ranked."""
        labels: dict[str, list[str]] = {}
        for entry in self.entries:
            if entry.failure is not None:
                labels.setdefault(f"no result of {{}}: {entry.failure}", []).append(entry.label)
            elif entry.elsewhere:
                labels.setdefault(f"not ranked, {{}}: {entry.elsewhere}", []).append(entry.label)
        return tuple(sentence.replace("{}", "; ".join(who), 1) for sentence, who in labels.items())

    def front(self, question: Question) -> list[Entry]:
        """Return the entries that no other beats in both time and error; errors below the reference's own are equal."""
        return efficient(self.of(question), question.error, self.floors[question.reference])

    def advise(self, question: Question) -> str:
        """Return a sentence on what to choose for the wanted error, and how the default compares."""
        entries, key, wanted = self.of(question), question.error, error_text(self.wanted)
        best = cheapest(entries, key, self.wanted)
        if best is None:
            nearest = min(entries, key=lambda entry: entry.errors[key])
            clauses = [
                f"nothing tried reaches {wanted}; the nearest is {nearest.label} with {nearest.errors[key]:.0e}"
                f" in {duration_text(nearest.seconds)}"
            ]
        else:
            # "auto" integrates twice by methods that stand here once. It is compared separately below.
            twice = () if best.checked is None else (AUTO, COMPILED)
            others = [entry for entry in entries if entry.method not in (best.method, *twice)]
            second = cheapest(others, key, self.wanted)
            than = ", the only method that reaches it" if others else ""
            if second is not None:
                than = f", {_cheaper(second.seconds / best.seconds)} {second.label}"
            clauses = [f"for {wanted} take {best.label}: {_result(best, key)}{than}"]
            if best.checked is not None:
                clauses.append(f"{duration_text(best.checked)} with the check of simulate")
        found = {(entry.method, entry.setting): entry for entry in entries}
        default = found.get(question.default)
        for method, compiled in ((AUTO, ""), (COMPILED, ", compiled=True")):
            aimed, name = found.get((method, f"error {wanted}")), f"Accuracy(error={wanted}){compiled}"
            if aimed is not None and aimed is not default:
                takes = f"{name} takes {_compared(aimed, best, question)}"
                clauses.append(f"that is {name}" if aimed is best else takes)
        if default is not None:
            takes = f"the default, {default.label}, takes {_compared(default, best, question)}"
            clauses.append("that is the default" if default is best else takes)
        return f"{question.title}: {'; '.join(clauses)}."

    @property
    def advice(self) -> str:
        """Sentence of advice for each question."""
        return "\n".join(self.advise(question) for question in self.questions)

    def page(self) -> Page:
        """Return a report: a table for each question, entries without a result, notes and advice."""
        timed = "one local solve; ≠ ended in another optimum"
        if self.duration is not None:
            timed = "a named method integrates once, auto is all of simulate with its check"
        parts: list[Part] = [self.table(question) for question in self.questions]
        parts.append(f"Times are the least of several: {timed}. Set-up is done once.")
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
        """
        names = ("family", "method", "setting", "seconds", "setup", "failure")
        columns: dict[str, Any] = {name: [getattr(entry, name) for entry in self.entries] for name in names}
        errors = dict.fromkeys(key for entry in self.entries for key in entry.errors)
        columns |= {f"error of {key}": [entry.errors.get(key, math.nan) for entry in self.entries] for key in errors}
        return data_frame(columns, {name: "s" if name in ("seconds", "setup") else "" for name in columns})

    def table(self, question: Question) -> Grid:
        """Return a table of a question's entries, fastest first, efficient ones marked; it fits 80 characters."""
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
        """Draw error against time.

        Args:
            target: file to write (.png, .svg, .pdf), axes for the first question alone, or None.

        Raises:
            InputError: the file has no known picture format, or cannot be written.
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
        """Return the contents of a question's panel in a picture."""
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
_VALUE = "the reported value; the true one comes from a tight integration"
_LARGER = "the larger of mean draft and RMS"
_QUESTIONS = (
    Question("averages of the motion", "averages", ("integrator", "model"), MOTION, _FORCES, _LARGER),
    Question("averages of the motion, in machine code", "averages", (MACHINE_CODE,), MOTION, _FORCES, _LARGER),
    Question("averages of the periodic orbit", "lasting averages", ("integrator", "model"), LASTING,
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
    """Return a ratio of times in words; empty near 1, because times are noisy."""
    if 1.0 / _NOISE < ratio < _NOISE:
        return ""
    return f"{ratio:.0f} times " if ratio >= 9.5 else f"{ratio:.1f} times "


def _cheaper(ratio: float) -> str:
    return f"{_times(ratio)}cheaper than" if _times(ratio) else "about as cheap as"


def _result(entry: Entry, key: str) -> str:
    return f"{duration_text(entry.seconds)}, error {entry.errors[key]:.0e}"


def _compared(entry: Entry, best: Entry | None, question: Question) -> str:
    """Return time and error of an entry, and its time relative to the best entry, with the check of the latter."""
    checks = entry.method in (AUTO, COMPILED) and question.reference == MOTION
    text = _result(entry, question.error) + (", checked" if checks else "")
    if best is None:
        return text
    ratio = entry.seconds / (best.seconds if best.checked is None else best.checked)
    if not _times(ratio):
        return f"{text}, about as long"
    return f"{text}, {_times(ratio)}as long" if ratio > 1.0 else f"{text}, {_times(1.0 / ratio)}faster"
