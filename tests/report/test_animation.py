"""Run.animate: a GIF whose pictures differ, and a page of its own."""

import json
import re
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

import plough_opt as po


@pytest.fixture(scope="module")
def run(r1_scene, r1_wave):
    return po.simulate(r1_scene(strength_wave=r1_wave, damping=300.0), 0.3, outputs=60)


def test_a_gif_shows_the_whole_motion_slower(run, tmp_path):
    assert run.animate(tmp_path / "new" / "a.gif", slower=2.0) == tmp_path / "new" / "a.gif"
    with Image.open(tmp_path / "new" / "a.gif") as made:
        assert made.n_frames == 9  # 0.6 s of 15 pictures each
        pictures = []
        for k in range(made.n_frames):
            made.seek(k)
            # A GIF counts in hundredths of a second.
            assert made.info["duration"] == pytest.approx(600.0 / 9.0, abs=10.0)
            pictures.append(np.asarray(made.convert("RGB"), dtype=float))
    assert all(np.mean(np.abs(one - other)) > 0.1 for one, other in pairwise(pictures))


def test_a_page_holds_the_runs_own_motion(run, tmp_path):
    text = run.animate(tmp_path / "a.html").read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.S)[1])["motion"]
    assert data["deflection"] == pytest.approx(run.deflection, rel=1e-5)
    assert np.subtract(data["strut"], data["deflection"]) == pytest.approx(run.travel, abs=1e-5)
    assert data["waves"] == [{"amplitude": 0.3, "wavelength": 0.6, "phase": 0.0}]
    assert "default-src 'none'" in text


def test_what_cannot_be_shown_is_refused(run, r1_scene, tmp_path):
    for made, options, text in (
        (po.simulate(r1_scene(motion=False), 0.3), {"target": tmp_path / "a.gif"}, "nothing changes over time"),
        (run, {"target": tmp_path / "a.mp4"}, "end in .html or .gif"),
        (run, {"target": tmp_path / "a.gif", "slower": 0.0}, "slower"),
        (run, {"target": 3}, "must be a path"),
    ):
        with pytest.raises(po.PloughError, match=text):
            made.animate(**options)
    assert list(tmp_path.iterdir()) == []
