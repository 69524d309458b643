"""FMPy and SciPy as tools that import and simulate FMUs."""

import ctypes
from functools import partial

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
    given = {"fmi_type": "ModelExchange", "solver": "CVode", "relative_tolerance": TOLERANCE, "record_events": False}
    return fmpy.simulate_fmu(str(path), stop_time=duration, output_interval=duration / outputs, **given | options)


def worst(found, run):
    """Return the largest difference of any array, over that array's largest value; 0 if both are 0 throughout."""
    pairs = [(np.max(np.abs(found[name] - getattr(run, name))), np.max(np.abs(getattr(run, name)))) for name in ARRAYS]
    return max(float(error / size) if error else 0.0 for error, size in pairs)


def stepped(path, times, names, beside=0.0):
    """Return an FMU's variables at some times and its number of events, handled with a delay ``beside``.

    SciPy integrates it, like a tool that sets time and states and locates events itself.
    """
    fmu, references = instance_of(path)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    n, indicators = fmu.getNumberOfContinuousStates(), fmu.getNumberOfEventIndicators()

    def vector(get, size=n):
        values = np.zeros(size)
        get(values.ctypes.data_as(DOUBLES), size)
        return values

    def put(time, states):
        fmu.setTime(time)
        fmu.setContinuousStates(np.ascontiguousarray(states).ctypes.data_as(DOUBLES), n)

    def rates(time, states):
        put(time, states)
        return vector(fmu.getContinuousStateDerivatives)

    def indicator(k, time, states):
        put(time, states)
        return vector(fmu.getEventIndicators, indicators)[k]

    crossings = [partial(indicator, k) for k in range(indicators)]
    for crossing in crossings:
        crossing.terminal, crossing.direction = True, -1.0
    settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15, "events": crossings, "dense_output": True}
    now, values, events = 0.0, [], -1
    while now < times[-1]:
        events += 1
        fmu.updateDiscreteStates()
        fmu.enterContinuousTimeMode()
        found = solve_ivp(rates, (now, times[-1]), vector(fmu.getContinuousStates), **settings)
        end = found.t[-1]
        for time in times[(times >= now) & ((times < end) | (end >= times[-1]))]:
            put(time, found.sol(time))
            values.append(fmu.getFloat64([references[name] for name in names]))
        now = end + beside * (found.status == 1)
        put(now, found.sol(now))
        fmu.enterEventMode()
    fmu.freeInstance()
    return dict(zip(names, np.array(values).T, strict=True)), events
