"""Scenes of Python written as problem files: the file says the same scene, or the message names what it cannot say."""

from dataclasses import dataclass, replace

import pytest
from helpers.problem_files import SUBSOILER

import plough_opt as po
from plough_opt.core.errors import InputError
from plough_opt.problem_file.written import problem_of

SOIL = po.named_soil("serozem")
SHARE = po.Wedge("30 deg", "15 deg", "25 cm")
WAVE = po.StrengthWave(0.3, "20 cm")


def scene(**changes):
    given = {"soil": SOIL, "share": SHARE, "stiffness": 5e4, "mass": 30.0, "tow_speed": 2.0}
    return po.Scene(**given | changes)


def effects(**given):
    return scene(effects=po.Effects(**given))


SAID = {
    "a named soil": scene(),
    "its properties": scene(soil=replace(SOIL, cohesion=25e3, name="mine", source="a trench")),
    "every choice": effects(
        inertial_drag=False, added_mass=False, ambient_pressure=False, contact=po.Smooth(0.4), start="rest",
        strength_wave=(WAVE, po.StrengthWave(0.1, 0.5, 0.2)), tow_ramp=0.3, damping=400.0, rate_term=0.02,
    ),
    "events": effects(contact=po.StickSlip(1.2), entry=True, start="towed"),
    "an orbit": effects(strength_wave=WAVE, damping=400.0, orbit="periodic"),
    "harmonics": effects(strength_wave=WAVE, damping=400.0, orbit=po.HarmonicBalance(4)),
    "random strength": effects(random_strength=po.RandomStrength(0.2, 0.3), damping=400.0),
    "another law": scene(medium=po.laws.McKyesAli(depth=0.35)),
    "as printed": effects(formulation="printed"),
}  # fmt: skip


@pytest.mark.parametrize("what", SAID)
def test_a_file_says_the_same_scene(what):
    given = SAID[what]
    problem = problem_of(given, None if given.effects.orbit != "transient" else 1.5, 'a "title"')
    assert problem.title == 'a "title"'
    found = problem.scene()
    assert replace(found, soil=replace(found.soil, name=given.soil.name, source=given.soil.source)) == given


@dataclass(frozen=True)
class Weight:
    def force(self, _, speed):
        return 100.0 + 0.0 * speed

    def at_rest(self, _):
        return 100.0


UNSAID = {
    "a Cone": scene(share=po.Cone("10 deg", "25 cm")),
    "scene.soil.density_profile": scene(soil=SOIL.with_density_profile(lambda r: 1000.0 + r)),
    "Weight": effects(own=(Weight(),)),
}


@pytest.mark.parametrize("what", UNSAID)
def test_what_a_file_cannot_say_is_named(what):
    with pytest.raises(InputError, match=what):
        problem_of(UNSAID[what], 1.0, "")


def test_symbols_and_durations_are_refused(tmp_path):
    height = po.Design().variable("height", guess=0.25, lower=0.1, upper=0.5, unit="m")
    with pytest.raises(InputError, match="holds symbols"):
        po.explore(scene(share=po.Wedge(0.5, 0.3, height)), tmp_path / "page.html", duration=1.0)
    with pytest.raises(InputError, match="'duration' is missing"):
        po.explore(scene(), tmp_path / "page.html")
    with pytest.raises(InputError, match="only a scene needs a duration"):
        po.explore(SUBSOILER, tmp_path / "page.html", duration=1.0)
