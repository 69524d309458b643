"""docs/embedding.md: its tables hold every name."""

import re
from pathlib import Path

from plough_opt.core.quantities import EVERY
from plough_opt.motion.vocabulary import MEASURES

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "embedding.md").read_text(encoding="utf-8")


def test_the_tables_hold_every_name_and_no_other():
    rows = re.findall(r"^\| ([^|]*`[^|]*) \| ([^|]*) \|$", TEXT, flags=re.MULTILINE)
    named = {name for names, _ in rows for name in re.findall(r"`([\w.]+)`", names)} - {"steel_density"}
    # Further strength waves are named in a sentence.
    assert named == {name for name in (*EVERY, *MEASURES) if not re.search(r"wave_\d", name)}
    units = {unit.strip() for _, column in rows for unit in column.split(";")}
    known = {one.unit for one in EVERY.values()} | {one.unit.symbol for one in MEASURES.values()}
    assert {unit or "1" for unit in known} == units
