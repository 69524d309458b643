"""C as an expert writes it, in rk4.c: for one design or a vector register of designs at a time."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from peers import r1

COMPILER = shutil.which("cc")
if COMPILER is None:
    raise ImportError("there is no C compiler")
_CPU = Path("/proc/cpuinfo")
_FLAGS = _CPU.read_text() if _CPU.exists() else ""
WIDTH = 8 if "avx512f" in _FLAGS else 4 if "avx2" in _FLAGS else 2


class RK4:
    """Function of F0, Fd, M, k, z0, a row each, that returns mean and standard deviation of w of designs."""

    def __init__(self, *flags):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "peer.so"
            source = Path(__file__).with_name("rk4.c")
            command = [COMPILER, "-O3", "-march=native", "-ffast-math", "-shared", "-fPIC", *flags, str(source)]
            subprocess.run([*command, "-o", str(path), "-lmvec", "-lm"], check=True)
            self._library = ctypes.CDLL(str(path))
        self._library.run.restype = None

    def __call__(self, p, steps):
        out = np.empty((2, p.shape[1]))
        numbers = (ctypes.c_double(x) for x in (r1.DURATION, r1.SPEED, r1.AMPLITUDE, r1.WAVELENGTH))
        pointers = (ctypes.c_void_p(a.ctypes.data) for a in (p, out))
        self._library.run(ctypes.c_int64(p.shape[1]), *pointers, ctypes.c_int64(steps), *numbers)
        return out


def scalar():
    """Return the function that integrates one design at a time."""
    return RK4()


def vector():
    """Return the function that integrates a vector register of designs at a time."""
    return RK4(f"-DWIDTH={WIDTH}")
