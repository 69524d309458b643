"""Waves in records of correlated soil, drawn with NumPy alone: few false ones, intervals that hold the truth, power.

The whole study prints its figures: pytest -m slow -s tests/test_strength_noise.py
"""

import functools
import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

import plough_opt as po

TWO = ((0.2, 0.73), (0.12, 2.1))
THREE = ((0.15, 0.5), (0.15, 1.1), (0.15, 4.0))


@dataclass(frozen=True)
class Field:
    """Soil of random strength with 15 % standard deviation, and waves (amplitude, wavelength) of random phase in it."""

    kind: str = "exponential"
    correlation_length: float = 0.3
    waves: tuple = ()
    length: float = 40.0
    nugget: float = 0.0
    even: bool = True

    def record(self, seed):
        """Return a record read every 5 cm, on a slope of strength, and the phases at its first position."""
        rng = np.random.default_rng(seed)
        x = np.arange(0.0, self.length, 0.05)
        x = x if self.even else np.sort(rng.uniform(0.0, self.length, len(x)))
        draws, phases = rng.standard_normal((2, len(x))), rng.uniform(-math.pi, math.pi, len(self.waves))
        noise = math.sqrt(1.0 - self.nugget) * self.drawn(x, draws[0]) + math.sqrt(self.nugget) * draws[1]
        waves = sum(a * np.sin(2 * math.pi * (x - x[0]) / w + p) for (a, w), p in zip(self.waves, phases, strict=True))
        return po.StrengthRecord(x, 1.5e6 * (1.0 + 0.1 * x / self.length) * (1.0 + 0.15 * noise + waves)), phases

    def drawn(self, x, draws):
        """Return correlated noise of unit variance from independent draws."""
        if self.kind == "white":
            return draws
        if self.kind == "exponential":  # exact from point to point, also at uneven distances
            kept = np.exp(-np.diff(x) / self.correlation_length)
            noise = draws.copy()
            for k in range(1, len(x)):
                noise[k] = kept[k - 1] * noise[k - 1] + math.sqrt(1.0 - kept[k - 1] ** 2) * draws[k]
            return noise
        return squared_exponential(len(x), x[1] - x[0], self.correlation_length) @ draws

    def power(self, amplitude, wavelength, level=0.01):
        """Return the probability that an oracle, who knows wavelength and covariance, finds a wave at a level.

        A likelihood ratio is noncentral chi-squared with two degrees of freedom; n a^2 / (2 S), with S the spectrum of
        the noise per reading at the wavelength, is its noncentrality.
        """
        kept = 0.0 if self.kind == "white" else math.exp(-0.05 / self.correlation_length)
        turn = 2 * math.pi * 0.05 / wavelength
        spectrum = 0.15**2 * (1 - kept**2) / (1 - 2 * kept * math.cos(turn) + kept**2)
        points = self.length / 0.05
        return stats.ncx2.sf(stats.chi2.isf(level, 2), 2, points * amplitude**2 / (2 * spectrum))


@functools.lru_cache(maxsize=2)
def squared_exponential(points, spacing, length):
    """Return the Cholesky factor of a squared exponential correlation; 1e-8 keeps it regular."""
    distance = spacing * np.abs(np.subtract.outer(np.arange(points), np.arange(points)))
    return np.linalg.cholesky(np.exp(-((distance / length) ** 2)) + 1e-8 * np.eye(points))


def studied(field, count):
    """Return the part of the records with false waves, and of each true wave the detections and the coverage."""
    false, detected, inside = 0, np.zeros(len(field.waves)), np.zeros((len(field.waves), 3))
    for seed in range(count):
        record, phases = field.record(seed)
        left = list(po.strength_waves(record, 1.0).found)
        for k, ((amplitude, wavelength), phase) in enumerate(zip(field.waves, phases, strict=True)):
            # Within the resolution of the record.
            near = [one for one in left if abs(1 / one.wave.wavelength - 1 / wavelength) < 1 / field.length]
            for one in near[:1]:
                left.remove(one)
                detected[k] += 1
                inside[k] += (
                    abs(one.wave.amplitude - amplitude) <= one.amplitude,
                    abs(one.wave.wavelength - wavelength) <= one.wavelength,
                    abs(math.remainder(one.wave.phase - phase, 2 * math.pi)) <= one.phase,
                )
        false += bool(left)
    return false / count, detected / count, inside / np.maximum(detected, 1)[:, None]


