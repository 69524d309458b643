"""`ManyRuns`: runs at very many parameters side by side, each with its own number of steps of order 8.

A search needs output states and averages of thousands of designs, but only roughly. The steps are those of
`plough_opt.motion.steps`, compiled for a vector register of designs at a time, or interpreted by CasADi without a
compiler. Outputs within a step are read from the polynomial of degree 5 through deflection, rate and acceleration at
both ends.
"""

from __future__ import annotations

import ctypes
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plough_opt.core.compiler import library
from plough_opt.motion.batch.engine import Array, Statements, head, variants
from plough_opt.motion.equation import Structure, equation_of
from plough_opt.motion.integrators import integration
from plough_opt.motion.methods import Accuracy
from plough_opt.motion.plan import summed_and_lasting_phase
from plough_opt.motion.steps import Timeline, step

PHASE_PER_STEP = 2.6
"""Phase of a step by `summed_rate` [rad]; averages then have errors of about 1e-5 of the oscillation."""

PHASE_PER_STEP_READ = 1.6
"""The same if outputs are read within steps, by a polynomial of lower order than the method."""

# Such steps lose a part of the amplitude of a free oscillation, 3e-5 per rad. For a towed share without a damper it is
# 12 % of the RMS force after 4000 rad. If the free oscillation lasts longer than this phase [rad], a run takes shorter
# steps, so that the loss stays below about 5e-3, and below 1e-5 with twice as many steps.
_LASTING_PHASE = 70.0
# The loss per rad grows with this power of the step size.
_LOSS_ORDER = 9.0

# -O3 doubles the time of compilation and does not speed up the runs.
_VARIANTS = variants("-O2")
_FEWEST_STEPS = 16
# A run that needs more than this number, before any refinement, is not integrated.
_MOST_STEPS = 20_000
# Doubles in the widest vector register.
_WIDEST = 8
# Runs that one thread integrates at once: enough to fill vector registers many times, with little memory.
_CHUNK = 1024

_SOURCE = """
/* Integrates runs in the given order. `in` has a column for each of n runs: the parameters, the number of steps, the
   number of steps before the kink, and the time of the kink as a fraction of the duration. Writes the states at the
   outputs, the means, and the mean squares about these. */
int many_runs(int64_t n, int64_t count, const int64_t *order, const double *in, double *out, int64_t size,
              int64_t outputs, V *ends) {{
  for (int64_t first = 0; first < count; first += LANES) {{
    int64_t which[LANES];
    choose(count, order, first, which);
    V p[{given}], x[2], y[{width}], mean[{count}], square[{squared} + 1], time = {{0}};
    for (int j = 0; j < {given}; j++) p[j] = gather(in + j * n, which);
    const V total = gather(in + {given} * n, which), early = gather(in + ({given} + 1) * n, which);
    const V kink = gather(in + ({given} + 2) * n, which);
    /* Sizes of the steps before and after the kink, as fractions of the duration. */
    const V before = kink / v_max(early, (V){{0}} + 1.0), late = v_max(total - early, (V){{0}} + 1.0);
    const V after = (1.0 - kink) / late;
    double most = 0.0;
    for (int k = 0; k < LANES; k++) if (total[k] > most) most = total[k];
    {{
      V y[2];
{start}
      x[0] = y[0]; x[1] = y[1];
    }}
    for (int j = 0; j < {count}; j++) mean[j] = (V){{0}};
    for (int j = 0; j < {squared}; j++) square[j] = (V){{0}};
{once}
    for (double k = 0.0; k <= most; k += 1.0) {{
      const V now = (V){{0}} + k;
      const M open = now < total, first_part = now < early;
      V s[2]; /* start and size of the step */
      s[0] = v_pick(first_part, now * before, kink + (now - early) * after);
      s[1] = v_pick(first_part, before, after);
{each}
      /* The start of the step: w, w' and w''. */
      V *end = ends + 3 * (int64_t)k;
      end[0] = x[0]; end[1] = x[1]; end[2] = y[2];
      for (int j = 0; j < 2; j++) x[j] = v_pick(open, y[j], x[j]);
      /* Means and mean squares of this step are pooled with those of the steps before. */
      const V part = s[1] / (time + s[1]);
      for (int j = 0; j < {count}; j++) {{
        const V distance = y[3 + j] - mean[j];
        if (j < {squared})
          square[j] = v_pick(open, (1.0 - part) * (square[j] + part * distance * distance) + part * y[3 + {count} + j],
                             square[j]);
        mean[j] = v_pick(open, mean[j] + part * distance, mean[j]);
      }}
      time = v_pick(open, time + s[1], time);
    }}
    for (int l = 0; l < LANES && first + l < count; l++) {{
      double *to = out + size * which[l];
      const double kink_at = kink[l], early_steps = early[l], all = total[l], duration = p[{given} - 1][l];
      /* Each output is read from the polynomial of degree 5 through w, w' and w'' at both ends of its step. */
      for (int64_t o = 0; o <= outputs && outputs > 0; o++) {{
        const double t = (double)o / outputs;
        const int in_first = t < kink_at;
        double at = in_first ? t / before[l] : early_steps + (t - kink_at) / after[l];
        int64_t k = at;
        if (k > all - 1.0) k = all - 1.0;
        const double u = at - k, h = (in_first ? before[l] : after[l]) * duration;
        const V *a = ends + 3 * k, *b = a + 3;
        const double w = a[0][l], r = h * a[1][l], c = 0.5 * h * h * a[2][l];
        const double d = b[0][l] - w - r - c, e = h * b[1][l] - r - 2.0 * c, g = 0.5 * h * h * b[2][l] - c;
        const double c3 = 10.0 * d - 4.0 * e + g, c4 = -15.0 * d + 7.0 * e - 2.0 * g, c5 = 6.0 * d - 3.0 * e + g;
        *to++ = w + u * (r + u * (c + u * (c3 + u * (c4 + u * c5))));
        *to++ = (r + u * (2.0 * c + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / h;
      }}
      for (int j = 0; j < {count}; j++) *to++ = mean[j][l];
      for (int j = 0; j < {squared}; j++) *to++ = square[j][l];
    }}
  }}
  return 0;
}}
"""


