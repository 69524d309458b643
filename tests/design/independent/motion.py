"""The share on its mount, integrated with NumPy for many designs side by side, each by its own number of steps.

Everything is written anew from the equations: half angle (7), plastic gas (23), resistance (25)-(26), motion (27).
The method is of order 8 with fixed steps (the weights of SciPy's DOP853). What is integrated is w = z - z_s, the
deflection beyond the steady one at tow speed; averages are quadratures with the method's own weights.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import DOP853

OUTPUTS = 400

# Designs that are advanced together: their stages stay in the cache.
_CHUNK = 2048
# Of outputs between two steps, which take a polynomial of degree 5: shorter steps, for errors of the same size.
_FOR_PATHS = 0.6
_FEWEST = 20
# A run that needs more is not followed: its results are NaN.
_MOST = 20_000

_A, _B, _C = DOP853.A[:12, :12], DOP853.B[:12], DOP853.C[:12]
_AA = _A @ _A


@dataclass(frozen=True)
class Share:
    """What the soil does to shares, an array element for each of them."""

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
    """Runs, each quantity an array over designs.

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

    def strut(self, time):
        """Return path, speed and acceleration of the strut: a ramp by 10 u^3 - 15 u^4 + 6 u^5, integrated twice."""
        ramp = np.maximum(self.ramp, 1e-300)
        u = np.minimum(time / ramp, 1.0)
        path = self.speed * (ramp * (u**6 - 3.0 * u**5 + 2.5 * u**4) + np.maximum(time - self.ramp, 0.0))
        return (
            path,
            self.speed * (10.0 * u**3 - 15.0 * u**4 + 6.0 * u**5),
            self.speed / ramp * 30.0 * (u * (1.0 - u)) ** 2,
        )

    def rate(self):
        """Return the sum of the rates that a step must resolve [1/s]."""
        own = np.sqrt(self.stiffness / self.inertia)
        decay = (self.damping + 2.0 * self.drag * self.speed) / self.inertia
        wave = np.where(self.amplitude > 0.0, 2.0 * np.pi * self.speed / self.wavelength, 0.0)
        return own + decay + wave


@dataclass(frozen=True)
class Response:
    """What a run shows, an array over designs; paths have a row for each of 401 output times, or are None."""

    mean_draft: np.ndarray
    force_rms: np.ndarray
    mean_deflection: np.ndarray
    displacement_rms: np.ndarray
    tow_power: np.ndarray
    deflection: np.ndarray | None = None
    mount_force: np.ndarray | None = None


NAMES = ("mean_draft", "force_rms", "mean_deflection", "displacement_rms", "tow_power")


def simulate(motion, *, phase=0.5, paths=False):
    """Return the response of every run; NaN where a share runs away.

    Args:
        motion: the runs.
        phase: of the summed rates in a step [rad]: 0.5 leaves some 1e-10, of paths 1e-8; 1.4 some 1e-6, of paths 1e-5.
        paths: whether to return deflection and mount force at the output times.
    """
    steps, followed = steps_of(motion, phase, paths)
    order = np.argsort(-steps, kind="stable")
    averages = np.empty((len(NAMES), len(motion)))
    courses = np.empty((2, OUTPUTS + 1, len(motion))) if paths else None
    # Of a path every step's end is kept.
    size = _CHUNK if not paths else _CHUNK // 2
    for begin in range(0, len(order), size):
        rows = order[begin : begin + size]
        with np.errstate(all="ignore"):
            found, course = _advance(motion.take(rows), steps[rows], paths)
        averages[:, rows] = found
        if paths:
            courses[:, :, rows] = course
    averages[:, ~followed] = np.nan
    averages[:, ~np.all(np.isfinite(averages), axis=0)] = np.nan
    return Response(*averages, *(courses if paths else ()))


def steps_of(motion, phase, paths):
    """Return how many steps each run takes, and whether it is followed at all."""
    with np.errstate(all="ignore"):
        wanted = np.ceil(motion.rate() * motion.duration / (_FOR_PATHS * phase if paths else phase))
    followed = wanted <= _MOST
    steps = _rounded(np.clip(np.nan_to_num(wanted, nan=1.0), _FEWEST, _MOST))
    return np.where(followed, steps, 1).astype(int), followed


def _rounded(steps):
    """Return at least so many steps, to four binary digits: many designs then end together."""
    unit = 2.0 ** np.maximum(np.floor(np.log2(steps)) - 3.0, 0.0)
    return unit * np.ceil(steps / unit)


