"use strict";
/**
 * The results of a scene for any values of its quantities. FUNCTIONS holds the functions written from the toolkit's own
 * graph: parameters, start, step, constants, at, averages, measures. This file takes the steps, chooses their number, and estimates
 * their error. It runs in a worker, in node, and needs no page.
 * @param {any} model data about the functions
 * @param {any} f the functions
 */
function engine(model, f) {
  const ATTEMPTS = 6, MOST_STEPS = 400000;
  /* Phases per step as in plan.py: 0.475 rad leave 1e-10, and above 1.6 rad the error follows no law. */
  const PHASE = 0.475, PHASE_ERROR = 1e-10, LONG_PHASE = 1.6;
  /* Panels as in plan.py: a phase of 0.5 rad, and at least 20 over the run. */
  const PANEL = 0.5, FEWEST = 20;
  /* A size below this part of the motion's own scale counts as that part, as in checks.py. */
  const SMALLEST = 1e-7;
  const SHORT = 1e-9;
  /* Phase per step and output of a rough run: some per cent of an oscillation's peak lie between two outputs. */
  const ROUGH_PHASE = 0.8;

  /** A number in the command line's digits. */
  function digits(value, count = 6) {
    if (!Number.isFinite(value)) return Number.isNaN(value) ? "nan" : value > 0 ? "inf" : "-inf";
    const exponent = value === 0 ? 0 : Number(value.toExponential(count - 1).split("e")[1]);
    if (exponent >= -4 && exponent < count) return String(Number(value.toPrecision(count)));
    const [head, tail] = value.toExponential(count - 1).split("e");
    const power = Math.abs(Number(tail));
    return `${Number(head)}e${Number(tail) < 0 ? "-" : "+"}${power < 10 ? "0" : ""}${power}`;
  }

  /** Why a value lies outside a limit, in the command line's words; "" if it does not. */
  function broken(limit, value) {
    const unit = limit.unit ? ` ${limit.unit}` : "";
    const rules = [[Number.isFinite(value), "finite", null], [limit.above === null || value > limit.above, "above", limit.above],
      [limit.below === null || value < limit.below, "below", limit.below],
      [limit.at_least === null || value >= limit.at_least, "at least", limit.at_least],
      [limit.at_most === null || value <= limit.at_most, "at most", limit.at_most]];
    for (const [holds, relation, end] of rules) {
      if (holds) continue;
      const count = end === null || digits(value) !== digits(end) ? 6 : 17;
      const extreme = end !== null && Math.abs(end) >= 1e60;
      const why = extreme ? "beyond that, products of quantities overflow or underflow: check its unit" : limit.why;
      return `${limit.name} = ${digits(value, count)}${unit} must be ${relation}${end === null ? "" : ` ${digits(end, count)}${unit}`}${why ? `: ${why}` : ""}`;
    }
    return "";
  }

  /** Why values lie outside the model's domain, or "". */
  function refusal(x) {
    for (const [k, input] of model.inputs.entries()) {
      const why = broken(input.limit, x[k]);
      if (why) return why;
    }
    const [limited] = f.limited(x);
    return model.limits.map((limit, k) => broken(limit, limited[k])).find((why) => why) || "";
  }

  /** Ends of the steps as fractions of the duration: some in each output interval, and one at the end of a ramp. */
  function nodesOf(outputs, per, kink) {
    const count = outputs * per, nodes = Array.from({ length: count + 1 }, (_, k) => k / count);
    const near = Math.round(kink * count);
    if (kink > 0 && kink < 1 && Math.abs(nodes[near] - kink) >= SHORT) nodes.splice(Math.floor(kink * count) + 1, 0, kink);
    return nodes;
  }

  /** Means and mean squares about them, of steps pooled with those before. */
  function pool(mean, square, moments, time, size) {
    const part = size / (time + size);
    for (let j = 0; j < model.count; j++) {
      const apart = moments[j] - mean[j];
      if (j < model.squared) square[j] = (1 - part) * (square[j] + part * apart * apart) + part * moments[model.count + j];
      mean[j] += part * apart;
    }
  }

  /** The five averages and the results over time of a motion, by steps of order 8. */
  function motion(x, p, outputs, per, kink) {
    const nodes = nodesOf(outputs, per, kink), duration = p[p.length - 1], [constants] = f.constants(x);
    const mean = Array(model.count).fill(0), square = Array(model.squared).fill(0);
    let [state] = f.start(p.slice(0, -1)), next = 0;
    const rows = model.rows.map(() => new Float64Array(outputs + 1));
    for (let k = 0; k < nodes.length; k++) {
      if (next <= outputs && nodes[k] === next / outputs) {
        const [found] = f.at(x, constants, [nodes[k] * duration], state);
        rows.forEach((row, j) => { row[next] = found[j]; });
        next++;
      }
      if (k + 1 === nodes.length) break;
      const size = nodes[k + 1] - nodes[k], [following, moments] = f.step(state, [nodes[k], size], p);
      pool(mean, square, moments, nodes[k], size);
      state = following;
    }
    return { rows, five: f.averages(x, mean, square)[0], steps: nodes.length - 1 };
  }

  /** The same of a share that follows the strut: quadratures of the force over panels. */
  function still(x, duration, outputs, per, kink, { nodes, weights }) {
    const ends = nodesOf(outputs, per, kink), rows = model.rows.map(() => new Float64Array(outputs + 1));
    const [constants] = f.constants(x), at = (part) => f.at(x, constants, [part * duration], [0, 0])[0];
    const force = model.rows.indexOf("mount_force"), speed = model.rows.indexOf("speed");
    for (let k = 0; k <= outputs; k++) at(k / outputs).forEach((value, j) => { rows[j][k] = value; });
    /* The average of the change since the first node: rounding of the weights gives a constant force no variance. */
    const first = at(0)[force];
    const all = [];
    for (let k = 0; k + 1 < ends.length; k++) {
      nodes.forEach((node, j) => {
        const found = at(ends[k] + node * (ends[k + 1] - ends[k]));
        all.push([(ends[k + 1] - ends[k]) * weights[j], found[force] - first, found[speed]]);
      });
    }
    const change = all.reduce((sum, [weight, value]) => sum + weight * value, 0);
    const variance = all.reduce((sum, [weight, value]) => sum + weight * (value - change) ** 2, 0);
    const power = all.reduce((sum, [weight, value, v]) => sum + weight * (first + value) * v, 0);
    const stiffness = f.setup(x)[0][2], draft = first + change, rms = Math.sqrt(variance);
    return { rows, five: [draft, rms, draft / stiffness, rms / stiffness, power], steps: ends.length - 1 };
  }

  const peak = (row) => row.reduce((most, value) => Math.max(most, Math.abs(value)), 0);

  /** The largest relative difference of two runs, each result on its own scale: see checks.py. */
  function difference(run, other, stiffness, inertia) {
    const of = Object.fromEntries(model.rows.map((name, k) => [name, k]));
    const sizes = run.rows.map(peak);
    const apart = run.rows.map((row, k) => row.reduce((most, value, i) => Math.max(most, Math.abs(value - other.rows[k][i])), 0));
    const force = Math.max(sizes[of.mount_force], sizes[of.soil_resistance], stiffness * sizes[of.deflection]);
    const speed = inertia > 0 ? Math.max(sizes[of.speed], force / Math.sqrt(stiffness * inertia)) : sizes[of.speed];
    const least = { mount_force: force, soil_resistance: force, deflection: force / stiffness, speed, travel: force / stiffness };
    sizes[of.travel] = Math.max(sizes[of.travel], sizes[of.deflection]);
    const [draft, rms, mean, spread, power] = run.five;
    const size = Math.max(Math.abs(draft), rms, SMALLEST * force), long = Math.max(Math.abs(mean), spread, SMALLEST * force / stiffness);
    const scales = [size, Math.max(rms, SMALLEST * force), long, Math.max(spread, SMALLEST * force / stiffness), Math.max(Math.abs(power), SMALLEST * force * speed)];
    const pairs = [...model.rows.map((name, k) => [apart[k], Math.max(sizes[k], SMALLEST * least[name])]),
      ...scales.map((scale, k) => [Math.abs(run.five[k] - other.five[k]), scale])];
    if (!pairs.every(([change]) => Number.isFinite(change))) return Infinity;
    return pairs.reduce((most, [change, scale]) => change > 0 ? Math.max(most, change / scale) : most, 0);
  }

  /** A single run for a picture of many designs, with as many steps as outputs. */
  function rough(x) {
    const [[rate, kink, , , duration]] = f.setup(x), phase = Math.ceil(rate * duration / ROUGH_PHASE);
    const outputs = Math.min(model.outputs, Math.max(FEWEST, phase)), per = Math.ceil(Math.max(1, phase) / outputs);
    if (outputs * per > MOST_STEPS) throw new RangeError("the share oscillates too fast");
    const run = model.moves ? motion(x, f.parameters(x)[0], outputs, per, kink) : still(x, duration, outputs, per, kink, model.gauss[0]);
    return { ...run, error: run.five.every(Number.isFinite) ? NaN : Infinity };
  }

  /** A run and its error, estimated by a second one with fewer steps, or by a quadrature with more nodes. */
  function checked(x, outputs, wanted) {
    const [[rate, kink, stiffness, inertia, duration]] = f.setup(x);
    if (!model.moves) {
      const per = Math.max(1, Math.round(Math.max(FEWEST, Math.ceil(rate * duration / PANEL)) / outputs));
      const [run, check] = model.gauss.map((points) => still(x, duration, outputs, per, kink, points));
      return { ...run, error: difference(run, check, stiffness, 0) };
    }
    const [p] = f.parameters(x), margin = model.kinked ? 2 : 1;
    const phase = Math.min(LONG_PHASE, PHASE * (wanted / PHASE_ERROR) ** 0.125);
    let per = Math.max(2, Math.ceil(rate * duration / phase / outputs)), best = null, steps = 0;
    for (let attempt = 0; attempt < ATTEMPTS && per * outputs <= MOST_STEPS; attempt++) {
      const run = motion(x, p, outputs, per, kink), coarse = motion(x, p, outputs, Math.floor(0.75 * per), kink);
      const error = margin * difference(run, coarse, stiffness, inertia);
      steps += run.steps + coarse.steps;
      if (!best || error < best.error) best = { ...run, error };
      if (error <= wanted) break;
      /* The error falls with the eighth power of the steps; a tenth more are taken, and at most twice as many. */
      per = Math.max(per + 1, Math.ceil(per * Math.min(2, 1.1 * (error / wanted) ** 0.125)));
    }
    if (!best) throw new RangeError(`the share oscillates so fast that the run would take ${per * outputs} steps: use a softer mount or a shorter duration`);
    return { ...best, evaluated: steps };
  }

  /**
   * Results at values of the inputs in SI units, given in their order.
   * @param {number[]} x
   * @param {{ error?: number, sketch?: boolean }} [options] error to reach; or a single rough run without an estimate
   * @throws {RangeError} values outside the model's domain, or a motion without a finite result
   */
  function evaluate(x, { error: wanted = model.error, sketch = false } = {}) {
    const began = performance.now(), why = refusal(x);
    if (why) throw new RangeError(why);
    const found = sketch ? rough(x) : checked(x, model.outputs, wanted);
    if (found.error === Infinity) throw new RangeError("the motion has no finite mean: the share is driven away");
    /** @type {any} */
    const results = {};
    const [measures] = f.measures(x, found.five);
    model.averages.forEach((name, k) => { results[name] = found.five[k]; });
    model.results.forEach((one, k) => { results[one.name] = measures[k]; });
    const rows = Object.fromEntries(model.rows.map((name, k) => [name, found.rows[k]]));
    results.peak_force = rows.mount_force.reduce((a, b) => Math.max(a, b));
    results.peak_deflection = rows.deflection.reduce((a, b) => Math.max(a, b));
    const requirements = model.requirements.map((one) => {
      const values = one.everywhere ? rows[one.name] : [results[one.name]];
      const low = values.reduce((a, b) => Math.min(a, b)), high = values.reduce((a, b) => Math.max(a, b));
      const margins = [one.low === null ? Infinity : low - one.low, one.high === null ? Infinity : one.high - high];
      return { value: margins[0] < margins[1] ? low : high, margin: Math.min(...margins) };
    });
    const duration = f.setup(x)[0][4], count = rows.travel.length;
    const time = Float64Array.from({ length: count }, (_, k) => k * duration / (count - 1));
    return { ...results, rows: { time, ...rows }, requirements, error_estimate: found.error, steps: found.steps,
      seconds: (performance.now() - began) / 1000 };
  }

  /** How far a design is from feasible: the sum of its violations, each relative to its limit. */
  function violation(results) {
    return model.requirements.reduce((sum, one, k) => {
      const size = Math.max(Math.abs(one.low ?? 0), Math.abs(one.high ?? 0)) || 1;
      return sum + Math.max(0, -results.requirements[k].margin / size);
    }, 0);
  }

  return { evaluate, refusal, violation, digits };
}
