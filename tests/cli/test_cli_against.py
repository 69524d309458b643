"""`plough-opt check FILE --against`: other draft models beside a file's scene."""

from helpers.commands import call, printed
from helpers.problem_files import SUBSOILER


def test_it_prints_drafts_assumptions_and_marks(tmp_path):
    done = call(
        "check", SUBSOILER, "--against", "--depth", "40 cm", "--width", "80 mm", "--rake", "45 deg", "--texture",
        "medium", "--speed", "3 km/h", "--speed", "2.5 m/s", "--plot", tmp_path / "drafts.png",
    )  # fmt: skip
    assert (done.status, done.err) == (0, f"wrote {tmp_path / 'drafts.png'}\n")
    assert (tmp_path / "drafts.png").stat().st_size > 10_000
    (line,) = [line for line in done.out.splitlines() if line.startswith("│ ASABE")]
    # Worked by hand: 0.7 (226 + 1.8 S^2) 40 N at S = 3 and 9.
    for words in ("0.4 m", "6.78 (", "10.4 ("):
        assert words in line
    for words in ("Assumed", "docs/crosscheck.md", "Not verified", "not verified against the standard's text"):
        assert words in done.out
    assert "Outside the domain" not in done.out


def test_without_options_it_says_what_it_estimated_of_which_design_and_what_it_cannot_do():
    out = printed("check", SUBSOILER, "--against")
    assert "working depth 0.25 m: the share's height, because none was given" in out
    assert "Outside the domain" in out
    guess = "share.wedge_angle = 25 deg, share.height = 0.25 m, scene.stiffness = 50 kN/m"
    assert f"at the file's guess, {guess}; use --set" in out
    fixed = ("--set=share.wedge_angle=39.1 deg", "--set=share.height=0.254 m", "--set=scene.stiffness=50.8 kN/m")
    assert "guess" not in printed("check", SUBSOILER, "--against", *fixed)
    assert "ASABE" not in printed("check", SUBSOILER)
