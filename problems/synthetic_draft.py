"""Write problems/synthetic_draft.csv: drafts computed by the model, with random errors; nothing was measured.

python problems/synthetic_draft.py
"""

import math
from pathlib import Path

import numpy as np

import plough_opt as po

FOLDER = Path(__file__).parent
TRUTH = {"soil.cohesion": 26e3, "soil.tool_friction": 0.42, "effects.rate_term": 0.03}
ERROR = 0.03
HEADER = """\
# SYNTHETIC: nothing here was measured. Made by: python problems/synthetic_draft.py
# The model's own drafts for a cohesion of 26 kPa, a tool friction of 0.42 and a rate term of 0.03 s^2/m^2 on the
# serozem of problems/calibration.toml, with independent normal errors of 3 %.
scene.tow_speed [km/h], share.wedge_angle [deg], mean_draft [kN], sigma [%]
"""


def main() -> None:
    """Write the file."""
    problem = po.read_problem(FOLDER / "calibration.toml")
    errors = np.random.default_rng(20).standard_normal(24)
    lines = []
    for number, (speed, angle) in enumerate((v, a) for a in (25, 35, 45, 55) for v in (3, 4.5, 6, 7.5, 9, 10.5)):
        values = {"scene.tow_speed": speed / 3.6, "share.wedge_angle": math.radians(angle)}
        draft = float(problem.scene(TRUTH | values).steady_resistance)
        lines.append(f"{speed}, {angle}, {draft * (1.0 + ERROR * errors[number]) / 1e3:.3f}, {100 * ERROR:g}\n")
    (FOLDER / "synthetic_draft.csv").write_text(HEADER + "".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
