"""FMPy and SciPy as tools that import and simulate FMUs."""

import ctypes

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Model
from scipy.integrate import solve_ivp

import plough_opt as po
from helpers.scenes import scene_of

# FMPy's CVode holds the absolute error to the relative tolerance times the nominal values. Of its relative tolerance of
# 1e-11 some hundred steps of order 5 leave a few 1e-8.
TOLERANCE = 1e-11
WITHIN = 1e-7
# SciPy's DOP853 at 1e-12 leaves a few 1e-11, and as much again where an event is handled 1e-12 s late.
CLOSELY = 1e-9
DOUBLES = ctypes.POINTER(ctypes.c_double)
ARRAYS = ("travel", "speed", "deflection", "mount_force", "soil_resistance")
SHARE = po.Wedge(po.deg(45.0), po.deg(15.0), 0.25)


def fmu_scene(**changes):
    return scene_of(**{"share": SHARE, "stiffness": 3e5, "mass": 30.0, "tow_speed": 1.5} | changes)


def instance_of(path, kind=FMU3Model, log=None):
    """Return an instance of an FMU, and its value references by name."""
    description, folder = fmpy.read_model_description(str(path)), fmpy.extract(str(path))
    identifier = description.modelExchange.modelIdentifier
    fmu = kind(guid=description.guid, unzipDirectory=folder, modelIdentifier=identifier)
    fmu.instantiate(logMessage=log)
    return fmu, {variable.name: variable.valueReference for variable in description.modelVariables}


def simulated(path, duration, outputs=200, **options):
    """Simulate an FMU with FMPy's CVode."""
    return fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        solver="CVode",
        stop_time=duration,
        relative_tolerance=TOLERANCE,
        output_interval=duration / outputs,
        **({"record_events": False} | options),
    )


def worst(found, run):
    """Return the largest difference of any array, over that array's largest value; 0 if both are 0 throughout."""
    pairs = [(np.max(np.abs(found[name] - getattr(run, name))), np.max(np.abs(getattr(run, name)))) for name in ARRAYS]
    return max(float(error / size) if error else 0.0 for error, size in pairs)


class Stepped:
    """An FMU that SciPy integrates, like a tool that sets time and states and locates events itself."""

    def __init__(self, path):
        """Bring an instance to continuous time mode."""
        self.fmu, self.references = instance_of(path)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        self.n, self.indicators = self.fmu.getNumberOfContinuousStates(), self.fmu.getNumberOfEventIndicators()
        self.fmu.updateDiscreteStates()
        self.fmu.enterContinuousTimeMode()

    def _vector(self, get, n):
        values = np.zeros(n)
        get(values.ctypes.data_as(DOUBLES), n)
        return values

    def _at(self, time, states):
        self.fmu.setTime(time)
        self.fmu.setContinuousStates(np.ascontiguousarray(states).ctypes.data_as(DOUBLES), self.n)

    def rates(self, time, states):
        self._at(time, states)
        return self._vector(self.fmu.getContinuousStateDerivatives, self.n)

    def _indicator(self, k):
        def indicator(time, states):
            self._at(time, states)
            return self._vector(self.fmu.getEventIndicators, self.indicators)[k]

        indicator.terminal, indicator.direction = True, -1.0
        return indicator

    def run(self, times, names, tolerance=1e-12, beside=0.0):
        """Return variables at some times, and the number of events; events are handled with a delay ``beside``."""
        now, states, events = 0.0, self._vector(self.fmu.getContinuousStates, self.n), 0
        values = []
        while now < times[-1]:
            found = solve_ivp(
                self.rates,
                (now, times[-1]),
                states,
                method="DOP853",
                rtol=tolerance,
                atol=tolerance * 1e-3,
                events=[self._indicator(k) for k in range(self.indicators)],
                dense_output=True,
            )
            end = found.t[-1]
            for time in times[(times >= now) & ((times < end) | (end >= times[-1]))]:
                self._at(time, found.sol(time))
                values.append(self.fmu.getFloat64([self.references[name] for name in names]))
            now, states = end, found.y[:, -1]
            if found.status == 1:
                events += 1
                now = end + beside
                self._at(now, found.sol(now))
                self.fmu.enterEventMode()
                self.fmu.updateDiscreteStates()
                self.fmu.enterContinuousTimeMode()
                states = self._vector(self.fmu.getContinuousStates, self.n)
        self.fmu.freeInstance()
        return dict(zip(names, np.array(values).T, strict=True)), events
