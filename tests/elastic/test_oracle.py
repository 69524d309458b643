"""The precise numbers are themselves judged: Fourier integrals and closed forms agree."""

import pytest
from helpers import high_precision as hp
from helpers import oracle
from helpers.field_cases import slow

mp = hp.mp

OPEN = [(mp.mpf(0), mp.mpf(0)), (mp.mpf("0.2"), mp.mpf("0.03")), (mp.mpf("0.5"), mp.mpf("0.02"))]
CLOSED = [*OPEN, (mp.mpf("0.9"), mp.mpf(0))]
MEDIA = {"half speed": (4e7, 0.3, 1600.0, 60.0), "slow": (2e7, 0.0, 1300.0, 1e-3), "fast": (4e7, 0.45, 1600.0, 90.0)}
POINTS = {"beside": ("0.15", "0.2"), "ahead": ("-0.3", "0.1"), "behind": ("1.1", "0.3")}


def agree(found, wanted, relative):
    for f, w in zip(found, wanted, strict=True):
        assert abs(f - w) <= relative * max(map(abs, wanted)), f"{mp.nstr(f, 20)} instead of {mp.nstr(w, 20)}"


@pytest.mark.parametrize("medium", ["half speed", *slow(["slow", "fast"])])
def test_wedge_by_waves(medium):
    with mp.workdps(25):
        at = (mp.mpf("0.15"), mp.mpf("0.2"), OPEN, oracle.Medium(*MEDIA[medium]))
        # A slow medium costs 1/m = 1e10 of the digits.
        agree(oracle.wedge_gradient_by_waves(*at), oracle.wedge(*at)[4:8], 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("nodes", "point"), [(OPEN, "beside"), (CLOSED, "ahead")], ids=["open", "closed"])
def test_cone_by_waves(nodes, point):
    with mp.workdps(15):
        at = (*map(mp.mpf, POINTS[point]), nodes, oracle.Medium(*MEDIA["half speed"]))
        agree(oracle.cone_displacement_by_waves(*at), oracle.cone(*at)[:2], 1e-9)


def test_displacements_and_gradients_belong_together():
    x, y, h, medium = mp.mpf("0.15"), mp.mpf("0.2"), mp.mpf(10) ** -30, oracle.Medium(*MEDIA["half speed"])

    def slope(of, name, dx, dy):
        ahead, behind = of(x + dx, y + dy, OPEN, medium), of(x - dx, y - dy, OPEN, medium)
        return (getattr(ahead, name) - getattr(behind, name)) / (2 * h)

    at = oracle.wedge(x, y, OPEN, medium)
    agree([at.uy_x, at.uy_y], [slope(oracle.wedge, "uy", h, 0), slope(oracle.wedge, "uy", 0, h)], 1e-50)
    # The rotation's derivative couples the gradient's columns: d(ux_y)/dx = d(ux_x)/dy.
    agree([slope(oracle.wedge, "ux_y", h, 0)], [slope(oracle.wedge, "ux_x", 0, h)], 1e-50)

    at = oracle.cone(x, y, OPEN, medium)
    ux_x, ux_r = slope(oracle.cone, "axial", h, 0), slope(oracle.cone, "axial", 0, h)
    ur_x, ur_r = slope(oracle.cone, "radial", h, 0), slope(oracle.cone, "radial", 0, h)
    dilation = medium.lam * (ux_x + ur_r + at.radial / y)
    wanted = [dilation + 2 * medium.mu * ux_x, dilation + 2 * medium.mu * ur_r, medium.mu * (ux_r + ur_x)]
    agree([at.xx, at.rr, at.rx], wanted, 1e-50)


def test_wedge_pressure_is_the_stress_on_the_face():
    medium = oracle.Medium(*MEDIA["fast"])
    for x in (mp.mpf("0.1"), mp.mpf("0.35"), mp.mpf("0.7")):
        agree([-oracle.wedge(x, mp.mpf(0), CLOSED, medium).yy], [oracle.wedge_pressure(x, CLOSED, medium)], 1e-100)


def test_oracle_keeps_its_digits_in_a_slow_medium():
    """Halving the speed from 1e-15 of the shear wave's changes the field by m = 1e-30, not by rounding."""
    slow = [oracle.Medium(4e7, 0.3, 1600.0, V0) for V0 in (1e-13, 5e-14)]
    at = (mp.mpf("0.15"), mp.mpf("0.2"), OPEN)
    agree(*(oracle.wedge(*at, medium) for medium in slow), 1e-28)
    agree(*(oracle.cone(*at, medium) for medium in slow), 1e-28)