NOISE = [
    Field("white"),
    *(Field("exponential", length) for length in (0.05, 0.15, 0.3, 0.6)),
    *(Field("squared exponential", length) for length in (0.15, 0.3)),
    Field("exponential", 0.3, nugget=0.5),
    Field("white", length=20.0),
    Field("exponential", 0.3, length=20.0),
    Field("exponential", 0.3, length=200.0),
    Field("exponential", 0.3, length=20.0, even=False),
]
WAVES = [
    Field("exponential", 0.3, TWO),
    Field("white", waves=TWO),
    Field("squared exponential", 0.3, TWO),
    Field("exponential", 0.3, TWO, length=20.0),
    Field("exponential", 0.6, ((0.2, 1.4),)),
    Field("exponential", 0.15, THREE),
    Field("exponential", 0.3, ((0.2, 0.73),), length=20.0, even=False),
]


@pytest.mark.parametrize("field", [NOISE[2], NOISE[3], replace(NOISE[5], length=20.0)], ids=str)
def test_random_strength_gives_no_waves(field):
    """At three of a hundred records, two or more of five do with a probability of 1 %; the seeds are fixed."""
    assert studied(field, 5)[0] <= 1 / 5


def test_the_intervals_hold_the_truth_beside_random_strength():
    false, detected, inside = studied(WAVES[0], 8)
    assert false <= 1 / 8
    assert detected[0] == 1.0
    # With correct intervals, this many or fewer of eight cover in one case of ten thousand.
    assert np.min(inside) >= stats.binom.ppf(1e-4, 8, 0.95) / 8


@pytest.mark.slow
@pytest.mark.parametrize("field", NOISE, ids=str)
def test_of_300_records_of_random_strength_few_give_waves(field):
    false, _, _ = studied(field, 300)
    print(f"\n{field}: {100 * false:.1f} % of 300 records give a false wave")
    assert false <= 0.05


@pytest.mark.slow
@pytest.mark.parametrize("field", WAVES, ids=str)
def test_in_300_records_the_intervals_hold_the_truth(field):
    false, detected, inside = studied(field, 300)
    print(f"\n{field}: false {100 * false:.1f} %")
    for wave, found, own in zip(field.waves, detected, inside, strict=True):
        # The oracle is that of an exponential correlation.
        power = math.nan if field.kind == "squared exponential" else field.power(*wave)
        print(f"  {wave}: found {100 * found:.0f} % (oracle {100 * power:.1f} %); intervals {np.round(100 * own, 1)}")
        # Whoever searches all wavelengths must ask for more than an oracle at one of them.
        assert math.isnan(power) or found >= 0.85 * power
        # Intervals of a wave that is often missed are those of the records in which it was found.
        assert found < 0.85 or np.all((own >= 0.9) & (own <= 0.985))
    assert false <= 0.05


def test_the_noise_of_a_force_is_the_soils_through_its_rig():
    """Random strength through a rig has the rig's resonance in its spectrum, which is not a wave."""
    rig = po.Rig(mass=25.0, stiffness=4e4, damping=250.0, tow_speed=2.0)
    x = np.arange(0.0, 40.0, 0.05)
    q = 2 * math.pi * np.fft.rfftfreq(4 * len(x), 0.05)
    turn = q * rig.tow_speed
    gain = (4e4 + 250j * turn) / (4e4 - 25.0 * turn**2 + 250j * turn)  # by hand
    found = 0
    for seed in range(4):
        draws = np.random.default_rng(seed).standard_normal(4 * len(x))
        strength = Field("exponential", 0.3).drawn(0.05 * np.arange(4 * len(x)), draws)
        force = 2e3 * (1.0 + 0.15 * np.fft.irfft(np.fft.rfft(strength) * gain)[: len(x)])
        found += len(po.strength_waves(po.StrengthRecord(x, force, rig), 1.0).found)
    assert found <= 1
