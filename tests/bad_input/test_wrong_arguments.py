"""Wrong values for every argument of every public function: a clear error, or an answer without NaN.

A warning counts as a failure.
"""

import random
import warnings

import matplotlib.pyplot as plt
import numpy as np
import pytest
from helpers.recipes import WRONG, recipes

import plough_opt as po

# Cases that are valid although they look wrong, or that cannot be checked.
LEFT_OUT = {
    # Values without expressions are returned unchanged.
    *(("Optimum()", "item", wrong) for wrong in WRONG),
    # Starts processes; tested with sweeps.
    ("sweep", "executor", "None"),
    # Whole numbers with more digits than Python prints.
    ("sweep", "samples", "vaster"),
    # An SX expression with an MX scene.
    ("Batch", "duration", "SX"),
    # Takes minutes to build: SX expands the quadratures of the force.
    *(("elastic.cone_force", argument, "SX") for argument in ("speed", "section_factor")),
}


def cases():
    """Return all triples of function, argument and wrong value in a reproducible random order."""
    found = [
        (name, argument, wrong)
        for name, (_, arguments) in recipes().items()
        for argument in arguments
        for wrong in WRONG
        if (name, argument, wrong) not in LEFT_OUT
    ]
    random.Random(0).shuffle(found)
    return found


def complaint(name, argument, wrong):
    """Return the defect of the answer to one case, or None."""
    function, arguments = recipes()[name]
    try:
        with warnings.catch_warnings():
            # An implausible value may be intended.
            warnings.simplefilter("ignore", po.ImplausibleValue)
            answer = function(**arguments | {argument: WRONG[wrong]})
    except po.PloughError as error:
        text = str(error)
        printed = text.replace("\n", "").isprintable()
        return None if text and printed else f"message {text!r}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    finally:
        plt.close("all")
    if isinstance(answer, po.Sweep):
        answer.close()
    is_number = isinstance(answer, float | np.ndarray) and np.asarray(answer).dtype.kind == "f"
    return f"answer {answer}" if is_number and np.any(np.isnan(answer)) else None


@pytest.mark.parametrize("count", [300, pytest.param(None, marks=pytest.mark.slow)], ids=["some", "all"])
def test_wrong_arguments_are_refused(count, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a sweep may write its store here
    told = {case: said for case in cases()[:count] if (said := complaint(*case))}
    assert told == {}


def test_valid_arguments_are_accepted():
    missing = ("load", "read_measurements", "read_penetrometer", "read_strength_record", "Sweep.load")  # files
    elsewhere = ("trade_off", "calibrate", "sweep", "study_accuracy", "study_design", "uncertainty.verify")
    for name, (function, arguments) in recipes().items():
        if name in missing:
            with pytest.raises(po.InputError, match=r"there is no|cannot be read"):
                function(**arguments)
        elif name not in elsewhere:
            function(**arguments)


def test_every_public_name_has_a_recipe():
    """Errors, and results that only the package creates, need none."""
    results = {
        "AccuracyStudy", "BatchResult", "Component", "Design", "DomainError", "Fit", "ImplausibleValue",
        "InfeasibleDesign", "InputError", "IntegrationError", "LocalOptimum", "NotConverged", "Optimum",
        "OwnResistance", "PloughError", "Problem", "RecordWaves", "Refinement", "ResistanceLaw", "Run", "ShareInSoil",
        "SoilReaction", "Sweep", "TradeOff", "crosscheck", "elastic", "export", "expressions", "laws", "plastic",
        "plots", "soil_names", "uncertainty",
    }  # fmt: skip
    covered = {name.partition(".")[0].rstrip("[]()") for name in recipes()}
    assert set(po.__all__) - results <= covered
