"""Drafts of one model at several speeds."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from plough_opt.core.errors import DomainError


@dataclass(frozen=True)
class ModelDraft:
    """Drafts of one model at the speeds of a comparison.

    Attributes:
        model: its name.
        depth: working depth [m], or None of a model that knows none.
        drafts: draft at each speed [N]; NaN outside the model's domain.
        refusal: why there are NaNs, or "".
        source: where its equations come from.
        standing: what of it is not verified.
        band: part of a draft by which its source lets it err either way.
    """

    model: str
    depth: float | None
    drafts: tuple[float, ...]
    refusal: str
    source: str
    standing: str
    band: float = 0.0

    @property
    def rise(self) -> float:
        """Growth of the draft from the lowest to the highest speed, relative [-]; NaN where one has no value."""
        return self.drafts[-1] / self.drafts[0] - 1.0 if self.drafts[0] else math.nan


def model_draft(
    model: str,
    depth: float | None,
    draft: Callable[[float], float],
    speeds: Sequence[float],
    source: str,
    standing: str,
    band: float = 0.0,
) -> ModelDraft:
    """Evaluate ``draft(speed)`` at every speed; what lies outside its domain becomes NaN with the first reason."""
    found, refusal = [], ""
    for speed in speeds:
        try:
            found.append(float(draft(speed)))
        except DomainError as error:
            found.append(math.nan)
            refusal = refusal or str(error)
    return ModelDraft(model, depth, tuple(found), refusal, source, standing, band)
