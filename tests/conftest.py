"""Scenes that several test files share."""

import collections
import gc
import itertools
import math
import signal
from pathlib import Path

import casadi as ca
import pytest
from helpers.browser import chromium
from helpers.scenes import R1_SOIL

import plough_opt as po
from plough_opt.core import process as heartbeat

HERE = Path(__file__).parent


@pytest.fixture
def ctrl_c():
    """Give Ctrl-C its usual effect here and in processes started meanwhile, as at a terminal.

    A shell makes tests in the background ignore it.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session", autouse=True)
def no_lines_that_depend_on_time():
    """Suppress progress lines, which commands write only on a busy machine."""
    before, heartbeat.INTERVAL = heartbeat.INTERVAL, 3600.0
    yield
    heartbeat.INTERVAL = before


# Of the tests of these files, `make test` runs every third one, and `.ci/run` all.
LONG = """
    accuracy/test_accuracy_study accuracy/test_motion_reference bad_input/test_fuzz
    calibration/test_linear cli/test_cli cli/test_cli_outputs cli/test_cli_studies design/test_design_nlp
    design/test_global_search_study design/test_holes_in_laws design/test_independent_problems
    design/test_infeasible design/test_optimum design/test_over_tolerances design/test_results_are_values
    design/test_search design/test_sensitivity elastic/test_contact elastic/test_field export/test_c export/test_fmu
    export/test_javascript hard_cases/test_derivatives_at_the_ends hard_cases/test_hard_designs
    motion/test_combination_derivatives motion/test_estimates motion/test_integrators motion/test_many_orbits
    motion/test_orbit motion/test_resistance_laws motion/test_stick_slip motion/test_varying_tow_speed
    page/test_engine page/test_walks problem_file/test_catalogues report/test_report study/test_problem_sweep
    study/test_workers tradeoff/test_fronts tradeoff/test_surfaces uncertainty/test_known_optima test_batch
    test_batch_compiler test_batch_errors test_component test_files test_pages test_plastic_field test_results
    test_scripts test_strength_record test_validation
