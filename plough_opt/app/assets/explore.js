"use strict";
/* The design in the reader's hand: controls, results, landscape. All numbers come from workers that run engine.js. */
(() => {
  const section = document.getElementById("explore"), model = DATA.model;
  section.hidden = false;
  const link = /** @type {HTMLElement} */ (document.querySelector("[data-explore]"));
  link.hidden = false;
  /* The address belongs to the design. */
  link.addEventListener("click", (event) => { event.preventDefault(); section.scrollIntoView(); });
  if (!model) return;
  const { inputs } = model, place = (id) => /** @type {any} */ (document.getElementById(id));
  const variables = inputs.flatMap((one, k) => one.variable ? [k] : []);
  const initial = inputs.map((one) => model.best[one.name] ?? one.value);
  /* A design of the user's own has no motion that the page knows. */
  const single = Boolean(model.tables), panels = Object.entries(model.panels), peaks = single ? [
    { ...model.panels.force, name: "peak_force", label: `peak mount force${model.without}` },
    { ...model.panels.deflection, name: "peak_deflection", label: `peak deflection${model.without}` },
    ...(model.orbit ? [{ name: "floquet", label: "largest Floquet multiplier (below 1: the orbit is stable)", symbol: "", factor: 1 },
      { name: "unsettled", symbol: "%", factor: 0.01,
        label: "distance from the orbit after 200 wavelengths from equilibrium (0 %: the share comes to it)" }] : [])] : [];
  const columns = [...inputs.filter((one) => one.variable), ...model.results, ...peaks];
  /* A design as one function takes as many steps as its runs; the engine takes fewer for the landscape. */
  const DESIGNS = single ? 2000 : 500, CHUNK = 50, CURVE = 61, MOST_PINS = 4, COLOURS = ["#d55e00", "#009e73", "#cc79a7", "#e69f00"];
  let x = [...initial], effects = "", now = null, best = null, marks = [], error = model.error, pins = [];
  let cloud = [], curve = [], computedFor = "", refused = "";

  /* Workers: one answers the controls, the other samples, so that a move never waits. */
  const text = `const MODEL = ${JSON.stringify(model)};\n${place("engine").textContent}`;
  const url = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  function worker() {
    const made = new Worker(url), waiting = new Map();
    let count = 0;
    made.onmessage = ({ data }) => {
      const [resolve, reject] = waiting.get(data.id);
      waiting.delete(data.id);
      if (data.why) reject(new RangeError(data.why)); else resolve(data.found);
    };
    return (task, ...given) => new Promise((resolve, reject) => { waiting.set(++count, [resolve, reject]); made.postMessage({ id: count, task, given }); });
  }
  const [quick, slow] = [worker(), worker()];

  const make = (tag, given = {}, ...children) => { const one = Object.assign(document.createElement(tag), given); one.append(...children); return one; };
  const pretty = (symbol) => symbol.replace(/\^([23])/g, (_, power) => "²³"[power - 2]).replaceAll("*", "·").replace(/ ?\bdeg\b/, "°");
  const shown = (one, value) => withUnit(value / one.factor, pretty(one.symbol)).replace(" °", "°");
  const percent = (change) => `${change > 0 ? "+" : ""}${number(100 * change)} %`;
  /* Values at positions from 0 to 1 between the bounds; a catalogue has equal distances between its entries. */
  const value = (one, u) => one.steps?.length > 1 ? one.steps[Math.round(u * (one.steps.length - 1))]
    : one.log ? one.lower * (one.upper / one.lower) ** u : one.lower + u * (one.upper - one.lower);
  const nearest = (steps, v) => steps.reduce((best, each, k) => Math.abs(each - v) < Math.abs(steps[best] - v) ? k : best, 0);
  const part = (one, v) => one.steps?.length > 1 ? nearest(one.steps, v) / (one.steps.length - 1)
    : one.log ? Math.log(v / one.lower) / Math.log(one.upper / one.lower) : (v - one.lower) / (one.upper - one.lower);
  const keyed = (values) => Object.fromEntries(inputs.map((one, k) => [one.name, values[k]]));
  const inOrder = (given) => inputs.map((one, k) => given[one.name] ?? x[k]);
  /* Values that a script gives; an error names the one that is no quantity or no number. */
  function requested(given) {
    for (const [name, value] of Object.entries(given)) {
      if (!inputs.some((one) => one.name === name)) throw new RangeError(`there is no quantity "${name}": use ${inputs.map((one) => one.name).join(", ")}`);
      if (value === undefined || Number.isFinite(value)) continue;
      const written = typeof value === "string" ? JSON.stringify(value) : value;
      throw new TypeError(`${name} = ${written} is not a finite number: give one in SI units`);
    }
    return inOrder(given);
  }

  /* The design in the address: the values that differ from the start. */
  const address = (values) => ["explore", ...(effects ? [`effects=${effects}`] : []),
    ...inputs.flatMap((one, k) => values[k] === initial[k] ? [] : [`${one.name}=${values[k]}`])].join("&");
  function addressed() {
    const given = new Map(location.hash.slice(1).split("&").map((one) => { const [name, v] = one.split("="); return [name, v]; }));
    effects = given.get("effects") in model.variants ? given.get("effects") : "";
    return inputs.map((one, k) => { const v = given.get(one.name); return v && Number.isFinite(Number(v)) ? Number(v) : initial[k]; });
  }
  /* Addresses visited, for the button; the browser's own Back and Forward go through the same ones. */
  let visited = [location.hash.startsWith("#explore") ? location.hash : ""], at = 0;
  function reached(k) {
    at = k;
    place("undo").disabled = at === 0;
  }
  reached(0);
  function commit() {
    const hash = `#${address(x)}`;
    if (hash === (location.hash || "#explore")) return;
    visited = [...visited.slice(0, at + 1), hash];
    reached(at + 1);
    location.hash = hash;
  }
  addEventListener("hashchange", () => {
    /* Other links lead to other places of the page. */
    if (location.hash && !location.hash.startsWith("#explore")) return;
    reached(Math.max(0, visited.lastIndexOf(location.hash)));
    if (`#${address(x)}` !== (location.hash || "#explore")) take(addressed(), false);
  });

  /* Controls: a slider and a field for each quantity, in the file's units. */
  const controls = inputs.map((one, k) => {
    const most = String(one.steps?.length > 1 ? one.steps.length - 1 : 1000);
    const slider = make("input", { type: "range", min: "0", max: most, step: "1", ariaLabel: one.label });
    const field = make("input", { type: "text", inputMode: "decimal", ariaLabel: `${one.label} in ${one.symbol || "no unit"}` });
    const wrong = make("span", { className: "wrong" }), more = make("span", { className: "small" });
    slider.addEventListener("input", () => move(k, value(one, slider.value / slider.max), field));
    field.addEventListener("input", () => move(k, Number(field.value.trim().replace(",", ".") || NaN) * one.factor, slider));
    for (const each of [slider, field]) each.addEventListener("change", () => { write(k); if (!wrong.textContent) commit(); });
    const cells = [make("span", { textContent: one.label }), slider, field, make("span", { textContent: pretty(one.symbol) }), wrong, more];
    return { slider, field, wrong, more, row: make("div", { className: "control" }, ...cells) };
  });
  for (const group of new Set(inputs.map((one) => one.group))) {
    const rows = inputs.flatMap((one, k) => one.group === group ? [controls[k].row] : []);
    const open = group === "variables" || !variables.length;
    place("controls").append(make("details", { open }, make("summary", { textContent: group.replace(/^effects\./, "").replace(/[._]/g, " ") }), ...rows));
  }
  /* Effects on and off: a key of the variants lists the numbers of those that are switched. */
  const switchedIn = (key) => key ? key.split(",").map(Number) : [];
  const toggled = (k) => {
    const which = switchedIn(effects);
    return (which.includes(k) ? which.filter((one) => one !== k) : [...which, k].sort((a, b) => a - b)).join(",");
  };
  const described = (key) => switchedIn(key).map((k) => `${model.switches[k].on ? "without" : "with"} ${model.switches[k].label}`).join(", ");
  const switches = model.switches.map((one, k) => {
    const box = make("input", { type: "checkbox" }), says = make("span", { className: "small" });
    box.addEventListener("change", () => { effects = toggled(k); take(x); });
    return { ...one, box, says, row: make("div", { className: "switch" }, make("label", {}, box, ` ${one.label}`), says) };
  });
  const terms = make("details", { ontoggle: () => { if (now) later(); } },
    make("summary", { textContent: "terms of the equation: effects on and off" }), ...switches.map(({ row }) => row));
  if (switches.length) place("controls").append(terms);
  place("controls").addEventListener("submit", (event) => event.preventDefault());
  function write(k, but) {
    const { slider, field } = controls[k], one = inputs[k];
    if (slider !== but && Number.isFinite(x[k])) slider.value = String(Math.round(slider.max * Math.min(1, Math.max(0, part(one, x[k])))));
    slider.ariaValueText = shown(one, x[k]);
    if (field !== but && Number.isFinite(x[k])) field.value = String(Number((x[k] / one.factor).toPrecision(6)));
  }
  function move(k, to, other) {
    x = x.map((v, i) => i === k ? to : v);
    write(k, other === controls[k].field ? controls[k].slider : controls[k].field);
    ask();
  }
  function take(values, keep = true) {
    x = [...values];
    inputs.forEach((_, k) => write(k));
    switches.forEach(({ box, on }, k) => { box.checked = on !== switchedIn(effects).includes(k); box.disabled = !(toggled(k) in model.variants); });
    if (keep) commit();
    return ask();
  }

  /* One question at a time; the newest waits, and those in between are dropped. */
  let busy = null, again = false;
  function ask() {
    again = true;
    return busy ||= (async () => {
      while (again) {
        again = false;
        const asked = x, under = effects;
        try { show(asked, under, await computed(asked, under)); } catch (why) { refuse(why.message, why.control); }
      }
      busy = null;
    })();
  }
  async function computed(values, under) {
    const control = values.findIndex(Number.isNaN);
    if (control < 0) return quick("evaluate", under, values, { error });
    const one = inputs[control], unit = one.symbol ? ` in ${pretty(one.symbol)}, without the unit` : "";
    const example = Number((initial[control] / one.factor).toPrecision(6));
    throw Object.assign(new RangeError(`'${controls[control].field.value}' is not a number: write one${unit}, such as ${example}`), { control });
  }
  /* While a value is refused, the results are those of the last valid design, and nothing leaves the page. */
  function refuse(why, k = why ? inputs.findIndex((one) => why.startsWith(`${one.limit.name} = `)) : -1) {
    const before = refused;
    refused = why;
    if (now && !before !== !why) { rebuild(); if (charts.cloud) scatter(); }
    for (const each of /** @type {any} */ (section.querySelectorAll("[data-leaves]"))) each.disabled = why !== "";
    if (now) table();
    controls.forEach(({ wrong, field }, i) => { wrong.textContent = i === k ? why : ""; field.ariaInvalid = String(i === k); });
    place("status").textContent = why;
    section.classList.toggle("refused", why !== "");
  }

  function show(values, under, found) {
    now = { x: values, effects: under, ...found };
    refuse("");
    const digits = found.error_estimate > 0 ? found.error_estimate.toExponential(0) : "below 1e-15";
    const how = single ? `, ${found.steps} steps` : " of the objective, at the best design";
    place("accuracy-now").textContent = `estimated error ${digits}${how}, ${number(1000 * found.seconds)} ms`;
    place("lights").replaceChildren(...model.requirements.map((one, k) => {
      const { value: v, margin } = found.requirements[k], rounding = 1e-8 * Math.abs(v), met = margin >= -rounding;
      const light = make("span", { className: `tag ${met ? "good" : "bad"}`, textContent: met ? "✓ met" : "✗ fails" });
      const left = shown(one, Math.abs(margin) <= rounding ? 0 : margin);
      return make("li", {}, light, ` ${one.label} ${shown(one, v)}, ${pretty(one.words)}, margin ${left}`);
    }));
    draw();
    if (single) outlined(values, found);
    if (model.file) place("command").value = command();
    later();
  }

  const fixed = ({ x: values, effects: under }) => JSON.stringify([under, values.filter((_, k) => !variables.includes(k))]);
  const nowName = () => refused ? "last valid" : "now";
  /* What Python computed belongs to the question of the file. */
  const asked = model.file ? "file’s question" : "design’s parameters";
  const dated = (name, words = `computed for the ${asked}`) => !variables.length || fixed(now) === fixed(best) ? name : `${name}, ${words}`;
  const of = (design, one) => design[one.name] ?? design.x[inputs.findIndex((each) => each.name === one.name)];
  function table() {
    const designs = [[nowName(), now], ...(best ? [[dated(model.known, asked), best]] : []), ...pins.map((pin, k) => [`pin ${k + 1}`, pin])];
    const unpin = (design) => { pins = pins.filter((pin) => pin !== design); rebuild(); table(); };
    const remove = (name, design) => make("button", { type: "button", textContent: "×", ariaLabel: `remove ${name}`, onclick: () => unpin(design) });
    const head = designs.map(([name, design]) => make("th", { scope: "col" }, [name, described(design.effects)].filter(Boolean).join(", "),
      ...(pins.includes(design) ? [remove(name, design)] : [])));
    if (best) head.splice(1, 0, make("th", { scope: "col", textContent: `from ${model.known}` }));
    place("table").tHead.replaceChildren(make("tr", {}, make("th", { scope: "col" }), ...head));
    place("table").tBodies[0].replaceChildren(...columns.map((one) => {
      const cells = designs.map(([, design]) => make("td", { textContent: shown(one, of(design, one)) }));
      if (best) cells.splice(1, 0, make("td", { textContent: percent((of(now, one) - of(best, one)) / (Math.abs(of(best, one)) || 1)) }));
      return make("tr", {}, make("th", { scope: "row", textContent: one.label }), ...cells);
    }));
  }

  /* Charts over time, built anew when the pins change and redrawn at each move. */
  const charts = {};
  const listed = () => [now, ...pins];
  /* Each curve of a picture: the place of its design among those listed, and the name of the result. */
  const curvesOf = ({ rows }) => listed().flatMap((design, k) => rows.map((name, j) =>
    ({ k, name, design, colour: ["#0072b2", ...COLOURS][(k * rows.length + j) % 5] })));
  function rebuild() {
    for (const [key, panel] of panels) {
      const id = `now_${key}`, { time } = now.rows;
      if (charts[id]) charts[id].u.destroy();
      charts[id] = build({ id, x: { label: "time", unit: "s", values: [...time] }, y: { label: panel.label, unit: pretty(panel.symbol) },
        lines: model.requirements.filter((one) => panel.rows.includes(one.name)).flatMap((one) => [one.low, one.high])
          .filter((end) => end !== null).map((end) => ({ label: "limit", value: end / panel.factor, colour: "#d55e00", dash: "" })),
        series: curvesOf(panel).map(({ k, name, colour }) => ({
          label: [k ? `pin ${k}` : nowName(), ...name.split(".").slice(0, -1)].join(", "), colour, dash: k ? "dash" : "", values: [...time] })) });
    }
    draw();
  }
  function draw() {
    if (panels.length && !charts.now_force) { rebuild(); return; }
    for (const [key, panel] of panels) {
      const { time } = now.rows, last = time.length - 1;
      const along = ({ design: { rows }, name }) => Array.from(time, (t) => {
        const k = Math.round(t / rows.time[last] * last);
        return k <= last ? rows[name][k] / panel.factor : null;
      });
      charts[`now_${key}`].u.setData([[...time], ...curvesOf(panel).map(along)]);
    }
  }

  /* The section of the present cone and of the soil that it loosens; the largest so far decide the scale. */
  const box = { long: 0, wide: 0 };
  function outlined(values, found) {
    const long = keyed(values)["share.height"], radius = long * Math.tan(found.half_angle), wide = found.loosened_radius ?? radius;
    Object.assign(box, { long: Math.max(box.long, long), wide: Math.max(box.wide, wide, radius) });
    const svg = place("now_section").querySelector("svg"), outline = (half) => `M0 0L${long} ${half}V${-half}Z`;
    svg.setAttribute("viewBox", `0 ${-box.wide} ${box.long} ${2 * box.wide}`);
    svg.querySelector(".front").setAttribute("d", outline(wide));
    svg.querySelector(".cone").setAttribute("d", outline(radius));
  }

  /* The landscape: a sample of the box, computed anew when soil or scene change, and a curve through the present design. */
  const axes = [place("across"), place("up")];
  axes.forEach((select, k) => {
    select.append(...columns.map((one, i) => make("option", { value: String(i), textContent: one.label })));
    select.value = String(model.axes.length ? columns.findIndex((one) => one.name === model.axes[k]) : k ? variables.length : 0);
    select.addEventListener("change", () => { later(); scatter(); });
  });
  /* Seeded random numbers from 0 to 1 (mulberry32), so that a design can be clicked again on a later visit. */
  let seed = 33;
  function random() {
    seed = (seed + 0x6d2b79f5) | 0;
    let r = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    r = (r + Math.imul(r ^ (r >>> 7), 61 | r)) ^ r;
    return ((r ^ (r >>> 14)) >>> 0) / 2 ** 32;
  }
  const sampled = () => x.map((v, k) => variables.includes(k) ? value(inputs[k], random()) : v);
  let timer = 0, seen = false, turn = 0;
  const later = () => { clearTimeout(timer); timer = setTimeout(sample, 150); };
  async function sample() {
    const mine = ++turn, asked = now.x, under = now.effects;
    if (terms.open) for (const [k, { says, box }] of switches.entries()) {
      const key = toggled(k), known = await slow("evaluate", under, asked, { error, warm: true });
      const other = key in model.variants && await slow("evaluate", key, asked, { error, warm: true }).catch(() => null);
      if (mine !== turn) return;
      if (!other) {
        says.textContent = "not on this page: another effect or a result of the file needs it, or the formulas would be too long";
        continue;
      }
      const parts = ["mean_draft", "force_rms", "mean_deflection"].map((name) =>
        `${columns.find((one) => one.name === name).label} ${percent((other[name] - known[name]) / (Math.abs(known[name]) || 1))}`);
      const nodes = `${model.variants[key].nodes} operations in the equation instead of ${model.variants[under].nodes}`;
      const time = `${number(1000 * other.seconds)} ms instead of ${number(1000 * known.seconds)} ms`;
      says.textContent = `${box.checked ? "without" : "with"} it: ${parts.join(", ")}; ${nodes}, ${other.steps} steps instead of ${known.steps}, ${time}`;
    }
    const nudged = await slow("many", under, variables.map((k) => asked.map((v, i) => i === k ? 1.01 * v : v)).concat([asked]));
    if (mine !== turn) return;
    const base = nudged.pop();
    const gain = (one) => percent((one.objective - base.objective) / Math.abs(base.objective));
    variables.forEach((k, i) => {
      controls[k].more.textContent = nudged[i] && base && model.objective ? `1 % more: objective ${gain(nudged[i])}` : "";
    });
    if (!seen || !variables.length) return;
    const k = inputs.findIndex((one) => one.name === columns[axes[0].value].name);
    const line = k < 0 ? [] : Array.from({ length: CURVE }, (_, i) => asked.map((v, j) => j === k ? value(inputs[k], i / (CURVE - 1)) : v));
    const along = await slow("many", under, line);
    if (mine !== turn) return;
    curve = line.flatMap((one, i) => along[i] ? [{ x: one, ...along[i] }] : []);
    const question = fixed(now);
    if (question !== computedFor) { cloud = []; seed = 33; computedFor = question; }
    scatter();
    while (cloud.length < DESIGNS) {
      const rows = Array.from({ length: CHUNK }, sampled), found = await slow("many", under, rows);
      if (mine !== turn) return;
      cloud.push(...rows.map((one, i) => found[i] && { x: one, ...found[i] }));
      if (cloud.length % 500 === 0) scatter();
    }
  }
  function scatter() {
    const [across, up] = axes.map((select) => columns[select.value]);
    const group = (label, colour, size, designs) => ({ label, colour, size,
      x: designs.map((one) => of(one, across) / across.factor), y: designs.map((one) => of(one, up) / up.factor) });
    /* Designs of a very bad objective would press the others to the axis: the better half is drawn. */
    const found = cloud.filter(Boolean), half = up.name === "objective" ? [...found].sort((a, b) => a.objective - b.objective)[found.length >> 1] : null;
    const every = half ? found.filter((one) => one.objective <= half.objective || one.violation <= 1e-6) : found;
    const without = half ? "; of those that fail a requirement only those in the better half of the objective are drawn" : "";
    place("sample").textContent = `${every.length} of ${found.length} designs${without}`;
    if (charts.cloud) charts.cloud.u.destroy();
    const axis = ({ label, symbol }) => ({ label, unit: pretty(symbol) });
    charts.cloud = build({ id: "now_cloud", x: { ...axis(across), log: across.log }, y: axis(up), groups: [
      group("fails a requirement", "#b5bcc2", 3, every.filter((one) => one.violation > 1e-6)),
      group("meets all requirements", "#56b4e9", 4, every.filter((one) => one.violation <= 1e-6)),
      group("through the present design", "#0072b2", 3, curve),
      ...model.marks.map(({ label, colour }) => group(dated(label), colour, 8, marks.filter((one) => one.label === label))),
      ...(best ? [group(dated(model.known), "#000000", 11, [best])] : []), group(nowName(), "#d55e00", 10, [now])].filter((one) => one.x.length) });
  }
  place("now_cloud").addEventListener("click", (event) => {
    if (!(/** @type {any} */ (event.target).closest(".u-over"))) return;
    const { u } = charts.cloud, [across, up] = axes.map((select) => columns[select.value]), at = u.over.getBoundingClientRect();
    const far = (one) => Math.hypot(u.valToPos(of(one, across) / across.factor, "x") + at.left - event.clientX,
      u.valToPos(of(one, up) / up.factor, "y") + at.top - event.clientY);
    const near = [...cloud.filter(Boolean), ...marks, ...(best ? [best] : [])].reduce((a, b) => !a || far(b) < far(a) ? b : a, null);
    if (near && far(near) < 25) take(x.map((v, k) => variables.includes(k) ? near.x[k] : v));
  });
  place("now_cloud").hidden = !variables.length;
  new IntersectionObserver((entries) => {
    if (seen || !entries.some((one) => one.isIntersecting)) return;
    seen = true;
    if (now) later();
  }).observe(place("now_cloud"));

  /* What leaves the page: the command, the problem file, tables, the solid. */
  const written = (k) => `${Number((now.x[k] / inputs[k].factor).toPrecision(15))}${inputs[k].symbol ? ` ${inputs[k].symbol}` : ""}`;
  const quoted = (word) => `'${word.replaceAll("'", "'\\''")}'`;
  /* Entries of problem files that switch effects as they are now. */
  const settings = () => switchedIn(now.effects).flatMap((k) => model.switches[k].settings);
  const command = () => [`plough-opt ${model.command} ${quoted(model.file)}`, ...model.overrides.map((one) => `--set ${quoted(one)}`),
    ...inputs.flatMap((one, k) => !(one.variable && model.certifies) && now.x[k] !== initial[k] && !settings().some(([key]) => key === one.name)
      ? [`--set ${quoted(`${one.name}="${written(k)}"`)}`] : []),
    ...settings().map(([key, v]) => `--set ${quoted(`${key}=${toml(v)}`)}`)].join(" ");
  const pairs = (table) => Object.entries(table).map(([key, v]) => `${JSON.stringify(key)} = ${toml(v)}`);
  const toml = (v) => Array.isArray(v) ? `[${v.map(toml).join(", ")}]`
    : v !== null && typeof v === "object" ? `{ ${pairs(v).join(", ")} }` : JSON.stringify(v);
  function problem() {
    const tables = structuredClone(model.tables);
    const put = (name, v) => { const path = name.split("."); path.slice(0, -1).reduce((table, key) => table[key] ??= {}, tables)[path[path.length - 1]] = v; };
    inputs.forEach((one, k) => {
      if (one.variable) tables.variables[one.name].guess = written(k);
      else if (now.x[k] !== initial[k]) put(one.name, one.symbol ? written(k) : now.x[k]);
    });
    for (const [key, v] of settings()) put(key, v);
    const plain = (v) => v === null || typeof v !== "object" || Array.isArray(v), entries = Object.entries(tables);
    return [...entries.filter(([, v]) => plain(v)).map(([key, v]) => `${key} = ${toml(v)}`),
      ...entries.filter(([, v]) => !plain(v)).flatMap(([key, v]) => ["", `[${key}]`, ...pairs(v)])].join("\n") + "\n";
  }
  function csv() {
    const names = Object.keys(now.rows), head = names.map((name) => `${name} [${model.units[name]}]`).join(",");
    return [head, ...Array.from(now.rows.time, (_, k) => names.map((name) => now.rows[name][k]).join(","))].join("\n") + "\n";
  }
  function stl() {
    /* As geometry.py draws the body between the faces. */
    const given = keyed(now.x), [angle, chisel, h] = ["share.wedge_angle", "share.chisel_angle", "share.height"].map((name) => given[name]);
    const slope = Math.tan(now.half_angle), ridge = h / Math.cos(chisel), width = ridge * Math.tan(angle);
    const half = Math.asin(Math.min(1, 2 * Math.PI * Math.cos(chisel) ** 3 * (slope / Math.tan(angle)) ** 2)) / 2;
    const [side, below] = [width * Math.sin(half), width * Math.cos(half)], end = [ridge * Math.cos(chisel), ridge * Math.sin(chisel)];
    const corner = [end[0] + below * Math.sin(chisel), end[1] - below * Math.cos(chisel)];
    const corners = [[0, 0, 0], [end[0], 0, end[1]], [corner[0], side, corner[1]], [corner[0], -side, corner[1]]];
    const facets = [[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]].map((three) => {
      const lines = three.map((k) => `vertex ${corners[k].map((x) => 1000 * x).join(" ")}`).join("\n");
      return `facet normal 0 0 0\nouter loop\n${lines}\nendloop\nendfacet`;
    });
    return `solid share\n${facets.join("\n")}\nendsolid share\n`;
  }
  /** Force and deflection of the present design and the pinned ones as curves in a frame, with the ends of the axes. */
  function svg() {
    const wide = 600, high = 220, duration = now.rows.time[now.rows.time.length - 1];
    const pictures = panels.map(([, panel], row) => {
      const curves = curvesOf(panel), every = curves.flatMap(({ design, name }) => [...design.rows[name]]);
      const low = Math.min(...every), size = Math.max(...every) - low || 1;
      const at = (t, v) => `${(60 + wide * t / duration).toFixed(1)},${(30 + row * (high + 60) + high * (1 - (v - low) / size)).toFixed(1)}`;
      const words = (px, py, anchor, label) => `<text x="${px}" y="${py}" text-anchor="${anchor}">${label}</text>`, top = 30 + row * (high + 60);
      const points = (rows, name) => [...rows.time].flatMap((t, i) => t <= duration ? [at(t, rows[name][i])] : []).join(" ");
      const drawn = curves.map(({ design, name, colour }) => `<polyline fill="none" stroke="${colour}" points="${points(design.rows, name)}"/>`);
      const about = [words(60, top - 8, "start", `${panel.label} [${panel.symbol}]`), words(55, top + 12, "end", number((low + size) / panel.factor)),
        words(55, top + high, "end", number(low / panel.factor)), words(60 + wide, top + high + 18, "end", `${number(duration)} s`)];
      return `<rect x="60" y="${top}" width="${wide}" height="${high}" fill="none" stroke="#888"/>${drawn.join("")}${about.join("")}`;
    });
    const size = `width="700" height="${panels.length * (high + 60) + 20}" font-family="sans-serif" font-size="13"`;
    return `<svg xmlns="http://www.w3.org/2000/svg" ${size}>${pictures.join("")}</svg>\n`;
  }
  function download(name, content) {
    const link = make("a", { href: URL.createObjectURL(new Blob([content], { type: "text/plain" })), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }
  const DO = {
    undo: () => history.back(),
    reset: () => take(initial),
    pin: () => { pins = [...pins, { ...now }].slice(-MOST_PINS); rebuild(); table(); },
    command: () => {
      place("command").select();
      document.execCommand("copy");
      place("status").textContent = `Copied: run it to compute ${model.certifies ? "the certified optimum" : "this with Python"}.`;
    },
    toml: () => download("design.toml", problem()), csv: () => download("design.csv", csv()),
    stl: () => download("share.stl", stl()), svg: () => download("design.svg", svg()),
    better: async () => {
      place("status").textContent = "Searching …";
      const { x: found, before, after, tried } = await slow("better", now.effects, now.x, variables);
      const better = after < before - 1e-9 * Math.abs(before);
      if (better) await take(found);
      const certain = model.file ? "the command below" : "design.solve()";
      place("status").textContent = `${better ? "A better design" : "No better design"} after ${tried} tries. `
        + `This search is local and certifies nothing: ${certain} does.`;
    },
  };
  section.addEventListener("click", ({ target }) => { const what = /** @type {any} */ (target).closest("[data-do]"); if (what) DO[what.dataset.do](); });
  section.addEventListener("keydown", (event) => {
    if (!event.ctrlKey || event.key !== "z" || /** @type {any} */ (event.target).type === "text") return;
    event.preventDefault();
    if (at) DO.undo();
  });
  if (single) {
    place("digits").value = String(Math.round(-Math.log10(error)));
    place("digits").addEventListener("input", () => { error = 10 ** -place("digits").value; ask(); });
  }

  const plain = ({ rows, requirements, ...rest }) => ({ ...rest, ...rows, requirements });
  Object.assign(window, { ploughOpt: {
    inputs, outputs: columns.slice(variables.length),
    evaluate: async (given = {}) => plain(await quick("evaluate", effects, requested(given), { error })),
    state: () => keyed(x),
    effects: () => Object.fromEntries(switches.map(({ label, box }) => [label, box.checked])),
    /* Switches an effect by its name. */
    switch: (name) => {
      const one = switches.find(({ label }) => label === name);
      if (!one || one.box.disabled) throw new RangeError(`"${name}" cannot be switched here`);
      one.box.click();
      return ask();
    },
    set: async (given) => {
      await take(requested(given), false);
      if (refused) throw new RangeError(refused);
      commit();
    },
  } });
  x = addressed();
  if (location.hash.startsWith("#explore")) section.scrollIntoView();
  (async () => {
    best = { x: initial, effects: "", ...await quick("evaluate", "", initial, { error }) };
    await take(x, false);
    const points = model.marks.flatMap(({ label, designs }) => designs.map((one) => ({ label, x: inputs.map(({ name }, k) => one[name] ?? initial[k]) })));
    const found = await slow("many", "", points.map((one) => one.x));
    marks = points.flatMap((one, k) => found[k] ? [{ ...one, ...found[k] }] : []);
    section.dataset.ready = "true";
  })();
})();