class ManyRuns:
    """Runs of one structure, at very many parameters.

    Args:
        structure: of a motion that steps of fixed size can integrate from its start.
        outputs: number of intervals between output times; 0 if only averages are needed.

    Raises:
        InputError: an own effect has an operation without a vector form.
    """

    def __init__(self, structure: Structure, outputs: int) -> None:
        self._structure, self._outputs = structure, outputs
        self._equation = equation_of(structure)
        self._library = _library(structure)

    @property
    def size(self) -> int:
        """Number of results of a run: the states, output by output, the means, and the mean squares about them."""
        states = 2 * (self._outputs + 1) if self._outputs else 0
        return states + self._equation.averages

    @property
    def compiled(self) -> bool:
        """Whether machine code integrates the runs."""
        return self._library is not None

    def __call__(
        self, p: Array, *, finer: float = 1.0, together: int = 1, threads: int = 1, count: int | None = None
    ) -> Array:
        """Return the results, a row for each run; NaN if its parameters are not finite or it needs too many steps.

        Args:
            p: parameters of `plough_opt.motion.integrators.Integration`, the duration last; a row for each run.
            finer: factor on the number of steps.
            together: number of consecutive rows that take equally many steps, so that their results differ only because
                of their parameters. It divides the number of rows.
            threads: number of threads of machine code; the results do not depend on it.
            count: number of steps of every run, instead of a number for each.
        """
        columns = np.ascontiguousarray(p.T)
        results = np.full((len(p), self.size), np.nan)
        known = dict(zip(self._equation.names, columns, strict=False))
        with np.errstate(all="ignore"):
            if count is None:
                steps = self._steps(known, columns[-1], finer)
                steps = np.repeat(steps.reshape(-1, together).max(axis=1), together)
            else:
                steps = np.full(len(p), float(count))
            none = np.zeros_like(steps)
            early, kink = _before_kink(known, columns[-1], steps) if self._structure.ramp else (none, none)
        sound = np.flatnonzero(np.isfinite(steps) & np.isfinite(columns).all(axis=0))
        given = np.concatenate([columns, [steps, early, kink]])
        # Runs in one register wait for the slowest of them.
        order = sound[np.argsort(steps[sound], kind="stable")]
        chunks = [order[k : k + _CHUNK] for k in range(0, len(order), _CHUNK)]
        run = self._run if self.compiled else self._interpret
        if threads > 1 and len(chunks) > 1 and self.compiled:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(lambda chunk: run(given, chunk, results), chunks))
        else:
            for chunk in chunks:
                run(given, chunk, results)
        return results

    def _steps(self, known: dict[str, Array], duration: Array, finer: float) -> Array:
        """Return the number of steps of each run; infinite if it is too large."""
        phase = PHASE_PER_STEP_READ if self._outputs else PHASE_PER_STEP
        summed, lasting = summed_and_lasting_phase(known, duration)
        shorter = np.maximum((lasting / _LASTING_PHASE) ** (1.0 / _LOSS_ORDER) * phase / PHASE_PER_STEP, 1.0)
        steps: Array = np.maximum(np.ceil(finer * shorter * summed / phase), _FEWEST_STEPS)
        # Whether a run is integrated does not depend on `finer`.
        steps[summed / phase > _MOST_STEPS] = np.inf
        return steps

    def _run(self, given: Array, which: NDArray[np.int64], results: Array) -> None:
        """Enter the results of some runs, computed by machine code.

        Args:
            given: the array `in` of `_SOURCE`.
            which: numbers of the runs, sorted by their numbers of steps.
            results: receives a row for each run.
        """
        assert self._library is not None  # else CasADi interprets
        ends = np.empty(3 * int(given[-3, which[-1]] + 2.0) * _WIDEST + _WIDEST)
        # Vectors must lie at addresses that are multiples of their size.
        begin = -(-ends.ctypes.data // (8 * _WIDEST)) * (8 * _WIDEST)
        arrays = which.ctypes.data, given.ctypes.data, results.ctypes.data
        self._library.many_runs(given.shape[1], len(which), *arrays, results.shape[1], self._outputs, begin)

    def _interpret(self, given: Array, which: NDArray[np.int64], results: Array) -> None:
        """Enter the results of some runs, computed by CasADi with the next power of two as number of steps."""
        steps = 2.0 ** np.ceil(np.log2(given[-3]))
        for count in np.unique(steps[which]):
            alike = which[steps[which] == count]
            timeline = Timeline(
                self._outputs or 1, int(count), aligned=self._structure.ramp, moving=self._structure.ramp
            )
            run = integration(self._structure, Accuracy("dop853", steps=int(count)), timeline).function
            states, *averages = (np.asarray(part).T for part in run.map(len(alike))(given[:-3, alike]))
            read = states.reshape(len(alike), -1) if self._outputs else np.empty((len(alike), 0))
            results[alike] = np.hstack([read, *averages])


def _before_kink(known: dict[str, Array], duration: Array, steps: Array) -> tuple[Array, Array]:
    """Return the number of steps up to the end of a tow ramp, and that end as a fraction of the duration."""
    kink = np.clip(known["ramp_time"] / duration, 0.0, 1.0)
    early = np.ceil(kink * np.maximum(steps, _FEWEST_STEPS))
    # A ramp that ends within rounding of the end of the run, or later, makes no kink.
    inside = kink < 1.0 - 1e-9
    early = np.where(inside, np.minimum(early, np.maximum(steps, _FEWEST_STEPS) - 1.0), 0.0)
    return early, np.where(inside & (early > 0.0), kink, 0.0)


@lru_cache(maxsize=32)
def _library(structure: Structure) -> ctypes.CDLL | None:
    """Return the compiled runs of a structure; None without a compiler."""
    equation = equation_of(structure)
    begin, one = _operations(structure)
    first, text = Statements(begin, ("p",)), Statements(one, ("x", "s", "p"))
    body = _SOURCE.format(
        given=len(equation.names) + 1,
        width=one.numel_out(),
        count=equation.count,
        squared=equation.squared,
        start="\n".join([*first.once, *first.each]),
        once="\n".join(text.once),
        each="\n".join(text.each),
    )
    path = library("\n".join([head(), body]), _VARIANTS, ("many_runs",))
    if path is None:
        return None
    loaded, whole, address = ctypes.CDLL(str(path)), ctypes.c_int64, ctypes.c_void_p
    loaded.many_runs.argtypes = [whole, whole, address, address, address, whole, whole, address]
    return loaded


def _operations(structure: Structure) -> tuple[ca.Function, ca.Function]:
    """Return (parameters -> start state) and ((state, span, parameters) -> state after a step, w'', moments)."""
    equation = equation_of(structure)
    (p, _), state, span = equation.symbols(ca.SX), ca.SX.sym("state", 2), ca.SX.sym("span", 2)
    following, moments = step(structure)(state, span, p)
    acceleration = equation.rate(span[0] * p[-1], state, p[:-1])[1]
    result = ca.cse(ca.densify(ca.vertcat(following, acceleration, moments)))
    return ca.Function("begin", [p], [equation.start(p[:-1])]), ca.Function("advance", [state, span, p], [result])
