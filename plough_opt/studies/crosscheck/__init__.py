"""Comparison with other draft models: calculations side by side, which do not validate each other."""

from plough_opt.laws.asabe import asabe_draft
from plough_opt.laws.cones import spherical_cavity_draft
from plough_opt.laws.tines import godwin_draft, mckyes_ali_draft, swick_perumpral_draft
from plough_opt.laws.wedge import Tine
from plough_opt.studies.crosscheck.comparison import Comparison, ModelDraft
from plough_opt.studies.crosscheck.side_by_side import compare

__all__ = [
    "Comparison", "ModelDraft", "Tine", "asabe_draft", "compare", "godwin_draft", "mckyes_ali_draft",
    "spherical_cavity_draft", "swick_perumpral_draft",
]  # fmt: skip
