"""Every argument of every public function, given wrongly: an error that says what is wrong, or an answer without NaN.

Warnings are errors in these tests, so that a warning is not an answer either.
"""

import random
import warnings

import matplotlib.pyplot as plt
import numpy as np
import pytest
from helpers.recipes import WRONG, recipes

import plough_opt as po

# Functions of the user's that would have to be called with what is wrong, and what is right though it looks wrong.
LEFT_OUT = {
    # Returns what holds no expression as it is.
    *(("Optimum()", "item", wrong) for wrong in WRONG),
    # Processes of its own, which tests of sweeps begin.
    ("sweep", "executor", "None"),
    # Whole numbers of more digits than Python writes, for a name or a number of samples.
    ("Output", "name", "vaster"),
    ("sweep", "samples", "vaster"),
    # An expression of SX beside a scene of MX.
    ("Batch", "duration", "SX"),
    # Expressions that take minutes to build: of SX the force's quadratures are written out.
    *(("elastic.cone_force", argument, "SX") for argument in ("speed", "section_factor")),
}


def cases():
    """Return all names of functions, arguments and wrong values, in a shuffled order that repeats."""
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
    """Return what is wrong with the answer to one case, or None."""
    function, arguments = recipes()[name]
    try:
        with warnings.catch_warnings():
            # Half a pascal of cohesion may be meant.
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
def test_wrong_arguments_are_told(count, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # where a sweep may put its store
    told = {case: said for case in cases()[:count] if (said := complaint(*case))}
    assert told == {}


def test_right_arguments_are_taken():
    missing = ("load", "read_measurements", "read_penetrometer", "read_strength_record", "Sweep.load")  # files
    elsewhere = ("trade_off", "calibrate", "sweep", "study_accuracy", "study_design", "uncertainty.verify")
    for name, (function, arguments) in recipes().items():
        if name in missing:
            with pytest.raises(po.InputError, match=r"there is no|cannot be read"):
                function(**arguments)
        elif name not in elsewhere:
            function(**arguments)


def test_every_public_name_has_a_recipe():
    """But for errors, and results that the package alone makes."""
    results = {
        "AccuracyStudy", "BatchResult", "Component", "Design", "DomainError", "Fit", "ImplausibleValue",
        "InfeasibleDesign", "InputError", "IntegrationError", "LocalOptimum", "NotConverged", "Optimum",
        "OwnResistance", "PloughError",
        "Problem", "RecordWaves", "Refinement", "ResistanceLaw", "Run", "ShareInSoil", "SoilReaction", "Sweep",
        "TradeOff", "crosscheck", "elastic", "expressions", "laws", "plastic", "plots", "soil_names", "uncertainty",
    }  # fmt: skip
    covered = {name.partition(".")[0].rstrip("[]()") for name in recipes()}
    assert set(po.__all__) - results <= covered