def _advance(motion, steps, paths):
    """Return averages, and deflection and force at the outputs, of runs in descending order of their steps."""
    before, durations = _split(motion, steps)
    count = len(motion)
    w, v = (np.array(x) for x in motion.first())
    states = [(w.copy(), v.copy())] if paths else None
    sums = np.zeros((5, count))
    stages, deflections, rates = np.empty((12, count)), np.empty((12, count)), np.empty((12, count))
    pull = motion.static + motion.drag * motion.speed**2
    ramped = bool(np.any(motion.ramp > 0.0))
    one = motion
    active = count
    for k in range(int(steps[0])):
        now = int(np.searchsorted(-steps, -k, side="left"))
        if now < active or k == 0:
            active = now
            one = motion.take(slice(0, active))
            forces = _Forces.of(one)
        m = active
        late = k >= before[:m]
        h = np.where(late, durations[1, :m], durations[0, :m])
        time = np.where(late, one.ramp + (k - before[:m]) * h, k * h)
        ww, vv = w[:m], v[:m]
        acc, at, rate = stages[:, :m], deflections[:, :m], rates[:, :m]
        for i in range(12):
            at[i] = ww + (_C[i] * h) * vv
            rate[i] = vv
            if i:
                at[i] += h * h * (_AA[i, :i] @ acc[:i])
                rate[i] += h * (_A[i, :i] @ acc[:i])
            acc[i] = forces.acceleration(time + _C[i] * h, at[i], rate[i])
        force = one.stiffness * at + one.damping * rate
        sums[:4, :m] += h * np.array([_B @ at, _B @ (at * at), _B @ force, _B @ (force * force)])
        if ramped:
            strut_speed = one.strut(time + _C[:, None] * h)[1]
            sums[4, :m] += h * (_B @ ((pull[:m] + force) * strut_speed))
        w[:m] = ww + h * (_B @ rate)
        v[:m] = vv + h * (_B @ acc)
        if paths:
            states.append((w.copy(), v.copy()))
    course = _at_outputs(motion, steps, before, durations, states) if paths else None
    return _averages(motion, pull, sums, ramped), course


def _averages(motion, pull, sums, ramped):
    mean_w, square_w, mean_f, square_f, power = sums / motion.duration
    draft = pull + mean_f
    return np.array(
        [
            draft,
            np.sqrt(np.maximum(square_f - mean_f**2, 0.0)),
            motion.steady + mean_w,
            np.sqrt(np.maximum(square_w - mean_w**2, 0.0)),
            power if ramped else draft * motion.speed,
        ]
    )


def _split(motion, steps):
    """Return how many steps a ramp takes, and the sizes of steps in it and behind it: none reaches across its end."""
    inside = np.clip(motion.ramp / motion.duration, 0.0, 1.0)
    before = np.where(inside > 0.0, np.clip(np.round(steps * inside), 1, None), 0).astype(int)
    before = np.where(inside < 1.0, np.minimum(before, steps - 1), steps)
    first = np.minimum(motion.ramp, motion.duration) / np.maximum(before, 1)
    second = np.maximum(motion.duration - motion.ramp, 0.0) / np.maximum(steps - before, 1)
    return before, np.array([first, second])


@dataclass(frozen=True)
class _Forces:
    """Coefficients of w'' for some runs."""

    motion: Motion
    square: np.ndarray
    drag: np.ndarray
    damping: np.ndarray
    wave: np.ndarray
    number: np.ndarray
    steady: np.ndarray
    waves: bool
    ramps: bool

    @classmethod
    def of(cls, motion):
        mass = motion.inertia
        return cls(
            motion,
            motion.stiffness / mass,
            motion.drag / mass,
            motion.damping / mass,
            motion.static * motion.amplitude / mass,
            2.0 * np.pi / motion.wavelength,
            motion.steady,
            bool(np.any(motion.amplitude > 0.0)),
            bool(np.any(motion.ramp > 0.0)),
        )

    def acceleration(self, time, w, v):
        """Return M w'' = F0 (1 + eps sin) + Fd L'^2 - (F0 + Fd V0^2) - k w - c w' + M s'', divided by M."""
        speed = self.motion.speed
        if self.ramps:
            path, strut_speed, extra = self.motion.strut(time)
            travel_speed = strut_speed - v
            result = self.drag * (travel_speed - speed) * (travel_speed + speed) - self.damping * v + extra
        else:
            path = speed * time
            result = v * (self.drag * (v - 2.0 * speed) - self.damping)
        result -= self.square * w
        if self.waves:
            result += self.wave * np.sin(self.number * (path - self.steady - w))
        return result


def _at_outputs(motion, steps, before, durations, states):
    """Return deflection and mount force at the output times, between steps by values, slopes and curvatures."""
    ends_w, ends_v = (np.array([state[k] for state in states]) for k in (0, 1))
    times = np.linspace(0.0, motion.duration, OUTPUTS + 1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = np.floor(times / durations[0])
        behind = before + np.floor((times - motion.ramp) / durations[1])
    k = np.where((times < motion.ramp) & (before > 0), np.minimum(inside, before - 1), behind)
    k = np.clip(np.nan_to_num(k), 0, steps - 1).astype(int)
    late = k >= before
    h = np.where(late, durations[1], durations[0])
    begin = np.where(late, motion.ramp + (k - before) * h, k * h)
    forces = _Forces.of(motion)
    values = []
    for j in (0, 1):
        w, v = (np.take_along_axis(ends, k + j, axis=0) for ends in (ends_w, ends_v))
        values.append((w, h * v, h * h * forces.acceleration(begin + j * h, w, v)))
    w, slope = _quintic((times - begin) / h, *values)
    deflection = motion.steady + w
    return np.array([deflection, motion.stiffness * deflection + motion.damping * slope / h])


def _quintic(x, first, second):
    """Return the polynomial of degree 5 through values, slopes and curvatures at 0 and 1, and its slope, at x."""
    (a, b, c), (value, slope, curve) = first, second
    rest, steep, bend = value - a - b - c / 2.0, slope - b - c, curve - c
    d, e, f = (
        10.0 * rest - 4.0 * steep + bend / 2.0,
        -15.0 * rest + 7.0 * steep - bend,
        6.0 * rest - 3.0 * steep + bend / 2.0,
    )
    return (
        a + x * (b + x * (c / 2.0 + x * (d + x * (e + x * f)))),
        b + x * (c + x * (3.0 * d + x * (4.0 * e + x * 5.0 * f))),
    )
