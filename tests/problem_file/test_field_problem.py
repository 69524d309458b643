"""problems/field.toml: from readings to the best share, beside what the readings were made of and closed forms."""

import math

import pytest
from helpers.problem_files import PROBLEMS
from helpers.scripts import imported

import plough_opt as po


@pytest.mark.parametrize("search", ["near", pytest.param("auto", marks=pytest.mark.slow)])
def test_its_best_share_is_the_one_by_hand(search):
    """Three limits decide three variables: front, slope of the cone, deflection; the draft follows from the reading."""
    best, run = po.read_problem(PROBLEMS / "field.toml").optimise(search=search)
    scene = run.scene
    base = 0.13 * math.sqrt(1.0 - scene.soil.density_ratio)  # radius of the base whose front is 13 cm wide
    reading = po.read_penetrometer(PROBLEMS / "insertions.csv", (0.25, 0.45)).mean
    assert scene.cone.half_angle == pytest.approx(po.deg(15), rel=1e-8)
    assert scene.cone.height * math.tan(po.deg(15)) == pytest.approx(base, rel=1e-8)
    # At 15 degrees the share is a larger penetrometer; what inertia adds is 0.05 %.
    assert scene.reaction.static == pytest.approx(reading * math.pi * base**2, rel=1e-7)
    assert best.variables["scene.stiffness"] == pytest.approx(run.mean_draft / 0.03, rel=1e-6)
    assert best.objective == pytest.approx(run.mean_draft / 1e4 + scene.stationary_force_rms / 1e3, rel=1e-8)
    # Strength varies slowly beside a mount of 90 rad/s: a few per cent more than what a rigid one passes on.
    rigid = scene.reaction.static * math.sqrt(scene.effects.random_strength.variance)
    assert 1.0 < scene.stationary_force_rms / rigid < 1.1


def test_the_record_tells_what_it_was_made_of():
    found = po.strength_waves(po.read_strength_record(PROBLEMS / "transect.csv"), 0.2)
    largest = found.found[0]
    with imported("make_field_data") as made:
        # Beside random strength the noise at the rows' wave number is that of its spectrum: three half widths.
        assert largest.wave.wavelength == pytest.approx(made.ROWS, abs=3.0 * largest.wavelength)
        assert largest.wave.amplitude == pytest.approx(made.ROW_AMPLITUDE, abs=3.0 * largest.amplitude)
        # Of some sixty independent lengths the variance scatters by a fifth, its root by a tenth.
        put_in = math.hypot(made.RMS, made.ROW_AMPLITUDE / math.sqrt(2.0))
        assert math.sqrt(found.variance) == pytest.approx(put_in, rel=0.25)
