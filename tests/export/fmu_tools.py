"""FMPy, the client with which exported FMUs are exercised."""

import fmpy
import numpy as np
from fmpy.fmi3 import FMU3Model

# FMPy's CVode holds the absolute error to the relative tolerance times the nominal values. Of its relative tolerance of
# 1e-11 some hundred steps of order 5 leave a few 1e-8.
TOLERANCE = 1e-11
WITHIN = 1e-7
ARRAYS = ("travel", "speed", "deflection", "mount_force", "soil_resistance")


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


def differences(found, run, names=ARRAYS):
    """Return the largest difference of each array, over the largest value of it."""
    return {
        name: float(np.max(np.abs(found[name] - getattr(run, name))) / np.max(np.abs(getattr(run, name))))
        for name in names
    }
