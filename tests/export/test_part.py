"""Shares as parts: in memory, and read back from every format by a library for it."""

import math

import ezdxf
import numpy as np
import pytest
import trimesh
from helpers.refusals import refusals
from hypothesis import given, settings
from hypothesis import strategies as st

import plough_opt as po
from plough_opt.export import write_part

SHARE = po.Wedge(po.deg(37), po.deg(15), 0.25)
CONE = SHARE.equivalent_cone()
OPENING, PLATE = po.deg(80), 0.01
BODIES = {"block": (SHARE, {}), "plate": (SHARE, {"opening": OPENING, "thickness": PLATE}), "cone": (CONE, {})}
# Coordinates are rounded to floats of 4 bytes, by 6e-8 of the largest.
SINGLE = 1e-7


def block_volume(share, opening):
    """A third of the ridge times the triangle across its end."""
    ridge = share.height / math.cos(share.chisel_angle)
    return ridge * (ridge * math.tan(share.angle)) ** 2 * math.sin(opening) / 6.0


def plate_volume(share, opening, thickness):
    """Both plates: the integral over the depth of triangles that the mitre cuts shorter."""
    slope = math.tan(share.angle)
    width, mitre = share.height / math.cos(share.chisel_angle) * slope, 1.0 / math.tan(opening / 2.0)
    return (width**3 - (width - mitre * thickness) ** 3) / (3.0 * mitre * slope)


def corner_angle(corners):
    """The angle at the first of three corners."""
    one, other = corners[1] - corners[0], corners[2] - corners[0]
    return math.acos(one @ other / np.linalg.norm(one) / np.linalg.norm(other))


def as_trimesh(body):
    return trimesh.Trimesh(body.vertices, body.triangles, process=False)


angles = st.floats(2.0, 85.0).map(math.radians)


@settings(deadline=None, derandomize=True, max_examples=60)
@given(angles, st.floats(0.0, 80.0).map(math.radians), st.floats(0.01, 2.0), angles, st.floats(0.01, 0.98))
def test_bodies_are_closed_and_have_the_models_faces(angle, chisel_angle, height, half_opening, part):
    share, opening = po.Wedge(angle, chisel_angle, height), 2.0 * half_opening
    width = height / math.cos(chisel_angle) * math.tan(angle)
    thickness = part * width * math.tan(half_opening)
    volumes = {None: block_volume(share, opening), thickness: plate_volume(share, opening, thickness)}
    for plate, volume in volumes.items():
        body = share.mesh(opening=opening, thickness=plate)
        mesh = as_trimesh(body)
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        # Thin slices of long bodies lose digits to cancellation, a thousandfold at most here.
        assert body.volume == pytest.approx(volume, rel=1e-9)
        assert body.working_area == pytest.approx(share.area, rel=1e-12)
        for polygon in body.polygons[:2]:
            corners = body.vertices[list(polygon)]
            tip = corners if polygon[1] == 1 else corners[[0, 2, 1]]
            assert corner_angle(tip) == pytest.approx(angle, abs=1e-9)
            assert tip[1, 0] == pytest.approx(height, rel=1e-12)
            assert math.atan2(tip[1, 2], tip[1, 0]) == pytest.approx(chisel_angle, abs=1e-12)
        normals = mesh.face_normals[:2]
        assert math.acos(np.clip(-normals[0] @ normals[1], -1.0, 1.0)) == pytest.approx(opening, abs=1e-6)


@pytest.mark.parametrize(("angle", "chisel_angle"), [(1.0, 15.0), (20.0, 45.0), (70.0, 0.0), (89.0, 15.0)])
def test_by_default_the_block_weighs_what_a_scene_counts(angle, chisel_angle):
    share = po.Wedge(po.deg(angle), po.deg(chisel_angle), 0.25)
    assert share.mesh().volume == pytest.approx(share.equivalent_cone().volume, rel=1e-10)


def test_a_cone_of_many_sides_is_the_cone_of_revolution():
    for segments, tolerance in ((4096, 4e-7), (100_000, 1e-9)):
        body = CONE.mesh(segments=segments)
        assert body.working_area == pytest.approx(CONE.area, rel=tolerance)
        assert body.volume == pytest.approx(CONE.volume, rel=tolerance)
        tip, first, second = body.vertices[list(body.polygons[0])]
        middle = (first + second) / 2.0 - tip
        assert math.atan2(np.linalg.norm(middle[1:]), middle[0]) == pytest.approx(CONE.half_angle, rel=tolerance)
    few = CONE.mesh(segments=5)
    assert as_trimesh(few).is_watertight
    # A pyramid on a regular pentagon.
    base = 2.5 * (CONE.height * CONE.slope) ** 2 * math.sin(2.0 * math.pi / 5.0)
    assert few.volume == pytest.approx(base * CONE.height / 3.0, rel=1e-13)


