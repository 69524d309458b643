"""`plough-opt check FILE --against`: other draft models beside a file's scene."""

import pytest


def test_it_prints_drafts_assumptions_reasons_and_marks(cli, cotton):
    done = cli(
        "check", cotton, "--against", "--depth", "40 cm", "--width", "80 mm", "--rake", "45 deg", "--texture", "medium",
        "--speed", "3 km/h", "--speed", "2.5 m/s",
    )  # fmt: skip
    assert (done.status, done.err) == (0, "")
    lines = [line for line in done.out.splitlines() if line.startswith("│ ASABE")]
    # Worked by hand: 0.7 (226 + 1.8 S^2) 40 N at S = 3 and 9.
    assert len(lines) == 1
    assert "0.4 m" in lines[0]
    assert "6.78 (" in lines[0]
    assert "10.4 (" in lines[0]
    for words in ("Assumed", "Why they differ", "Not verified", "not verified against the standard's text"):
        assert words in done.out
    assert "Outside the domain" not in done.out


def test_without_options_it_says_what_it_estimated_of_which_design_and_what_it_cannot_do(cli, cotton):
    done = cli("check", cotton, "--against")
    assert done.status == 0
    assert "working depth 0.25 m: the share's height, because none was given" in done.out
    assert "Outside the domain" in done.out
    guess = "share.wedge_angle = 25 deg, share.height = 0.25 m, scene.stiffness = 50 kN/m"
    assert f"at the file's guess, {guess}; use --set" in done.out
    fixed = ("share.wedge_angle=39.1 deg", "share.height=0.254 m", "scene.stiffness=50.8 kN/m")
    assert "guess" not in cli("check", cotton, "--against", *(f"--set={text}" for text in fixed)).out
    assert "ASABE" not in cli("check", cotton).out


def test_the_picture(cli, cotton, tmp_path):
    done = cli("check", cotton, "--against", "--plot", tmp_path / "drafts.png")
    assert done.status == 0
    assert (tmp_path / "drafts.png").stat().st_size > 10_000
    assert "wrote" in done.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--depth", "0.4 m"), "--depth belongs to a comparison: add --against"),
        (("--against", "--depth", "0.4"), '--depth = "0.4" has no unit: write it like "0.3 m"'),
        (("--against", "--width", "-8 cm"), "tool width = -0.08 m must be above 0 m"),
        (("--against", "--texture", "fin"), "did you mean 'fine'?"),
        (("--against", "--rupture-ratio", "0.5"), "rupture distance ratio m = 0.5 must be at least 1"),
    ],
)
def test_wrong_input_is_refused_before_anything_is_printed(cli, cotton, arguments, words):
    done = cli("check", cotton, *arguments)
    assert (done.status, done.out) == (2, "")
    assert words in done.err
