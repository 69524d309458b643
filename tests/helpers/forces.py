"""The forces on a moving share, written from the model's equations; F0, Fd and added mass are the toolkit's."""

import math

import plough_opt as po

SLIP, STICK, GAP = 0, 1, 2


class Forces:
    """The forces of a numeric scene at travel L and speed L' in SI units, in floats or in the numbers of mpmath."""

    def __init__(self, scene, m=math):
        def number(value):
            return float(value or 0.0) if m is math else m.mpf(float(value or 0.0))

        e, reaction = scene.effects, scene.reaction
        self.sin = m.sin
        self.k, self.c, self.m = map(number, (scene.restoring_stiffness, e.damping, scene.mass))
        self.static, self.drag, self.added = map(number, (reaction.static, reaction.drag, reaction.added_mass))
        self.linear, self.rate = number(e.speed_term), number(e.rate_term)
        self.ramp, self.v0 = number(e.tow_ramp), number(scene.tow_speed)
        self.height, self.entry, self.first = number(scene.cone.height), e.entry, e.start
        waves = e.strength_wave if isinstance(e.strength_wave, tuple) else (e.strength_wave,) if e.strength_wave else ()
        # The equation holds 2 pi as a double, whose rounding is not an error of the integration.
        turn = number(2.0 * math.pi)
        self.waves = [(number(w.amplitude), turn / number(w.wavelength), number(w.phase)) for w in waves]
        self.width = number(e.contact.width) if isinstance(e.contact, po.Smooth) else None
        self.breakaway = number(e.contact.breakaway) if isinstance(e.contact, po.StickSlip) else None
        self.own = e.own
        # The furthest travel of a share that has turned back, or has been wholly in the soil.
        self.behind = -math.inf

    def strut(self, t):
        """Return path and speed of the strut."""
        if t >= self.ramp:
            return self.v0 * (t - self.ramp / 2), self.v0
        u = t / self.ramp
        return self.v0 * self.ramp * u**4 * (u * (u - 3) + 2.5), self.v0 * u**3 * (u * (6 * u - 15) + 10)

    def buried(self, travel):
        """Return the fraction of the height in the soil."""
        return min(max(travel, self.behind, 0), self.height) / self.height if self.entry else 1

    def step(self, speed):
        """Return the smooth contact's step, the normalised integral of u^4 (1 - u)^4."""
        if self.width is None:
            return 1
        u = min(max(speed / self.width, 0.0), 1.0)
        return 70.0 * u**9 - 315.0 * u**8 + 540.0 * u**7 - 420.0 * u**6 + 126.0 * u**5

    def strength(self, travel):
        """Return the static resistance at a travel."""
        return self.static * (1 + sum(a * self.sin(number * travel + phase) for a, number, phase in self.waves))

    def soil(self, travel, speed):
        """Return the resistance without the added mass."""
        strength = self.strength(travel) * (1 + self.linear * speed) * (1 + self.rate * speed**2)
        own = sum(each.force(travel, speed) for each in self.own)
        return self.step(speed) * self.buried(travel) ** 2 * (strength + self.drag * speed**2) + own

    def hold(self, travel):
        """Return the mount force at which a sticking share moves."""
        own = sum(each.at_rest(travel) for each in self.own)
        return self.breakaway * self.buried(travel) ** 2 * self.strength(travel) + own

    def carried(self, travel):
        return self.added * self.buried(travel) ** 3

    def pull(self, t, travel, speed):
        """Return the mount force."""
        path, tow = self.strut(t)
        return self.k * (path - travel) + self.c * (tow - speed)

    def acceleration(self, mode, pull, travel, speed):
        """Return L'' under a mount force."""
        if mode == SLIP:
            return (pull - self.soil(travel, speed)) / (self.m + self.carried(travel))
        return pull / self.m if mode == GAP else 0.0

    def start(self):
        """Return travel, speed and mode at time 0: a share without speed sticks unless the mount pulls enough."""
        v = self.v0 * (self.ramp == 0)
        travel, speed = 0 * v, (0 * v if self.first == "rest" else v)
        if self.first == "equilibrium":
            strength = self.static * (1 + self.linear * v) * (1 + self.rate * v**2)
            own = sum(each.force(0 * v, v) for each in self.own)
            travel = -(self.step(v) * (strength + self.drag * v**2) + own) / self.k
        if self.breakaway is None or speed > 0:
            return travel, speed, SLIP
        pull = self.static if self.first == "equilibrium" else self.pull(0, travel, speed)
        return travel, speed, (STICK if pull < self.hold(travel) else SLIP)
