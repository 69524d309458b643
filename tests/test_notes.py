"""Notes that differ only in their numbers become one note with the ranges of these."""

import dataclasses
import itertools

import pytest
from helpers import small_designs

import plough_opt as po
from plough_opt.core.notes import merge

# Notes of one kind, and what they become.
ALIKE = [
    (["a carries 92 % of it", "a carries 38 % of it", "a carries 50 % of it"], "a carries 38 to 92 % of it"),
    (["at 1e-9 and -3.5 m", "at 2e-10 and 4 m"], "at 2e-10 to 1e-9 and -3.5 to 4 m"),
    (["from 3 to 5 kPa", "from 2 to 4 kPa", "from 4 to 4.5 kPa"], "from 2 to 5 kPa"),
    (["only 7 of 'part 2'", "only 7 of 'part 2'"], "only 7 of 'part 2'"),
    (["the wave's part is 0.1 in Poisson's ratio", "the wave's part is 0.2 in Poisson's ratio"],
     "the wave's part is 0.1 to 0.2 in Poisson's ratio"),
    (["1 %", "1.0 %"], "1 %"),
    (["a C3 share ends with 5.", "a C3 share ends with 6."], "a C3 share ends with 5 to 6."),
]  # fmt: skip


@pytest.mark.parametrize(("texts", "wanted"), ALIKE)
def test_numbers_become_their_range_in_any_order(texts, wanted):
    for order in itertools.permutations(texts):
        notes = {}
        kinds = {merge(notes, text) for text in order}
        assert list(notes.values()) == [wanted]
        # Merged notes can be merged again, as by several processes of a sweep.
        assert kinds == {merge(notes, wanted)}
        assert list(notes.values()) == [wanted]


def test_names_with_numbers_are_different_notes():
    notes = {}
    for text in ("'tine 1' rests", "'tine 2' rests", "x1 rests 3 times", "x2 rests 3 times", "2 rest"):
        merge(notes, text)
    assert len(notes) == 5


@pytest.mark.parametrize("texts", [
    ("x 1 2", "x 1 "),
    ("at 1,000 N", "at 20,500 N"),
    ("12.5m wide", "13.5m wide"),
    ("on 2026-11-24", "on 2026-11-25"),
    ("version 1.2.3", "version 1.2.4"),
    ("at 17:40", "at 18:50"),
])  # fmt: skip
def test_other_digits_are_no_numbers(texts):
    notes = {}
    for text in texts:
        merge(notes, text)
    assert [*notes.values()] == [*texts]


def share_of_draft(text):
    """Return the ends of the share of the draft that an ambient pressure carries, as a note gives them."""
    percent = text.partition("carries ")[2].partition(" %")[0].split(" to ")
    return float(percent[0]), float(percent[-1])


def test_a_front_gives_the_range_over_all_its_designs():
    design, cohesion = small_designs.design(cohesion=(1e4, 1e3, 1e5, "Pa", True))

    def scene(cohesion):
        soil = dataclasses.replace(po.named_soil("serozem"), cohesion=cohesion)
        return po.Scene(soil, po.Cone(0.2, 0.3), 5e4, 60.0, 1.5, po.Effects(motion=False))

    run = po.simulate(scene(cohesion), 0.1, outputs=1)
    front = po.trade_off(design, run.mean_draft / 1e3, 1e4 / cohesion, points=5)
    alone = [po.simulate(scene(point.variables["cohesion"]), 0.1).warnings for point in front.points]
    shares = [share_of_draft(text) for texts in alone for text in texts if "carries" in text]
    (note,) = [text for text in front.notes if "carries" in text]
    assert note.startswith("at 5 of 5 designs")
    assert share_of_draft(note) == (min(shares)[0], max(shares)[0])
    assert min(shares) < max(shares)
