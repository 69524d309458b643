"""Refusals of `calibrate`, and its three kinds of models."""

import dataclasses

import numpy as np
import pytest
from helpers.known_soil import steady_scene
from helpers.problem_files import PROBLEMS

import plough_opt as po
from plough_opt.studies.calibration import least_squares


def test_scene_problem_and_function_give_the_same(measured, three, fitted):
    def scene_of(values):
        soil = {name: values[f"soil.{name}"] for name in ("cohesion", "tool_friction")}
        return steady_scene(values["scene.tow_speed"], values["share.wedge_angle"], **soil)

    two = {name: three[name] for name in ("soil.cohesion", "soil.tool_friction")}
    from_function, from_scene = (po.calibrate(given, measured, two).values for given in (scene_of, steady_scene()))
    assert from_function == pytest.approx(from_scene, rel=1e-7)
    given = ["soil.ambient_pressure=60 kPa", "variables.soil.cohesion.guess=40 kPa"]
    problem = po.read_problem(PROBLEMS / "calibration.toml", given)
    from_file = po.calibrate(problem, measured)
    for name, value in from_file.values.items():
        # Bounds and guesses differ, the optimum does not: the search stops within 1e-4 of a standard error.
        assert abs(value - fitted.values[name]) < 1e-3 * fitted.standard_errors[name]
    with pytest.raises(po.InputError, match=r"a problem file has no 'scene\.mass': did you mean 'scene\.frame_mass'"):
        po.calibrate(problem, measured, {"scene.mass": (1.0, 100.0)})


REFUSED_UNKNOWNS = [
    ({"soil.cohesian": (1e3, 2e3)}, {}, "'soil.cohesian' cannot be an unknown: did you mean 'soil.cohesion'"),
    ({"soil.cohesion": (2e3, 1e3)}, {}, "the lower bound 2000 must be below the upper bound 1000"),
    ({"soil.cohesion": 5.0}, {}, "must be (lower, upper) or (lower, upper, guess)"),
    ({"soil.cohesion": (1e3, 2e3, 3e3)}, {}, "the guess 3000 must lie between"),
    ({"soil.cohesion": (1e3, float("inf"))}, {}, "upper bound of 'soil.cohesion' = inf Pa must be finite"),
    ({"scene.tow_speed": (1.0, 2.0)}, {}, "plane: 'scene.tow_speed' is a column of the data"),
    ({"soil.friction_angle": (0.1, 2.0)}, {}, "upper bound of 'soil.friction_angle': friction angle = 2 rad"),
    ({"scene.frame_mass": (1.0, 2.0)}, {}, "a scene has no quantity 'scene.frame_mass': did you mean 'scene.mass'"),
    ({"effects.strength_wave.amplitude": (0.0, 0.5)}, {}, "the scene has no 'effects.strength_wave.amplitude'"),
    ({}, {}, "no unknowns"),
    ({"soil.cohesion": (1e3, 80e3)}, {"loss": "huberr"}, "no loss is named 'huberr': did you mean 'huber'?"),
    ({"soil.cohesion": (1e3, 80e3)}, {"starts": 0}, "starts = 0 must be a whole number from 1 to 16"),
]


@pytest.mark.parametrize(("unknown", "keywords", "words"), REFUSED_UNKNOWNS)
def test_invalid_unknowns_and_options_are_refused(measured, unknown, keywords, words):
    with pytest.raises((po.InputError, po.DomainError)) as refusal:
        po.calibrate(steady_scene(), measured, unknown, **keywords)
    assert words in str(refusal.value)


SPEEDS = {"scene.tow_speed": [1.0, 2.0]}
FEW = po.Measurements("mean_draft", [1e3, 2e3], SPEEDS, name="few")
STATED = po.Measurements("mean_draft", [1e3, 2e3], SPEEDS, sigma=10.0)
ANGLES = po.Measurements("mean_draft", [1e3] * 3, {"share.wedge_angle": [0.5, 2.0, 0.6]}, name="beyond")
CONE = po.Scene(steady_scene().soil, po.Cone(0.3, 0.25), 5e4, 25.0, 2.0, po.Effects(motion=False))


REFUSED_DATA = [
    (steady_scene(), FEW, r"few: 2 rows are too few for 2 unknowns .* at least 3 are needed"),
    (steady_scene(), [STATED, FEW], "few: no sigma is stated"),
    (steady_scene(), ANGLES, "beyond, row 2: wedge angle = 2 rad must be below"),
    (steady_scene(), po.Measurements("soil.density_ratio", [0.8] * 3), "'soil.density_ratio' was measured"),
    (steady_scene(), po.Measurements("mean_draft", [0.0] * 3, name="zeros"), "zeros: every measured value is 0"),
    (steady_scene(), [[1.0, 2.0]], "the data must be Measurements"),
    (3.0, FEW, "must be a Problem, a Scene, or a function"),
    (len, FEW, "the function of values returned 3: it must return a Scene"),
    (steady_scene(po.Design().variable("v", guess=2.0, lower=1.0, upper=3.0)), FEW, "the scene holds symbols"),
    (CONE, ANGLES, "the scene has no 'share.wedge_angle'"),
]


@pytest.mark.parametrize(("scene", "data", "words"), REFUSED_DATA)
def test_data_that_do_not_fit_are_refused(scene, data, words):
    with pytest.raises(po.InputError, match=words):
        po.calibrate(scene, data, {"soil.cohesion": (1e3, 80e3), "soil.tool_friction": (0.1, 1.0)})


def test_a_calibration_fits_other_observed_values(measured, three, fitted):
    calibration = po.Calibration(steady_scene(), measured, three)
    assert calibration.fit(measured.values).values == fitted.values
    for wrong in ([1.0, 2.0], [np.nan] * 24):
        with pytest.raises(po.InputError, match="observed must be 24 finite numbers"):
            calibration.fit(wrong)


def test_invalid_levels_kinds_folds_and_candidates_are_refused(fitted):
    with pytest.raises(po.InputError, match="level = 95 must lie between 0 and 1"):
        fitted.intervals(95)
    with pytest.raises(po.InputError, match="must be 'profile' or 'linearised'"):
        fitted.intervals(kind="bootstrap")
    with pytest.raises(po.InputError, match="folds = 1 must be a whole number from 2 to 24"):
        fitted.cross_validation(1)
    with pytest.raises(po.InputError, match="none of the candidates"):
        fitted.next_measurements([po.Candidate("mount_force"), po.Candidate("soil.density")])


def test_a_fit_that_does_not_converge_is_refused(measured, three, fitted, monkeypatch):
    monkeypatch.setitem(least_squares._TOLERANCES, "max_nfev", 1)
    with pytest.raises(po.NotConverged, match="did not converge from any of 4 starts") as failure:
        po.calibrate(steady_scene(), measured, three)
    assert failure.value.status
    # A profile that does not converge gives way to the linearised interval.
    assert dataclasses.replace(fitted).intervals(0.9) == fitted.intervals(0.9, "linearised")