test_invalid_parts_are_refused = refusals(
    po.PloughError,
    (lambda: SHARE.mesh(opening=math.pi), "opening between the faces"),
    (lambda: SHARE.mesh(thickness=-0.01), "thickness of the plate"),
    (lambda: SHARE.mesh(thickness=1.0), "0.06"),
    (lambda: CONE.mesh(segments=2), "segments = 2"),
    (lambda: po.Wedge(po.Design().variable("a", guess=0.5, lower=0.1, upper=1.0), 0.2, 0.3).mesh(), "not a number"),
    (lambda: write_part(CONE, "a.stl", opening=1.0), "belong to a wedge"),
    (lambda: write_part(SHARE, "a.obj"), r"end in .*\.step or \.stp"),
)


@pytest.fixture(params=BODIES)
def part(request):
    """A share, and how it is bent."""
    return BODIES[request.param]


def test_triangles_read_back_are_the_body(part, tmp_path):
    share, bent = part
    read = trimesh.load_mesh(write_part(share, tmp_path / "a.stl", **bent))
    body = share.mesh(**bent)
    corners = 1e3 * body.vertices[body.triangles]
    np.testing.assert_allclose(read.triangles, corners, rtol=0.0, atol=SINGLE * 1e3 * share.height)


def test_patterns_read_back_have_the_faces_and_the_bending_line(part, tmp_path):
    share, bent = part
    drawing = ezdxf.readfile(write_part(share, tmp_path / "a.dxf", **bent))
    assert drawing.units == ezdxf.units.MM
    assert not drawing.audit().errors
    page = drawing.modelspace()
    (outline,) = page.query('LWPOLYLINE[layer=="CUT"]')
    assert outline.closed
    places = np.array(outline.get_points("xy"))
    notes = " ".join(text.dxf.text for text in page.query('TEXT[layer=="NOTES"]'))
    if share is CONE:
        slant = 1e3 * CONE.height / math.cos(CONE.half_angle)
        assert np.linalg.norm(places[1:], axis=1) == pytest.approx(slant, rel=1e-9)
        angle = corner_angle(places)
        assert angle == pytest.approx(2.0 * math.pi * math.sin(CONE.half_angle), rel=1e-9)
        # The arc is about the tip, so the sector has the cone's area.
        centre = ezdxf.math.bulge_center(*places[1:], outline.get_points("b")[1][0])
        assert centre.magnitude < 1e-9 * slant
        assert slant**2 * angle / 2.0 == pytest.approx(1e6 * share.area, rel=1e-9)
        assert not page.query("LINE")
        return
    assert abs(ezdxf.math.area(outline.vertices_in_wcs())) == pytest.approx(1e6 * share.area, rel=1e-9)
    (bend,) = page.query('LINE[layer=="BEND"]')
    end = np.array([bend.dxf.end.x, bend.dxf.end.y])
    assert np.linalg.norm(end) == pytest.approx(1e3 * share.height / math.cos(share.chisel_angle), rel=1e-9)
    for far in places[1:]:
        assert corner_angle(np.array([[0.0, 0.0], end, far])) == pytest.approx(share.angle, rel=1e-9)
    assert f"Bend by {180.0 - math.degrees(bent.get('opening', share.opening)):.2f} deg" in notes
    assert ("plate 10 mm" in notes) == bool(bent)


def test_steps_read_back_have_exact_faces(part, tmp_path):
    cad = pytest.importorskip("build123d", reason="STEP needs build123d: pip install 'plough_opt[step]'")
    share, bent = part
    solid = cad.import_step(write_part(share, tmp_path / "a.step", **bent))
    assert solid.is_valid
    volume = CONE.volume if share is CONE else share.mesh(**bent).volume
    assert solid.volume == pytest.approx(1e9 * volume, rel=1e-9)
    faces = solid.faces()
    if share is CONE:
        (side,) = (face for face in faces if face.geom_type == cad.GeomType.CONE)
        assert side.area == pytest.approx(1e6 * share.area, rel=1e-9)
        assert side.semi_angle == pytest.approx(math.degrees(CONE.half_angle), rel=1e-9)
        return
    assert len(faces) == (7 if bent else 4)
    working = [face for face in faces if face.area == pytest.approx(1e6 * share.area / 2.0, rel=1e-9)]
    assert len(working) == 2
    normals = [face.normal_at() for face in working]
    between = 180.0 - normals[0].get_angle(normals[1])
    assert between == pytest.approx(math.degrees(bent.get("opening", share.opening)), rel=1e-9)
