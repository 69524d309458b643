"use strict";
/**
 * The results of a scene for any values of its quantities. FUNCTIONS holds the functions written from the toolkit's own
 * graph: prepare, and for each choice of effects start, step, events, orbit, at, averages, measures. This file takes the
 * steps, chooses their number, and estimates their error. It runs in a worker, in node, and needs no page.
 * @param {any} model data about the functions
 * @param {any} functions the functions
 * @param {string} [effects] the effects that are switched: a key of `model.variants`
 */
function engine(model, functions, effects = "") {
  if (functions.whole) return whole();
  const variant = model.variants[effects], f = functions[effects];
  if (!f) throw new RangeError("these effects exclude each other, or the page does not hold their combination");
  const ATTEMPTS = 6, MOST_STEPS = 400000;
  /* Phases per step as in plan.py: 0.475 rad leave 1e-10, and above 1.6 rad the error follows no law. */
  const PHASE = 0.475, PHASE_ERROR = 1e-10, LONG_PHASE = 1.6;
  /* Panels as in plan.py: a phase of 0.5 rad, and at least 20 over the run. */
  const PANEL = 0.5, FEWEST = 20;
  /* A size below this part of the motion's own scale counts as that part, as in checks.py. */
  const SMALLEST = 1e-7;
  const SHORT = 1e-9;
  /* Phase per step and output of a rough run: its steps leave 1e-6, and a parabola through outputs some per cent of a peak. */
  const ROUGH_PHASE = 1.2;
  /* Events in one step, part of a step to which they are located, and rounding of what follows from their times, as in simulation.py. */
  const MOST_EVENTS = 100, LOCATED = 1e-14, EVENT_ROUNDING = 1e-11;
  /* Newton's method for an orbit, as in orbit.py: change of a state for slopes, last step, iterations. */
  const DIFFERENCE = 1e-6, LAST_STEP = 1e-7, ITERATIONS = 60;
  /* Wavelengths for which a share is followed from equilibrium: most have come to the orbit by then. */
  const FOLLOWED = 200;

  /** What does not change over time: orders of magnitude, limited values, constants, parameters. */
  const prepared = (x) => functions.prepare(x).slice(variant.place, variant.place + 4);

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

  /** Why a value lies outside the domain of its quantity, or "". */
  function outside(x) { return model.inputs.map((input, k) => broken(input.limit, x[k])).find((why) => why) || ""; }

  /** Why values lie outside the model's domain, or "". */
  function refusal(x) {
    const why = outside(x);
    if (why) return why;
    const [, limited] = prepared(x);
    return variant.limits.map((limit, k) => broken(limit, limited[k])).find((why) => why) || "";
  }

  /** Ends of the steps as fractions of the duration: some in each output interval, and one at each kink of the strut's speed. */
  function nodesOf(outputs, per, kinks) {
    const count = outputs * per, nodes = [];
    for (let k = 0; k <= count; k++) nodes.push(k / count);
    const apart = kinks.filter((kink) => kink > 0 && kink < 1 && Math.abs(Math.round(kink * count) / count - kink) >= SHORT);
    if (apart.length) { nodes.push(...apart); nodes.sort((a, b) => a - b); }
    return nodes;
  }

  /** Means and mean squares about them, of steps pooled with those before. */
  function pool(mean, square, moments, time, size) {
    const part = size / (time + size);
    for (let j = 0; j < variant.count; j++) {
      const apart = moments[j] - mean[j];
      if (j < variant.squared) square[j] = (1 - part) * (square[j] + part * apart * apart) + part * moments[variant.count + j];
      mean[j] += part * apart;
    }
  }

  /** One step with the events in it: each is located by halving, and changes the state. */
  function advance(state, begin, size, p) {
    if (!f.events) return f.step(state, [begin, size], p);
    const duration = p[p.length - 1], given = p.slice(0, -1), mean = Array(variant.count).fill(0), square = Array(variant.squared).fill(0);
    const events = (at, one) => f.events([at * duration], one, given), passed = ([zeros]) => zeros.some((zero) => zero < 0);
    for (let from = begin, count = 0; count < MOST_EVENTS; count++) {
      let low = 0, high = begin + size - from, [next, moments] = f.step(state, [from, high], p);
      const fires = passed(events(from + high, next));
      while (fires && high - low > LOCATED * size) {
        const middle = (low + high) / 2;
        if (passed(events(from + middle, f.step(state, [from, middle], p)[0]))) high = middle; else low = middle;
      }
      if (fires) [next, moments] = f.step(state, [from, high], p);
      pool(mean, square, moments, from - begin, high);
      if (!fires) return [next, [...mean, ...square]];
      const [zeros, after] = events(from + high, next), which = zeros.findIndex((zero) => zero < 0);
      state = after.slice(which * state.length, (which + 1) * state.length);
      from += high;
    }
    throw new RangeError(`the share stops or slips more than ${MOST_EVENTS} times in one step`);
  }

  /** The state to which one wavelength returns, and how a deviation from it has grown by then: see orbit.py. */
  function returning(p, nodes, phase) {
    const [guess, unit] = f.orbit(p), scaled = (state) => state.map((v, i) => v / unit[i]);
    const once = (start, ends = nodes) => scaled(ends.slice(1).reduce(
      (state, node, k) => f.step(state, [ends[k], node - ends[k]], p)[0], start.map((v, i) => v * unit[i])));
    /* How far a share from equilibrium is from the orbit in the end, relative to half the orbit's range. */
    const apartFrom = (orbit) => {
      const ends = nodesOf(1, Math.max(FEWEST, Math.ceil(phase / ROUGH_PHASE)), []);
      let state = scaled(f.start(p.slice(0, -1))[0]);
      for (let k = 0; k < FOLLOWED; k++) state = once(state, ends);
      return Math.hypot(...state.map((v, i) => v - orbit[i]));
    };
    let best = scaled(guess), change = [0, 0], nearest = Infinity, floquet = NaN;
    for (let k = 0; k < ITERATIONS; k++) {
      const tried = best.map((v, i) => v + change[i]), after = once(tried), miss = tried.map((v, i) => v - after[i]), apart = Math.hypot(...miss);
      const nearer = apart < nearest;
      if (nearer) {
        const [[a, c], [b, d]] = [0, 1].map((j) => once(tried.map((v, i) => v + (i === j ? DIFFERENCE : 0))).map((v, i) => (v - after[i]) / DIFFERENCE));
        const half = (a + d) / 2, root = half * half - (a * d - b * c), determinant = (a - 1) * (d - 1) - b * c;
        floquet = root < 0 ? Math.sqrt(a * d - b * c) : Math.abs(half) + Math.sqrt(root);
        [best, nearest] = [tried, apart];
        change = [((d - 1) * miss[0] - b * miss[1]) / determinant, ((a - 1) * miss[1] - c * miss[0]) / determinant];
      } else change = change.map((v) => v / 2);
      if (Math.max(...change.map(Math.abs)) >= LAST_STEP) continue;
      if (nearer) return { first: best.map((v, i) => (v + change[i]) * unit[i]), floquet, unsettled: () => apartFrom(best) };
      break;
    }
    throw new RangeError("no periodic orbit was found from its linear response: damp the mount, or use orbit = 'transient'");
  }

  const names = [...model.rows, "mode"];
  const table = (outputs) => names.map(() => new Float64Array(outputs + 1));

  /** The five averages and the results over time of a motion, by steps of order 8. */
  function motion(x, [[rate, , , long], , constants, p], outputs, per, kinks) {
    const nodes = nodesOf(outputs, per, kinks), duration = p[p.length - 1], rows = table(outputs);
    const mean = Array(variant.count).fill(0), square = Array(variant.squared).fill(0);
    const { first, ...orbit } = f.orbit ? returning(p, nodes, rate * long) : { first: f.start(p.slice(0, -1))[0] };
    let state = first, next = 0;
    for (let k = 0; k < nodes.length; k++) {
      if (next <= outputs && nodes[k] === next / outputs) {
        const [found] = f.at(x, constants, [nodes[k] * duration], state);
        for (let j = 0; j < rows.length; j++) rows[j][next] = found[j];
        next++;
      }
      if (k + 1 === nodes.length) break;
      const size = nodes[k + 1] - nodes[k], [following, moments] = advance(state, nodes[k], size, p);
      pool(mean, square, moments, nodes[k], size);
      state = following;
    }
    return { rows, constants, orbit, five: f.averages(x, constants, mean, square)[0], steps: nodes.length - 1 };
  }

  /** The same of a share that follows the strut: quadratures of the force over panels. */
  function still(x, [setup, , constants], outputs, per, { nodes, weights }) {
    const [, stiffness, , duration, ...kinks] = setup, ends = nodesOf(outputs, per, kinks), rows = table(outputs);
    const at = (part) => f.at(x, constants, [part * duration], [0, 0])[0];
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
    const draft = first + change, rms = Math.sqrt(variance);
    return { rows, constants, five: [draft, rms, draft / stiffness, rms / stiffness, power], steps: ends.length - 1 };
  }

  /** The least and the largest of values. */
  function extent(values) {
    let low = Infinity, high = -Infinity;
    for (let k = 0; k < values.length; k++) { low = Math.min(low, values[k]); high = Math.max(high, values[k]); }
    return [low, high];
  }
  /** The same between outputs, by the parabola through each end and its neighbours. */
  function between(values) {
    const ends = extent(values);
    for (const end of [0, 1]) {
      const k = values.indexOf(ends[end]), [before, after] = [values[k - 1] - ends[end], values[k + 1] - ends[end]];
      if (before + after) ends[end] -= (after - before) ** 2 / (8 * (after + before));
    }
    return ends;
  }
  const peak = (row) => Math.max(...extent(row).map(Math.abs));

  /** The largest relative difference of two runs, each result on its own scale: see checks.py. */
  function difference(run, other, stiffness, inertia) {
    const of = Object.fromEntries(names.map((name, k) => [name, k])), sizes = run.rows.map(peak);
    /* Speed and soil resistance jump at an event. */
    const alike = (k, i) => (k !== of.speed && k !== of.soil_resistance) || run.rows[of.mode][i] === other.rows[of.mode][i];
    const apart = run.rows.map((row, k) => row.reduce((most, value, i) => Math.max(most, alike(k, i) ? Math.abs(value - other.rows[k][i]) : 0), 0));
    const force = Math.max(sizes[of.mount_force], sizes[of.soil_resistance], stiffness * sizes[of.deflection]);
    const speed = inertia > 0 ? Math.max(sizes[of.speed], force / Math.sqrt(stiffness * inertia)) : sizes[of.speed];
    const least = { mount_force: force, soil_resistance: force, deflection: force / stiffness, speed, travel: force / stiffness };
    sizes[of.travel] = Math.max(sizes[of.travel], sizes[of.deflection]);
    const [draft, rms, mean, spread, power] = run.five;
    const size = Math.max(Math.abs(draft), rms, SMALLEST * force), long = Math.max(Math.abs(mean), spread, SMALLEST * force / stiffness);
    const scales = [size, Math.max(rms, SMALLEST * force), long, Math.max(spread, SMALLEST * force / stiffness),
      Math.max(Math.abs(power), SMALLEST * force * speed)];
    const pairs = [...model.rows.map((name, k) => [apart[k], Math.max(sizes[k], SMALLEST * least[name])]),
      ...scales.map((scale, k) => [Math.abs(run.five[k] - other.five[k]), scale])];
    if (!pairs.every(([change]) => Number.isFinite(change))) return Infinity;
    return pairs.reduce((most, [change, scale]) => change > 0 ? Math.max(most, change / scale) : most, 0);
  }

  /** A single run for a picture of many designs, with as many steps as outputs. */
  function rough(x, known) {
    const [[rate, , , duration, ...kinks]] = known, phase = Math.ceil(rate * duration / ROUGH_PHASE);
    const outputs = Math.min(model.outputs, Math.max(FEWEST, phase)), per = Math.ceil(Math.max(1, phase) / outputs);
    if (outputs * per > MOST_STEPS) throw new RangeError("the share oscillates too fast");
    const run = variant.moves ? motion(x, known, outputs, per, kinks) : still(x, known, outputs, per, model.gauss[0]);
    return { ...run, error: run.five.every(Number.isFinite) ? NaN : Infinity };
  }

  /** A run and its error, estimated by a second one with fewer steps, or by a quadrature with more nodes. */
  function checked(x, known, outputs, wanted) {
    const [[rate, stiffness, inertia, duration, ...kinks]] = known;
    if (!variant.moves) {
      const per = Math.max(1, Math.round(Math.max(FEWEST, Math.ceil(rate * duration / PANEL)) / outputs));
      const [run, check] = model.gauss.map((points) => still(x, known, outputs, per, points));
      return { ...run, error: difference(run, check, stiffness, 0) };
    }
    const margin = variant.kinked ? 2 : 1, least = f.events ? EVENT_ROUNDING : 0;
    const phase = Math.min(LONG_PHASE, PHASE * (wanted / PHASE_ERROR) ** 0.125);
    let per = Math.max(2, Math.ceil(rate * duration / phase / outputs)), best = null;
    for (let attempt = 0; attempt < ATTEMPTS && per * outputs <= MOST_STEPS; attempt++) {
      const run = motion(x, known, outputs, per, kinks), coarse = motion(x, known, outputs, Math.floor(0.75 * per), kinks);
      const error = Math.max(least, margin * difference(run, coarse, stiffness, inertia));
      if (!best || error < best.error) best = { ...run, error };
      if (error <= wanted) break;
      /* The error falls with the eighth power of the steps; a tenth more are taken, and at most twice as many. */
      per = Math.max(per + 1, Math.ceil(per * Math.min(2, 1.1 * (error / wanted) ** 0.125)));
    }
    if (!best) throw new RangeError(`the share oscillates so fast that the run would take ${per * outputs} steps: use a softer mount or a shorter duration`);
    return best;
  }

  /**
   * Results at values of the inputs in SI units, given in their order.
   * @param {number[]} x
   * @param {{ error?: number, sketch?: boolean, warm?: boolean }} [options] error to reach; or a single rough run without an
   *   estimate and without its curves; warm: run twice, so that the time is that of compiled functions
   * @throws {RangeError} values outside the model's domain, or a motion without a finite result
   */
  function evaluate(x, { error: wanted = model.error, sketch = false, warm = false } = {}) {
    if (warm) evaluate(x, { error: wanted });
    const began = performance.now(), why = refusal(x);
    if (why) throw new RangeError(why);
    const known = prepared(x), found = sketch ? rough(x, known) : checked(x, known, model.outputs, wanted);
    if (found.error === Infinity) throw new RangeError("the motion has no finite mean: the share is driven away");
    /** @type {any} */
    const results = {};
    const [measures] = f.measures(x, found.constants, found.five), ends = sketch ? between : extent;
    model.averages.forEach((name, k) => { results[name] = found.five[k]; });
    model.results.forEach((one, k) => { results[one.name] = measures[k]; });
    if (f.orbit) results.floquet = found.orbit.floquet;
    if (f.orbit && !sketch) results.unsettled = found.orbit.unsettled();
    const of = (name) => found.rows[model.rows.indexOf(name)];
    [, results.peak_force] = ends(of("mount_force"));
    [, results.peak_deflection] = ends(of("deflection"));
    results.requirements = model.requirements.map((one) => kept(one, one.everywhere ? ends(of(one.name)) : [results[one.name]]));
    results.error_estimate = found.error;
    results.steps = found.steps;
    if (!sketch) {
      const last = found.rows[0].length - 1, time = found.rows[0].map((_, k) => k * known[0][3] / last);
      results.rows = { time, ...Object.fromEntries(model.rows.map((name, k) => [name, found.rows[k]])) };
    }
    results.seconds = (performance.now() - began) / 1000;
    return results;
  }

  /** The value of a requirement that is nearest to its limit, and the margin. */
  function kept({ low: least, high: most }, values) {
    const [low, high] = extent(values);
    const margins = [least === null ? Infinity : low - least, most === null ? Infinity : most - high];
    return { value: margins[0] < margins[1] ? low : high, margin: Math.min(...margins) };
  }

  /** The same for a design of the user's own: objective and requirements as one function, with a fixed number of steps. */
  function whole() {
    const evaluate = (x) => {
      const began = performance.now(), why = outside(x);
      if (why) throw new RangeError(why);
      const [[objective], every] = functions.whole(x);
      if (![objective, ...every].every(Number.isFinite)) throw new RangeError("the design has no finite value here");
      let from = 0;
      const requirements = model.requirements.map((one) => kept(one, every.slice(from, from += one.count)));
      const results = Object.fromEntries(model.requirements.map((one, k) => [one.name, requirements[k].value]));
      return { ...results, objective, rows: {}, requirements, error_estimate: model.error, seconds: (performance.now() - began) / 1000 };
    };
    return { evaluate, refusal: outside, violation, digits };
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
