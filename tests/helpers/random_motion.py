"""Realisations of random strength: sums of many waves with random phases, as an own effect."""

import math
from dataclasses import dataclass, replace

import numpy as np

import plough_opt as po
from plough_opt.expressions import sin


@dataclass(frozen=True)
class Drawn:
    """The varying part F0 (1 + kappa L'^2) sum(eps sin(q L + phi)) of a resistance."""

    static: float
    rate: float
    size: float
    numbers: tuple[float, ...]
    phases: tuple[float, ...]

    def force(self, travel, speed):
        sines = (sin(q * travel + p) for q, p in zip(self.numbers, self.phases, strict=True))
        return self.static * (1.0 + self.rate * speed**2) * self.size * sum(sines)


def quantiles(random, parts):
    """Return the wave numbers below which the given parts of a spectrum's variance lie."""
    if isinstance(random, po.RandomStrength):
        return np.tan(parts * math.pi / 2.0) / random.correlation_length
    q, density = random.wave_number, random.density
    fine = np.linspace(q[0], q[-1], 200_001)
    below = np.cumsum(np.interp(fine, q, density))
    return np.interp(parts, below / below[-1], fine)


def realisation(scene, count, seed):
    """Return the scene with a realisation of its random strength: waves of equal variance, one from each part of it."""
    random, rng = scene.effects.random_strength, np.random.default_rng(seed)
    numbers = quantiles(random, (np.arange(count) + rng.uniform(size=count)) / count)
    size = math.sqrt(2.0 * random.variance / count)
    phases = rng.uniform(0.0, 2.0 * math.pi, count)
    rate = scene.effects.rate_term or 0.0
    drawn = Drawn(scene.reaction.static, rate, size, tuple(numbers.tolist()), tuple(phases.tolist()))
    return replace(scene, effects=replace(scene.effects, random_strength=None, own=(drawn,)))
