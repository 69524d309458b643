"""The contest of all that can do a numeric scene, against references that take no part in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from plough_opt.core.errors import PloughError
from plough_opt.laws.elastic_medium import ElasticMedium
from plough_opt.laws.plastic_gas import PlasticGas
from plough_opt.studies.accuracy.contest import Entry
from plough_opt.studies.accuracy.gradients import reference_gradient
from plough_opt.studies.accuracy.methods import Task, gradients, in_machine_code, values, with_checks
from plough_opt.studies.accuracy.models import References, lasting_orbit, models
from plough_opt.studies.accuracy.quadratures import Quadratures, density_profile, elastic_contact, quasi_static_course
from plough_opt.studies.accuracy.reference import WIDER, Reference, reference_run

MOTION, LASTING, DERIVATIVES, PROFILE, COURSE, CONTACT = (
    "motion",
    "lasting orbit",
    "gradient",
    "density profile",
    "quasi-static course",
    "elastic contact",
)
"""Names of the references."""


@dataclass(frozen=True)
class Contest:
    """Entries of a scene, and what is known of their references.

    Attributes:
        entries: of all families; failures among them.
        floors: name of a reference -> its own estimated relative error [-]; of a motion that of its averages, and
            by the key "motion, trajectory" that of its mount forces.
        notes: sentences on what there is no reference of, and how far one can be trusted.
    """

    entries: tuple[Entry, ...]
    floors: dict[str, float]
    notes: tuple[str, ...]


Told = Callable[[str, float], None]
"""Called with what is being done, and with the part that is done."""


class _Hall:
    """Entries, references and notes as they come in."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self.floors: dict[str, float] = {}
        self.notes: list[str] = []

    def reference(self, name: str, find: Callable[[], Reference]) -> Reference | None:
        """Return a reference and note its error, or note why there is none."""
        try:
            found = find()
        except PloughError as error:
            self.notes.append(f"no reference of the {name}: {error}")
            return None
        self.floors |= {name: found.errors["averages"], f"{name}, trajectory": found.errors["trajectory"]}
        return found

    def quadrature(self, name: str, measure: Callable[[], Quadratures]) -> None:
        """Take over the entries of a quadrature, or note why there are none."""
        try:
            found = measure()
        except PloughError as error:
            self.notes.append(f"no reference of the {name}: {error}")
            return
        self.entries += found.entries
        self.floors[name] = found.reference


def contest(task: Task, *, derivatives: bool = True, told: Told | None = None) -> Contest:
    """Measure every contestant that can do a scene.

    Args:
        task: the scene, and how long.
        derivatives: whether derivatives take part.
        told: called as it goes on.
    """
    hall, told = _Hall(), told or (lambda _stage, _fraction: None)
    scene = task.scene
    if scene.effects.motion:
        told("following the reference", 0.0)
        _of_motion(hall, task, told)
        if derivatives:
            told("derivatives", 0.6)
            hall.entries += _derivatives(hall, task)
    elif isinstance(scene.law, ElasticMedium):
        hall.quadrature(CONTACT, partial(elastic_contact, task))
    else:
        hall.quadrature(COURSE, partial(quasi_static_course, task))
    if scene.soil.density_profile is not None and isinstance(scene.law, PlasticGas):
        told("quadratures", 0.9)
        hall.quadrature(PROFILE, partial(density_profile, task))
    if not WIDER and scene.effects.motion:
        hall.notes.append("this machine has no floats wider than a double: the references are no better than that")
    return Contest(tuple(hall.entries), hall.floors, tuple(hall.notes))


def _of_motion(hall: _Hall, task: Task, told: Told) -> None:
    """Measure integrators and models."""
    scene = task.scene
    around = lasting_orbit(scene)
    own = hall.reference(MOTION, partial(reference_run, scene, task.given, outputs=task.outputs))
    lasting = None
    if scene.effects.orbit == "transient" and around is not None:
        lasting = hall.reference(LASTING, partial(reference_run, around, outputs=task.outputs))
    if own is not None:
        told("integrators", 0.1)
        for found in (values(task, own), in_machine_code(task, own)):
            hall.entries += with_checks(task, found, own.errors["averages"])
    if own is not None or lasting is not None:
        told("models", 0.5)
        hall.entries += models(task, References(own, lasting))


def _derivatives(hall: _Hall, task: Task) -> list[Entry]:
    """Return derivatives of the averages."""
    try:
        reference = reference_gradient(task.scene, task.given)
    except PloughError as error:
        hall.notes.append(f"no reference of the {DERIVATIVES}: {error}")
        return []
    hall.floors[DERIVATIVES] = reference.error
    return gradients(task, reference)