"""

# File or test -> n: by default only every n-th case of a parametrised test runs, and of 0 none; the slow tests run all.
ONE_OF = {
    "accuracy/test_design_study::test_the_reference_of_a_design_with_every_result_of_a_run": 0,
    "accuracy/test_motion_reference::test_a_gradient_through_events_is_that_of_the_run": 0,
    "accuracy/test_motion_reference::test_against_28_digits": 4,
    "accuracy/test_motion_reference::test_against_another_solver_averages_and_all": 3,
    "accuracy/test_motion_reference::test_an_orbit_returns_to_where_it_began_and_is_that_of_simulate": 2,
    "bad_input/test_fuzz::test_tables_of_readings": 0,
    "calibration/test_few_rows::test_any_small_table_gives_an_answer_or_an_input_error": 3,
    "calibration/test_few_rows::test_few_rows_give_an_answer_or_say_what_is_missing": 5,
    "calibration/test_few_rows::test_results_do_not_depend_on_the_order_of_rows_and_sets": 2,
    "calibration/test_linear::test_exact_drafts_without_sigma_give_the_truth": 3,
    "calibration/test_linear::test_intervals_hold_the_truth_as_often_as_they_say": 0,
    "calibration/test_linear::test_optimum_is_that_of_a_simplex_search": 3,
    "calibration/test_measurements::test_fitted_runs_are_checked_by_runs_with_an_error_estimate": 0,
    "cli/test_cli::test_an_impossible_requirement_is_no_solution_and_the_conflict_is_named": 0,
    "cli/test_cli_studies::test_a_design_instead_of_a_scene": 0,
    "cli/test_cli_studies::test_failures_are_reported": 0,
    "design/test_design_nlp::test_a_design_by_any_method_is_solved_to_the_same_optimum": 4,
    "design/test_design_nlp::test_methods_of_casadi_agree_with_order_8": 6,
    "design/test_design_solve::test_designs_in_threads_are_those_one_after_the_other": 0,
    "design/test_global_search_study::test_the_whole_front_is_found": 0,
    "design/test_holes_in_laws": 23,
    "design/test_independent_problems::test_a_local_optimum_no_worse_than_the_guess": 3,
    "design/test_independent_problems::test_the_basin_of_the_guess_or_of_the_nearest_feasible_design_is_kept": 3,
    "design/test_independent_problems::test_the_guess_decides_nothing": 0,
    "design/test_orbit_design::test_a_design_is_interpreted_without_a_compiler": 0,
    "design/test_orbit_design::test_a_limit_of_a_law_is_printed_if_it_is_near": 3,
    "design/test_orbit_design::test_a_profile_parameter_is_a_designs_variable": 0,
    "design/test_orbit_design::test_a_requirement_above_the_waves_speed_is_a_conflict": 3,
    "design/test_orbit_design::test_a_start_above_the_waves_speed_is_refused_by_the_limits_name": 3,
    "design/test_orbit_design::test_derivatives_of_the_program_are_those_of_differences": 3,
    "design/test_orbit_design::test_designs_without_an_orbit_are_skipped": 3,
    "design/test_orbit_design::test_fastest_design_stops_at_the_shear_waves_speed": 3,
    "design/test_orbit_design::test_optima_are_those_of_the_orbit_simulated_anew": 3,
    "design/test_orbit_design::test_the_optimum_is_the_same": 0,
    "design/test_orbit_design::test_the_soft_and_the_stiff_branch_of_brute_force_are_found": 3,
    "design/test_over_tolerances::test_the_lowest_of_many_basins_of_several_free_variables_is_found": 3,
    "design/test_over_tolerances::test_the_worst_over_a_linear_variable_is_found": 3,
    "design/test_search::test_few_steps_and_the_spread_over_tolerances_agree_with_exact_runs": 0,
    "design/test_search::test_ripples_over_a_small_feasible_region_are_searched_in_every_way": 0,
    "elastic/test_contact": 4,
    "elastic/test_field": 3,
    "elastic/test_reference::test_value_of_the_table": 3,
    "export/test_fmu::test_simulates_to_the_same_motion": 5,
    "hard_cases/test_derivatives_at_the_ends": 2,
    "hard_cases/test_extremes": 3,
    "hard_cases/test_extremes::test_a_sample_of_the_whole_domain": 0,
    "hard_cases/test_hard_designs": 3,
    "hard_cases/test_hard_designs::test_a_conflict_at_the_edge_of_the_tolerance_is_refused_or_within_it": 0,
    "hard_cases/test_hard_designs::test_a_feasible_set_of_almost_no_width": 6,
    "hard_cases/test_hard_designs::test_any_start_leads_to_the_optimum": 6,
    "hard_cases/test_hard_designs::test_variables_eighteen_orders_of_magnitude_apart": 1,
    "hard_cases/test_resonance": 3,
    "hard_cases/test_singular_designs": 2,
    "hard_cases/test_sticking_entry": 3,
    "motion/test_combination_derivatives": 6,
    "motion/test_effect_combinations": 2,
    "motion/test_estimates::test_a_looser_error_takes_no_more_steps": 3,
    "motion/test_integrators": 5,
    "motion/test_integrators::test_orders": 3,
    "motion/test_orbit::test_a_share_that_comes_to_the_orbit": 3,
    "motion/test_orbit::test_an_unstable_orbit_carries_a_warning": 5,
    "motion/test_orbit::test_error_estimate_is_the_difference_from_the_orbit": 3,
    "motion/test_orbit::test_harmonics_converge_exponentially_to_the_orbit": 3,
    "motion/test_orbit::test_linear_response_is_that_of_the_textbook": 3,
    "motion/test_orbit::test_no_balanced_harmonic_of_the_force_is_left_over": 3,
    "motion/test_orbit::test_orbit_and_multipliers_are_those_that_scipy_finds_by_shooting": 5,
    "motion/test_orbit::test_the_linear_response_to_a_slight_wave_is_the_orbit": 5,
    "motion/test_orbit::test_without_amplitude_the_share_slides_steadily": 5,
    "motion/test_simulate::test_linear_motion_from_rest": 5,
    "motion/test_special_motions::test_a_narrow_step_takes_far_fewer_equal_steps_than_would_resolve_its_slope": 3,
    "motion/test_special_motions::test_a_settled_share_has_the_steady_resistance": 3,
    "motion/test_special_motions::test_a_very_small_width_terminates_with_an_honest_error": 3,
    "motion/test_special_motions::test_an_independent_solver_agrees": 3,
    "motion/test_special_motions::test_overflow_names_the_repelling_spring": 3,
    "motion/test_special_motions::test_the_error_falls_with_the_width_where_no_gap_opens": 3,
    "motion/test_steps::test_a_symbolic_ramp_of_no_time_has_the_limit_of_short_ones": 2,
    "motion/test_steps::test_named_adaptive_methods_find_the_end_of_a_ramp": 2,
    "motion/test_steps::test_second_derivatives_through_events_are_those_of_a_gradient": 2,
    "motion/test_stick_slip": 3,
    "problem_file/test_penetrometer::test_it_is_a_measure_of_an_uncertain_soil": 0,
    "problem_file/test_penetrometer::test_of_a_least_value_the_smallest_samples_are_the_worst": 0,
    "report/test_report::test_the_page_prints_on_paper": 0,
    "study/test_problem_sweep::test_memory_does_not_grow_with_the_points": 0,
    "study/test_workers::test_a_cluster_that_loses_a_worker_midway_gives_the_same_bits": 0,
    "study/test_workers::test_a_point_that_kills_three_workers_is_undetermined_until_a_retry": 0,
    "test_batch": 3,
    "test_batch::test_designs_are_refused_as_a_single_scene_is": 1,
    "test_component::test_every_result_agrees_with_the_numeric_scene": 3,
    "test_core::test_ratio_and_its_two_derivatives_keep_their_digits": 3,
    "test_forces::test_forces_gradient_and_hessian_up_to_the_singularities": 4,
    "test_forces::test_independent_values": 4,
    "test_pages::test_its_code_runs": 2,
    "test_plastic_field::test_a_constant_profile_is_the_closed_form": 2,
    "test_plastic_field::test_derivatives_of_the_uniform_field": 3,
    "test_plastic_field::test_the_error_falls_exponentially_and_its_estimate_is_reliable": 2,
    "test_plastic_field::test_value_gradient_and_hessian": 3,
    "test_plastic_field::test_values_against_75_digits": 2,
    "test_scripts::test_the_script_writes_every_picture_and_the_table": 0,
    "tradeoff/test_following::test_fronts_of_several_parameters_share_a_build": 0,
    "tradeoff/test_fronts::test_positions_without_a_design_are_named": 0,
    "uncertainty/test_measures::test_bias_of_cvar_is_of_second_order": 2,
}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the cases that `ONE_OF` skips as slow, and tests of `LONG` files as thorough, before pytest selects."""
    seen = collections.Counter()
    tests, long = collections.defaultdict(dict), LONG.split()
    for item in items:
        if not isinstance(item, pytest.Function):
            continue
        file = item.path.relative_to(HERE).with_suffix("").as_posix()
        name = f"{file}::{item.originalname}"
        step = ONE_OF.get(name, ONE_OF.get(file, 1))
        if step == 0:
            item.add_marker(pytest.mark.slow)
        elif step > 1 and hasattr(item, "callspec") and item.get_closest_marker("slow") is None:
            if seen[name] % step:
                item.add_marker(pytest.mark.slow)
            seen[name] += 1
        if file in long and tests[file].setdefault(item.originalname, len(tests[file])) % 3:
            item.add_marker(pytest.mark.thorough)


