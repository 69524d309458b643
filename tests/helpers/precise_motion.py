"""Motion of a share by mpmath's Taylor method with 28 digits, piece by piece between given events.

The caller gives times and kinds of the events. The result states by how much each event function misses zero.
"""

import mpmath

from helpers.forces import GAP, SLIP, STICK, Forces

mp = mpmath.mp.clone()
mp.dps = 28

# A share stops, or turns, when it moves backwards at this part of the tow speed.
STANDSTILL = mp.mpf("1e-12")


def follow(scene, events, duration):
    """Return travel, speed and mount force at the end, and the relative residual of each event function."""
    share = Forces(scene, mp)
    (travel, speed, mode), now, misses = share.start(), mp.zero, []
    furthest, size = travel, share.static / share.k + share.v0 * mp.sqrt(share.m / share.k)
    ends = [(mp.mpf(str(t)), name) for t, name in events] + [(mp.mpf(duration), None)]
    if share.ramp and share.ramp < duration:
        ends = sorted([*ends, (share.ramp, None)], key=lambda end: end[0])
    for end, name in ends:
        if mode != STICK and end > now:

            def rates(t, x, mode=mode):
                return [x[1], share.acceleration(mode, share.pull(t, *x), *x)]

            travel, speed = mp.odefun(rates, now, [travel, speed], tol=mp.mpf(10) ** -22)(end)
        now = end
        pull = share.pull(now, travel, speed)
        if name in ("stop", "retreat"):
            misses.append(speed / share.v0 + STANDSTILL)
            furthest = travel
        if name in ("recapture", "advance"):
            misses.append((travel - furthest) / size)
        if name == "stop":
            mode, speed = (GAP if pull < 0 else STICK), mp.zero
        elif name == "move":
            misses.append((pull - share.hold(travel)) / share.static)
            mode = SLIP
        elif name == "recapture":
            mode, speed = SLIP, speed * share.m / (share.m + share.carried(travel))
        elif name == "buried":
            misses.append((travel - share.height) / size)
            share.behind = share.height
        elif name in ("retreat", "advance"):
            share.behind = travel if name == "retreat" else -mp.inf
    return travel, speed, share.pull(now, travel, speed), [abs(miss) for miss in misses]
