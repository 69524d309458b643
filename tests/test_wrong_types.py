"""What is no number, or no number that a formula holds for, is refused by name and never computed with."""

import dataclasses
import pickle
from importlib.resources import files

import casadi as ca
import numpy as np
import pytest

import plough_opt as po
from plough_opt.expressions import exp, holds_several

SOIL = po.named_soil("serozem")
CONE = po.Cone(0.2, 0.25)
NODES = [(0.0, 0.0), (0.5, 0.05)]


def _denser(order=16):
    return SOIL.with_density_profile(lambda r, w: 1350.0 * (1.05 + 0.3 * exp(-((r / w) ** 2))), 0.15, order=order)


# --- arrays where a formula holds for one number ---

ARRAYS = {
    "angles": lambda n: po.resistance(po.Cone(np.linspace(0.1, 0.2, n), 0.25), _denser(), 2.0, 0.0),
    "heights": lambda n: po.added_mass(po.Cone(0.2, np.linspace(0.1, 0.2, n)), _denser()),
    "cohesions": lambda n: po.resistance_coefficients(
        CONE, dataclasses.replace(_denser(), cohesion=np.linspace(1e4, 2e4, n))
    ),
    "a column of symbols": lambda n: po.soil_reaction(po.Cone(ca.MX.sym("angle", n), 0.25), _denser()),
    "a column of numbers": lambda n: po.soil_reaction(po.Cone(ca.DM(np.linspace(0.1, 0.2, n)), 0.25), _denser()),
    "speeds of a wedge": lambda n: po.elastic.wedge_force(NODES, SOIL, np.linspace(1.0, 2.0, n)),
    "thicknesses": lambda n: po.elastic.wedge_force([(0.0, 0.0), (0.5, np.linspace(0.01, 0.05, n))], SOIL, 2.0),
    "speeds of a cone": lambda n: po.elastic.cone_force(NODES, SOIL, np.linspace(1.0, 2.0, n)),
    "section factors": lambda n: po.elastic.cone_force(NODES, SOIL, 2.0, section_factor=np.linspace(0.5, 1.0, n)),
    "speeds of the integrals": lambda n: po.elastic.fourier.wedge_stress(
        0.2, 0.1, lambda x: 0.1 * x, 0.5, SOIL, np.linspace(1.0, 2.0, n)
    ),
}


@pytest.mark.parametrize("call", ARRAYS.values(), ids=ARRAYS)
# As many as the quadratures have nodes, or cells: so many would be met element by element, and give numbers.
@pytest.mark.parametrize("count", [3, 7, 16])
def test_arrays_never_meet_the_nodes_of_a_quadrature(call, count):
    with pytest.raises(po.InputError, match="takes one number for each quantity and no arrays"):
        call(count)


def test_an_array_of_one_number_is_that_number():
    alone = po.resistance(po.Cone(np.array([0.2]), 0.25), _denser(), np.array([1.0, 2.0]), 0.0)
    assert alone == pytest.approx([po.resistance(CONE, _denser(), v, 0.0) for v in (1.0, 2.0)], rel=1e-15)


def test_several_values_are_found_wherever_they_are():
    assert holds_several((1.0, {"a": [ca.MX.sym("x", 2)]}))
    assert holds_several(dataclasses.replace(SOIL, cohesion=np.array([1.0, 2.0])))
    assert not holds_several((1.0, "text", None, [np.array(2.0), np.array([2.0]), ca.MX.sym("x")], CONE))


# --- numbers that are none ---


@pytest.mark.parametrize("value", [[0.2], (0.2,), [0.2, 0.3]])
def test_lists_are_no_numbers(value):
    with pytest.raises(po.DomainError, match=r"half angle = .* must be a number or a NumPy array of them, in rad"):
        po.Cone(value, 0.25)
    with pytest.raises(po.DomainError, match=r"speed = .* must be a number or a NumPy array"):
        po.resistance(CONE, SOIL, value, 0.0)


def test_places_in_the_elastic_medium_may_be_lists():
    places = po.elastic.fourier.wedge_stress([0.2, 0.3], [0.1, 0.1], lambda x: 0.1 * x, 0.5, SOIL, 2.0).yy
    assert places == pytest.approx(po.elastic.wedge_stress([0.2, 0.3], [0.1, 0.1], NODES, SOIL, 2.0).yy, rel=1e-12)


@pytest.mark.parametrize("kind", [np.int8, np.uint8, np.int16, np.uint16, np.float16])
def test_numbers_of_few_bytes_are_refused(kind):
    # A cone of 10 m would have a negative volume of bytes.
    with pytest.raises(po.DomainError, match=f"cone height is of type {np.dtype(kind)}, .* give it as float"):
        po.Cone(0.2, np.array([1, 10], dtype=kind))


