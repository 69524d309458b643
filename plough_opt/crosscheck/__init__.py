"""Other draft models to set beside this one: calculations side by side, of which none validates another."""

from plough_opt.crosscheck.asabe import asabe_draft
from plough_opt.crosscheck.comparison import Comparison
from plough_opt.crosscheck.godwin import godwin_draft
from plough_opt.crosscheck.mckyes_ali import mckyes_ali_draft
from plough_opt.crosscheck.rows import ModelDraft
from plough_opt.crosscheck.side_by_side import compare
from plough_opt.crosscheck.spherical_cavity import spherical_cavity_draft
from plough_opt.crosscheck.swick_perumpral import swick_perumpral_draft
from plough_opt.crosscheck.wedge import Tine

__all__ = [
    "Comparison",
    "ModelDraft",
    "Tine",
    "asabe_draft",
    "compare",
    "godwin_draft",
    "mckyes_ali_draft",
    "spherical_cavity_draft",
    "swick_perumpral_draft",
]
