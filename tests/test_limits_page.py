"""Every figure of docs/limits.md is the constant by which the code refuses."""

import re
from pathlib import Path

import pytest

from plough_opt.core import csv_rows, kept, quantities, units
from plough_opt.design import effort
from plough_opt.motion import plan
from plough_opt.motion.effects import MOST_HARMONICS
from plough_opt.problem_file import lines, overrides, own_measures, schema, source, uncertain
from plough_opt.soil.elastic import profile
from plough_opt.studies.sweep import points
from plough_opt.studies.tradeoff import trade
from plough_opt.studies.uncertainty import distribution

PAGE = (Path(__file__).parents[1] / "docs" / "limits.md").read_text(encoding="utf-8")


def most_outputs():
    """Return the schema's bound of a file's output intervals."""
    field = schema.SceneTable.model_json_schema()["properties"]["outputs"]
    return field["maximum"]


TABLES = {
    "Problem files and `--set`": (
        source._MOST_BYTES, source._LONGEST_LINE, lines.MOST_TABLES, source._MOST_BITS, units._LONGEST,
        overrides._LONGEST, source._MOST_LISTED,
        most_outputs(),
        quantities.MOST_WAVES,
        own_measures._LONGEST, own_measures._DEEPEST, own_measures._LARGEST_POWER,
    ),
    "CSV files of measurements and penetrometer readings": (
        csv_rows._MOST_BYTES, csv_rows._LONGEST_LINE, csv_rows._MOST_LISTED,
    ),
    "Saved results (`po.load`)": (kept._MOST_BYTES,),
    "Questions": (
        points.MOST_VALUES, points.MOST_SAMPLES, distribution._MOST_SAMPLES, uncertain.MOST_FRESH, trade._MOST,
        effort._MOST_TRIED, MOST_HARMONICS, profile._MOST_PIECES, plan.MOST_OUTPUTS,
    ),
    "Motions": (plan.MOST_RINGING, plan.MOST_FORCED, plan.MOST_PANELLED, plan.MOST_SHOT),
}  # fmt: skip


def figures(table):
    """Return the figures in a table's second column, sizes in bytes."""
    _, _, rest = PAGE.partition(f"| {table} | at most |\n|---|---|\n")
    assert rest, f"no table {table}"
    rows = [line.split("|")[2].strip() for line in rest.partition("\n\n")[0].splitlines()]
    scales = {"": 1, " kB": 1_000, " MB": 1_000_000}
    found = [re.fullmatch(r"([\d,]+)( kB| MB|)", row) for row in rows]
    return tuple(int(one[1].replace(",", "")) * scales[one[2]] for one in found)


@pytest.mark.parametrize("table", TABLES)
def test_figures_are_the_codes(table):
    assert figures(table) == TABLES[table]


def test_every_table_is_tested():
    assert PAGE.count("| at most |") == len(TABLES)