# Modules and tests last to the end: the garbage collector would look through them again and again, a third of the time
# of the collection and a tenth of that of the tests.
gc.disable()


def pytest_collection_finish():
    gc.freeze()
    gc.enable()


@pytest.fixture
def no_compiler(monkeypatch, tmp_path):
    """Hide the C compilers."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)


@pytest.fixture
def batch_of(r1_scene):
    """Build a batch of the wedge angle, the height and the stiffness of a scene of problem R1."""

    def build(duration=1.0, error=1e-9, **effects):
        angle, height, k0 = inputs = [ca.MX.sym(name) for name in ("angle", "height", "k0")]
        return po.Batch(r1_scene(angle * (180.0 / math.pi), height, k0, **effects), duration, inputs, error=error)

    return build


# Argument of `plough_opt.Effects` -> its value without and with the effect, which is strong enough to matter.
EFFECTS = {
    "inertial_drag": (False, True), "rate_term": (None, 0.05), "strength_wave": (None, po.StrengthWave(0.3, 0.6)),
    "tow_ramp": (None, 0.137), "damping": (None, 250.0), "start": ("equilibrium", "rest"),
}  # fmt: skip


def _is_covering(drag, rate, wave, ramp, damper, rest):
    # Eight of the 64 combinations, which contain all four settings of any two flags.
    return ramp == (drag ^ rate) and damper == (drag ^ wave) and rest == (rate ^ wave)


# For a module: in its thread playwright keeps an event loop running, so that asyncio could start no other.
@pytest.fixture(scope="module")
def browser():
    """Return a headless Chromium."""
    with chromium() as started:
        yield started


@pytest.fixture(scope="session")
def r1_soil():
    return R1_SOIL


@pytest.fixture(scope="session")
def r1_scene(r1_soil):
    """Build a scene of problem R1: a steel share and 20 kg of frame at 2 m/s under a strength wave."""

    def build(wedge_angle_deg=25.0, height=0.25, stiffness=5e4, *, tow_speed=2.0, soil=r1_soil, **effects):
        share = po.Wedge(po.deg(wedge_angle_deg), po.deg(15.0), height)
        mass = 20.0 + share.equivalent_cone().solid_mass(7850.0)
        return po.Scene(soil, share, stiffness, mass, tow_speed, po.Effects(**effects))

    return build


@pytest.fixture(scope="session")
def r1_wave():
    return po.StrengthWave(amplitude=0.3, wavelength=0.6)


@pytest.fixture(
    params=[
        pytest.param(
            {name: EFFECTS[name][on] for name, on in zip(EFFECTS, flags, strict=True)},
            id="+".join(name for name, on in zip(EFFECTS, flags, strict=True) if on) or "none",
            marks=() if _is_covering(*flags) else pytest.mark.slow,
        )
        for flags in itertools.product((False, True), repeat=len(EFFECTS))
    ]
)
def effects(request):
    """Return the arguments of `plough_opt.Effects`: eight combinations that cover all pairs, and in slow tests all."""
    return request.param
