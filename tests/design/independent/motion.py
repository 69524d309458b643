"""The motion of shares on their mounts, for many designs at once, each with its own number of steps.

Everything is derived from the equations: half angle (7), plastic gas (23), resistance (25)-(26), motion (27). `fast`
integrates w = z - z_s, the deflection relative to the steady one at tow speed.
"""

from dataclasses import dataclass

import numpy as np

OUTPUTS = 400

# Factor on the step if paths are wanted: their polynomials of degree 5 between steps are less accurate than the steps.
_FOR_PATHS = 0.6
_FEWEST = 20
# A run that needs more steps is not integrated; its results are NaN.
_MOST = 20_000


@dataclass(frozen=True)
class Share:
    """Forces of the soil on shares; arrays over the shares."""

    half_angle: np.ndarray
    loosened_radius: np.ndarray
    static: np.ndarray
    drag: np.ndarray
    added_mass: np.ndarray
    steel: np.ndarray


def share(soil, wedge_angle, chisel_angle, height):
    """Return half angle, front radius, F0, Fd, added mass and the mass of a steel cone."""
    density, b1, cohesion, friction, tool, ambient = (np.asarray(x, dtype=float) for x in soil)
    p = np.pi * np.cos(chisel_angle) ** 2 / (2.0 * np.tan(wedge_angle))
    # sin(beta) = sqrt(p^2 + 1) - p, written without its cancellation.
    sine = 1.0 / (np.sqrt(p**2 + 1.0) + p)
    beta = np.arcsin(sine)
    slope = np.tan(beta)
    mu = np.sin(friction)
    nu = 2.0 * mu / (1.0 + mu)
    tau0 = 2.0 * cohesion * np.cos(friction)
    a = 1.0 / (1.0 - b1)
    phi = (a ** (nu / 2.0) - 1.0) / nu
    bracket = phi / b1 + a ** (nu / 2.0) + (1.0 - a ** (nu / 2.0 - 1.0)) / (b1 * (nu - 2.0))
    face = np.pi * (1.0 + tool / slope) * height**2
    return Share(
        half_angle=beta,
        loosened_radius=height * slope * np.sqrt(a),
        static=face * slope**2 * phi * (nu * ambient + tau0 / (1.0 + mu)),
        drag=face * slope**4 * bracket * density,
        added_mass=face * (2.0 / 3.0) * slope**4 * phi / b1 * density * height,
        steel=7850.0 * np.pi / 3.0 * height**3 * slope**2,
    )


@dataclass(frozen=True)
class Motion:
    """Runs; each quantity is an array over designs.

    Attributes:
        static: F0 [N].
        drag: Fd [N s^2/m^2].
        inertia: M, share and added mass [kg].
        stiffness: k0 [N/m].
        damping: c [N s/m].
        speed: V0 [m/s].
        amplitude: of the strength wave [-]; 0 without one.
        wavelength: of the wave [m].
        ramp: time in which the strut reaches its speed [s]; 0 without a ramp.
        start: "equilibrium", "rest" or "towed".
        duration: simulated time [s], a float.
    """

    static: np.ndarray
    drag: np.ndarray
    inertia: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    speed: np.ndarray
    amplitude: np.ndarray
    wavelength: np.ndarray
    ramp: np.ndarray
    start: str
    duration: float

    def __post_init__(self):
        names = [name for name in self.__dataclass_fields__ if name not in ("start", "duration")]
        values = np.broadcast_arrays(*(np.asarray(getattr(self, name), dtype=float) for name in names))
        for name, value in zip(names, values, strict=True):
            object.__setattr__(self, name, np.atleast_1d(value).ravel())

    def __len__(self):
        return len(self.static)

    def take(self, rows):
        """Return some of the runs."""
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return Motion(**{k: v[rows] if isinstance(v, np.ndarray) else v for k, v in own.items()})

    @property
    def steady(self):
        """Deflection z_s of a share that slides steadily at tow speed [m]."""
        return (self.static + self.drag * self.speed**2) / self.stiffness

    def first(self):
        """Return w and w' at time 0."""
        speed = np.where(self.ramp > 0.0, 0.0, self.speed)
        if self.start == "equilibrium":
            return (self.static + self.drag * speed**2) / self.stiffness - self.steady, 0.0 * speed
        return -self.steady, (speed if self.start == "rest" else 0.0 * speed)

    def rate(self):
        """Return the sum of the rates that the steps must resolve [1/s]."""
        own = np.sqrt(self.stiffness / self.inertia)
        decay = (self.damping + 2.0 * self.drag * self.speed) / self.inertia
        wave = np.where(self.amplitude > 0.0, 2.0 * np.pi * self.speed / self.wavelength, 0.0)
        return own + decay + wave


@dataclass(frozen=True)
class Response:
    """Results of runs, arrays over designs. Paths have a row for each of 401 output times, or are None."""

    mean_draft: np.ndarray
    force_rms: np.ndarray
    mean_deflection: np.ndarray
    displacement_rms: np.ndarray
    tow_power: np.ndarray
    deflection: np.ndarray | None = None
    mount_force: np.ndarray | None = None


NAMES = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")


def steps_of(motion, phase, paths):
    """Return each run's number of steps, and whether it is integrated at all."""
    with np.errstate(all="ignore"):
        wanted = np.ceil(motion.rate() * motion.duration / (_FOR_PATHS * phase if paths else phase))
    followed = wanted <= _MOST
    steps = _rounded(np.clip(np.nan_to_num(wanted, nan=1.0), _FEWEST, _MOST))
    return np.where(followed, steps, 1).astype(int), followed


def _rounded(steps):
    """Return numbers of steps rounded up to four binary digits, so that many designs end together."""
    unit = 2.0 ** np.maximum(np.floor(np.log2(steps)) - 3.0, 0.0)
    return unit * np.ceil(steps / unit)


def averages_of(motion, pull, sums):
    """Return the averages in the order of `NAMES`, from the integrals of w, w^2, f, f^2 and the towing power."""
    mean_w, square_w, mean_f, square_f, power = sums / motion.duration
    draft = pull + mean_f
    return np.array(
        [
            draft,
            np.sqrt(np.maximum(square_f - mean_f**2, 0.0)),
            motion.steady + mean_w,
            np.sqrt(np.maximum(square_w - mean_w**2, 0.0)),
            power,
        ]
    )


def split(motion, steps):
    """Return the number of steps in the ramp, and the step sizes in it and after it, so that a step ends with it."""
    inside = np.clip(motion.ramp / motion.duration, 0.0, 1.0)
    before = np.where(inside > 0.0, np.clip(np.round(steps * inside), 1, None), 0).astype(int)
    before = np.where(inside < 1.0, np.minimum(before, steps - 1), steps)
    first = np.minimum(motion.ramp, motion.duration) / np.maximum(before, 1)
    second = np.maximum(motion.duration - motion.ramp, 0.0) / np.maximum(steps - before, 1)
    return before, np.array([first, second])
