"""A robust optimum beside the nominal one, and what fresh samples of the soil say of both."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import FiniteFloat

from plough_opt.design import LocalOptimum, Optimum
from plough_opt.exchange.results import SCHEMA, Saved, SavedRun, read_saved, versions
from plough_opt.motion import Run
from plough_opt.studies.uncertainty.robust import Robust
from plough_opt.studies.uncertainty.variance import SobolIndices
from plough_opt.studies.uncertainty.verification import Check, Verification


@dataclass(frozen=True)
class RobustOptimum:
    """What a robust design question found.

    Attributes:
        best: the robust optimum.
        run: its run in the nominal soil.
        nominal: the optimum for the nominal soil alone.
        robust: the results over the samples, and the measures that were asked for.
        fresh: what fresh samples say of the robust optimum.
        nominal_fresh: what the same samples say of the nominal one.
        indices: what each result at the robust optimum owes to each uncertain property.
        failures: why the optimiser found no robust optimum from some of its starts.
    """

    best: Optimum
    run: Run
    nominal: Optimum
    robust: Robust
    fresh: Verification
    nominal_fresh: Verification
    indices: Mapping[str, SobolIndices]
    failures: tuple[str, ...] = ()


class SavedRobust(Saved):
    """A robust optimum: SI units; the soil's distribution in words, the optima, the checks and the indices."""

    kind: Literal["robust optimum"] = "robust optimum"
    soil: str
    correlation: dict[str, float]
    samples: int
    seed: int
    fresh_samples: int
    best: LocalOptimum
    nominal: LocalOptimum
    checks: tuple[Check, ...]
    nominal_checks: tuple[Check, ...]
    indices: dict[str, dict[str, str | list[FiniteFloat] | list[str]]]
    warnings: tuple[str, ...]
    seconds: float
    run: SavedRun

    @classmethod
    def of(cls, found: RobustOptimum, title: str) -> SavedRobust:
        """Take what is worth keeping."""
        robust = found.robust
        return cls(
            layout=SCHEMA,
            title=title,
            versions=versions(),
            soil=robust.field.in_words(),
            correlation={" and ".join(pair): value for pair, value in robust.field.correlation.items()},
            samples=len(robust.samples),
            seed=robust.seed,
            fresh_samples=found.fresh.samples,
            best=found.best.local_optima[0],
            nominal=found.nominal.local_optima[0],
            checks=found.fresh.checks,
            nominal_checks=found.nominal_fresh.checks,
            indices={name: _plain(own) for name, own in found.indices.items()},
            warnings=(*found.best.warnings, *found.failures),
            seconds=found.best.seconds + found.nominal.seconds + found.fresh.seconds,
            run=SavedRun.of(found.run, title),
        )

    @classmethod
    def load(cls, path: str | Path) -> SavedRobust:
        """Read what ``to_json`` wrote.

        Raises:
            InputError: no such file, or not a robust optimum of this layout.
        """
        return read_saved(path, "robust optimum", "a robust optimum", cls.model_validate_json)


def _plain(indices: SobolIndices) -> dict[str, Any]:
    fields = dataclasses.asdict(indices)
    return {name: value.tolist() if hasattr(value, "tolist") else value for name, value in fields.items()}