@pytest.mark.parametrize("kind", [int, np.int32, np.int64, np.float32, float])
def test_other_whole_and_real_numbers_are_taken(kind):
    assert po.Cone(0.2, kind(2)).volume == pytest.approx(po.Cone(0.2, 2.0).volume, rel=1e-6)


@pytest.mark.parametrize("value", ["30 deg", None, [30.0], True, float("nan")])
def test_degrees_of_what_is_no_number(value):
    with pytest.raises(po.DomainError, match=r"angle = .* must be (a number|finite)"):
        po.deg(value)


@pytest.mark.parametrize("name", [None, 3, ["serozem"], {"name": "serozem"}])
def test_a_soil_is_named_by_text(name):
    with pytest.raises(po.InputError, match="no soil is named"):
        po.named_soil(name)


# --- other things in the place of a soil, a share, effects or a switch ---


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"soil": "serozem"}, r"scene's soil = 'serozem' must be a Soil, for instance named_soil"),
        ({"share": 0.3}, "scene's share = 0.3 must be a Wedge or a Cone"),
        ({"effects": {"damping": 400.0}}, "scene's effects = .* must be an Effects"),
        ({"effects": None}, "scene's effects = None must be an Effects"),
    ],
)
def test_a_scene_is_made_of_its_own_parts(change, words):
    parts = {"soil": SOIL, "share": CONE, "stiffness": 5e4, "mass": 25.0, "tow_speed": 2.0}
    with pytest.raises(po.InputError, match=words):
        po.Scene(**parts | change)


@pytest.mark.parametrize("name", ["motion", "inertial_drag", "added_mass", "ambient_pressure", "entry"])
@pytest.mark.parametrize("value", ["off", "no", 0, 1, None])
def test_a_switch_is_on_or_off(name, value):
    with pytest.raises(po.InputError, match=f"{name} = {value!r} must be True or False"):
        po.Effects(**{name: value})


@pytest.mark.parametrize("name", ["motion", "inertial_drag", "added_mass", "ambient_pressure", "entry"])
def test_a_switch_of_numpy_is_a_switch(name):
    effects = po.Effects(start="rest", **{name: np.True_})
    assert effects == po.Effects(start="rest", **{name: True})
    # Printed and written to files as what it is.
    assert type(getattr(effects, name)) is bool


@pytest.mark.parametrize("wave", [(0.3, 0.2), {"amplitude": 0.3, "wavelength": 0.2}, 0.3, po.StrengthWave])
def test_a_strength_wave_is_one(wave):
    with pytest.raises(po.InputError, match=r"strength_wave = .* must be None or a StrengthWave"):
        po.Effects(strength_wave=wave)


@pytest.mark.parametrize("call", [po.resistance_coefficients, po.soil_reaction, po.added_mass, po.loosened_radius])
def test_forces_are_those_of_a_cone_in_a_soil(call):
    with pytest.raises(po.InputError, match=r"must be a Cone: take its equivalent_cone\(\)"):
        call(po.Wedge(0.5, 0.2, 0.25), SOIL)
    with pytest.raises(po.InputError, match=r"the cone = 0\.3 must be a Cone$"):
        call(0.3, SOIL)
    with pytest.raises(po.InputError, match="the soil = 'serozem' must be a Soil, for instance named_soil"):
        call(CONE, "serozem")


@pytest.mark.parametrize("ramp", [np.array([0.0, 1.0]), np.array([0.0, 0.0])])
def test_several_ramps_ramp_if_one_does(ramp):
    assert po.Effects(tow_ramp=ramp).ramps == bool(ramp.any())


# --- what leaves the process, or the package ---


@pytest.mark.parametrize(
    "error",
    [
        po.InfeasibleDesign("no design", {"draft": 3.0}, ["upper bound"]),
        po.NotConverged("it stopped", "Restoration_Failed"),
        po.InputError("wrong"),
        po.DomainError("outside"),
        po.IntegrationError("failed"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_come_back_from_another_process(error):
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert vars(copy) == vars(error)


def test_the_message_of_an_error_is_a_sentence():
    assert str(po.InfeasibleDesign("no design", {"draft": 3.0}, [])) == "no design"
    assert str(po.NotConverged("it stopped", "Restoration_Failed")) == "it stopped"


def test_type_checkers_are_told_that_there_are_types():
    assert (files("plough_opt") / "py.typed").is_file()
