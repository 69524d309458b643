"""docs/calibration.md: its constants are those of the code."""

import re
from pathlib import Path

from plough_opt.studies.calibration.least_squares import CAUCHY, HUBER, SOFT_L1

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")


def test_constants_are_those_of_the_code():
    assert [float(c) for c in re.findall(r"\$c=([\d.]+)\$", TEXT)] == [HUBER, SOFT_L1, CAUCHY]
