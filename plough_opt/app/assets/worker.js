"use strict";
/** Tasks of a worker, each from plain data to plain data; MODEL, FUNCTIONS and `engine` stand before this file. */
const ENGINES = new Map();
/** The engine of the scene with some effects switched. */
function own(effects) {
  if (!ENGINES.has(effects)) ENGINES.set(effects, engine(MODEL, FUNCTIONS, effects));
  return ENGINES.get(effects);
}
const TASKS = {
  evaluate: (effects, x, options) => own(effects).evaluate(x, options),

  /** Results of designs without those over time; null for designs outside the model's domain. */
  many: (effects, designs) => designs.map((x) => {
    try {
      const found = own(effects).evaluate(x, { sketch: true });
      found.violation = own(effects).violation(found);
      delete found.rows;
      return found;
    } catch { return null; }
  }),

  /**
   * A better design by Nelder and Mead's method in the box of the variables, each from 0 to 1: local, with a penalty.
   * @param {number[]} x values of all inputs
   * @param {number[]} which positions of the variables among them
   */
  better: (effects, x, which) => {
    const bounds = which.map((k) => MODEL.inputs[k]);
    const value = ({ lower, upper, log }, u) => log ? lower * (upper / lower) ** u : lower + u * (upper - lower);
    const place = ({ lower, upper, log }, v) => log ? Math.log(v / lower) / Math.log(upper / lower) : (v - lower) / (upper - lower);
    const design = (u) => { const all = [...x]; which.forEach((k, i) => { all[k] = value(bounds[i], u[i]); }); return all; };
    let tried = 0;
    const merit = (u) => {
      tried++;
      if (u.some((part) => part < 0 || part > 1)) return Infinity;
      try {
        const found = own(effects).evaluate(design(u), { error: 1e-6 });
        /* A violation by a hundredth of its limit counts more than the whole objective. */
        return found.objective + 100 * (1 + Math.abs(found.objective)) * own(effects).violation(found);
      } catch { return Infinity; }
    };
    const start = which.map((k, i) => Math.min(1, Math.max(0, place(bounds[i], x[k]))));
    let corners = [start, ...start.map((u, i) => start.map((v, j) => j === i ? (u > 0.5 ? u - 0.05 : u + 0.05) : v))].map((u) => ({ u, f: merit(u) }));
    const before = corners[0].f;
    while (tried < 150 * which.length) {
      corners.sort((a, b) => a.f - b.f);
      const [first, worst] = [corners[0], corners[corners.length - 1]];
      if (Math.max(...first.u.map((u, i) => Math.abs(u - worst.u[i]))) < 1e-7) break;
      const rest = corners.slice(0, -1), middle = start.map((_, i) => rest.reduce((sum, one) => sum + one.u[i], 0) / rest.length);
      const at = (part) => { const u = middle.map((m, i) => m + part * (worst.u[i] - m)); return { u, f: merit(u) }; };
      let next = at(-1);
      if (next.f < first.f) { const far = at(-2); if (far.f < next.f) next = far; }
      else if (next.f >= rest[rest.length - 1].f) next = next.f < worst.f ? at(-0.5) : at(0.5);
      if (next.f < worst.f) corners[corners.length - 1] = next;
      else corners = corners.map((one) => { const u = one.u.map((v, i) => (v + first.u[i]) / 2); return one === first ? one : { u, f: merit(u) }; });
    }
    corners.sort((a, b) => a.f - b.f);
    return { x: design(corners[0].u), before, after: corners[0].f, tried };
  },
};
onmessage = ({ data: { id, task, given } }) => {
  try { postMessage({ id, found: TASKS[task](...given) }); }
  catch (error) { postMessage({ id, why: error.message }); }
};
