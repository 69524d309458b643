"""Motion of a share by mpmath's Taylor method with 28 digits, piece by piece between given events.

The caller gives times and kinds of the events. The result states by how much each event function misses zero.
"""

import math

import mpmath

import plough_opt as po

mp = mpmath.mp.clone()
mp.dps = 28

# A piece crosses the end of the smooth contact's step by this fraction of the width, where the step is 0 or 1 to 1e-18.
LATE = mp.mpf(1e-4)
# A share stops, or turns, when it moves backwards at this part of the tow speed.
STANDSTILL = mp.mpf("1e-12")


class PreciseShare:
    """Forces of a numeric scene as functions of travel L and speed L', from the model's equations."""

    def __init__(self, scene):
        effects, reaction = scene.effects, scene.reaction

        def number(value):
            return mp.mpf(float(value or 0.0))

        self.k, self.c, self.m = (number(x) for x in (scene.restoring_stiffness, effects.damping, scene.mass))
        self.static, self.drag, self.added = (number(x) for x in (reaction.static, reaction.drag, reaction.added_mass))
        self.rate, self.ramp, self.v0 = (number(x) for x in (effects.rate_term, effects.tow_ramp, scene.tow_speed))
        wave = effects.strength_wave
        # The equation holds 2 pi as a double, whose rounding is not an error of the integration.
        turn = mp.mpf(2.0 * math.pi)
        self.wave = (number(wave.amplitude), turn / number(wave.wavelength)) if wave else (mp.zero, mp.zero)
        contact = effects.contact
        self.width = number(contact.width) if isinstance(contact, po.Smooth) else None
        self.breakaway = number(contact.breakaway) if isinstance(contact, po.StickSlip) else None
        self.height, self.entry, self.start = number(scene.cone.height), effects.entry, effects.start
        self.own = effects.own
        self.full = True  # smooth contact resists fully; None: partly; False: not at all

    def strut(self, t):
        """Return path and speed of the strut."""
        if t >= self.ramp:
            return self.v0 * (t - self.ramp / 2), self.v0
        u = t / self.ramp
        path = self.v0 * self.ramp * (u**6 - 3 * u**5 + mp.mpf(5) / 2 * u**4)
        return path, self.v0 * (6 * u**5 - 15 * u**4 + 10 * u**3)

    def step(self, speed):
        """Return the smooth contact's step, the normalised integral of u^4 (1 - u)^4."""
        if self.width is None or self.full is True:
            return mp.one
        if self.full is False:
            return mp.zero
        u = speed / self.width
        return 630 * (u**5 / 5 - 4 * u**6 / 6 + 6 * u**7 / 7 - 4 * u**8 / 8 + u**9 / 9)

    def soil(self, travel, speed, depth):
        """Return the soil's force with a fraction of the height in the soil."""
        epsilon, wave_number = self.wave
        static = self.static * (1 + self.rate * speed**2) * (1 + epsilon * mp.sin(wave_number * travel))
        own = sum((effect.force(travel, speed) for effect in self.own), mp.zero)
        return self.step(speed) * depth**2 * (static + self.drag * speed**2) + own

    def pull(self, t, travel, speed):
        """Return the mount force."""
        path, tow = self.strut(t)
        return self.k * (path - travel) + self.c * (tow - speed)

    def first(self):
        """Return travel and speed at the start."""
        tow = mp.zero if self.ramp else self.v0
        if self.start != "equilibrium":
            return mp.zero, (mp.zero if self.start == "rest" else tow)
        epsilon, self.wave = self.wave, (mp.zero, mp.zero)
        steady = self.soil(mp.zero, tow, mp.one)
        self.wave = epsilon
        return -steady / self.k, tow


def follow(scene, events, duration):
    """Return travel, speed and mount force at the end, and the relative residual of each event function."""
    share = PreciseShare(scene)
    (travel, speed), now, misses = share.first(), mp.zero, []
    following, furthest, mode = share.entry, travel, "slip"
    depth = mp.zero if share.entry else mp.one
    if share.width is not None and speed < share.width:
        share.full = None if speed > 0 else False
    if share.breakaway is not None and not speed > 0:
        held = share.pull(now, travel, speed) < share.breakaway * share.soil(travel, speed, depth)
        mode = "stick" if held else "slip"
    size = share.static / share.k + share.v0 * mp.sqrt(share.m / share.k)
    ends = [(mp.mpf(str(t)), name) for t, name in events] + [(mp.mpf(duration), None)]
    if share.ramp and share.ramp < duration:
        ends = sorted([*ends, (share.ramp, None)], key=lambda end: end[0])
    for end, name in ends:
        travel, speed = _piece(share, (now, end), (travel, speed), mode, (following, depth))
        now = end
        pull, hold = share.pull(now, travel, speed), None
        if share.breakaway is not None:
            buried = max(travel, mp.zero) / share.height if following else depth
            hold = share.breakaway * share.soil(travel, mp.zero, buried)
        late = LATE * share.width if name in ("lets go", "resists fully") else mp.zero
        if name in ("stop", "retreat"):
            late = STANDSTILL * share.v0
        if name in ("stop", "lets go", "resists", "retreat"):
            misses.append((speed + late) / share.v0)
        if name in ("yields", "resists fully"):
            misses.append((speed - share.width - late) / share.v0)
        share.full = {"yields": None, "resists": None, "resists fully": True, "lets go": False}.get(name, share.full)
        if name == "buried":
            misses.append((travel - share.height) / size)
            following, depth = False, mp.one
        if name == "stop":
            mode, furthest, speed = ("gap" if pull < 0 else "stick"), travel, mp.zero
        if name == "move":
            misses.append((pull - hold) / share.static)
            mode = "slip"
        if name == "recapture":
            misses.append((travel - furthest) / size)
            buried = travel / share.height if following else depth
            mode, speed = "slip", speed * share.m / (share.m + share.added * buried**3)
        if name == "retreat":
            following, depth, furthest = False, travel / share.height, travel
        if name == "advance":
            misses.append((travel - furthest) / size)
            following = True
    return travel, speed, share.pull(now, travel, speed), [abs(miss) for miss in misses]


def _piece(share, span, state, mode, burial):
    """Return the state at the end of a smooth piece."""
    start, end = span
    if mode == "stick" or end == start:
        return state
    following, depth = burial

    def rates(t, x):
        travel, speed = x
        pull = share.pull(t, travel, speed)
        if mode == "gap":
            return [speed, pull / share.m]
        buried = travel / share.height if following else depth
        return [speed, (pull - share.soil(travel, speed, buried)) / (share.m + share.added * buried**3)]

    return tuple(mp.odefun(rates, start, list(state), tol=mp.mpf(10) ** -22)(end))
