"use strict";
/* Charts over time and point clouds, drawn by uPlot; values are read off by mouse, touch and arrow keys. */
const DATA = JSON.parse(document.getElementById("data").textContent);

const FONT = "12px system-ui, sans-serif";
const number = (v) => v == null ? "–" : Math.abs(v) >= 1e-3 && Math.abs(v) < 1e5 || v === 0 ? String(+v.toPrecision(4)) : v.toExponential(1);
const withUnit = (v, unit) => unit ? `${number(v)} ${unit}` : number(v);
const heading = (axis) => axis.unit ? `${axis.label} [${axis.unit}]` : axis.label;

/* A band behind everything. */
function band(ends) {
  return (u) => {
    if (ends.length < 2) return;
    const { ctx, bbox } = u, [low, high] = ends.map((v) => u.valToPos(v, "y", true));
    ctx.save();
    ctx.fillStyle = "#00000012";
    ctx.fillRect(bbox.left, high, bbox.width, low - high);
    ctx.restore();
  };
}

/* Horizontal lines, each with its name at the right end. */
function lines(own) {
  return (u) => {
    const { ctx, bbox } = u;
    ctx.save();
    for (const line of own) {
      const y = u.valToPos(line.value, "y", true);
      if (!(y >= bbox.top - 1 && y <= bbox.top + bbox.height + 1)) continue;
      ctx.strokeStyle = ctx.fillStyle = line.colour;
      ctx.lineWidth = 1.5 * devicePixelRatio;
      ctx.setLineDash(line.dash ? [6 * devicePixelRatio, 4 * devicePixelRatio] : []);
      ctx.beginPath(); ctx.moveTo(bbox.left, y); ctx.lineTo(bbox.left + bbox.width, y); ctx.stroke();
      ctx.font = `${12 * devicePixelRatio}px system-ui, sans-serif`;
      ctx.textAlign = "right";
      const text = line.label, width = ctx.measureText(text).width;
      const below = y - bbox.top < 18 * devicePixelRatio, place = y + (below ? 14 : -5) * devicePixelRatio;
      ctx.fillStyle = "#ffffffcc";
      ctx.fillRect(bbox.left + bbox.width - width - 6 * devicePixelRatio, place - 11 * devicePixelRatio, width + 6 * devicePixelRatio, 14 * devicePixelRatio);
      ctx.fillStyle = line.colour;
      ctx.fillText(text, bbox.left + bbox.width - 3 * devicePixelRatio, place);
    }
    ctx.restore();
  };
}

/* One column of x for all groups of points, with gaps where a group has none. */
function joined(groups) {
  const rows = groups.flatMap((group, k) => group.x.map((x, i) => [x, k, group.y[i]])).sort((a, b) => a[0] - b[0]);
  return [rows.map(([x]) => x), ...groups.map((_, k) => rows.map(([, own, y]) => own === k ? y : null))];
}

function range(chart) {
  return (u, low, high) => {
    if (low == null) [low, high] = [0, 1];
    for (const line of chart.lines || []) { low = Math.min(low, line.value); high = Math.max(high, line.value); }
    const room = 0.08 * (high - low) || 0.1 * Math.abs(high) || 1;
    return [low - room, high + room];
  };
}

function build(chart) {
  const figure = /** @type {any} */ (document.getElementById(chart.id)), plot = figure.querySelector(".plot"), read = figure.querySelector(".read");
  const cloud = chart.groups && joined(chart.groups);
  const data = cloud ?? [chart.x.values, ...chart.series.map((one) => one.values)];
  const series = cloud
    ? chart.groups.map((group) => ({ label: group.label, stroke: group.colour, paths: () => null,
        points: { show: true, size: group.size, width: 0, fill: group.colour, stroke: group.colour } }))
    : chart.series.map((one) => ({ label: one.label, stroke: one.colour, width: 1.6, dash: one.dash ? [6, 4] : undefined, points: { show: false } }));
  /* Of many decades every second, third or so has a line and a number; of few also 2 and 5 have numbers. */
  const decades = (u, ticks) => {
    const found = ticks.map((v) => Math.log10(v)).filter((e) => Math.abs(e - Math.round(e)) < 1e-9).map(Math.round);
    const step = Math.ceil(found.length / 6);
    return ticks.map((v) => {
      const e = Math.log10(v), whole = Math.abs(e - Math.round(e)) < 1e-9;
      return whole ? (Math.round(e) % step === 0 ? v : null) : found.length <= 2 && /^[25]e/.test(v.toExponential()) ? v : null;
    });
  };
  const sparse = (own) => own.log ? { filter: decades } : {};
  const axis = (own) => ({ label: heading(own), labelFont: FONT, font: FONT, stroke: "#1b2733", labelSize: 18, size: 34, labelGap: 0, ...sparse(own),
    grid: { stroke: "#e6eaee", width: 1, ...sparse(own) }, ticks: { stroke: "#c4ccd3", width: 1, size: 5, ...sparse(own) },
    values: (u, ticks) => ticks.map((v) => v == null ? "" : !own.log ? String(+v.toPrecision(6))
      : v < 0.01 ? v.toExponential(0) : String(+v.toPrecision(2))) });
  const height = () => plot.clientWidth > 600 ? 300 : 250;
  const u = new uPlot({
    width: plot.clientWidth, height: height(), legend: { show: true, live: false,
      markers: { width: 0, fill: (u, k) => cloud ? chart.groups[k - 1].colour : chart.series[k - 1].colour } },
    scales: { x: { time: false, distr: chart.x.log ? 3 : 1 }, y: { range: range(chart) } },
    axes: [axis(chart.x), { ...axis(chart.y), size: 62 }],
    series: [{ label: heading(chart.x) }, ...series],
    cursor: { drag: { setScale: false }, points: { size: 9 }, focus: { prox: -1 } },
    hooks: { drawClear: [band(chart.band || [])], draw: [lines(chart.lines || [])], setCursor: [say] },
  }, data, plot);

  function say(u) {
    const i = u.cursor.idx;
    if (i == null) { read.textContent = "Point at the picture, or use the arrow keys, to read values off."; return; }
    const parts = series.flatMap(({ label }, k) => data[k + 1][i] == null ? [] : [`${label} ${withUnit(data[k + 1][i], chart.y.unit)}`]);
    read.textContent = `${chart.x.label} ${withUnit(data[0][i], chart.x.unit)}: ${parts.join(", ")}`;
  }
  say(u);
  figure.addEventListener("keydown", (event) => {
    const last = data[0].length - 1, step = event.shiftKey ? 10 : 1;
    const now = u.cursor.idx ?? -1;
    const to = { ArrowRight: now + step, ArrowLeft: now < 0 ? last : now - step, Home: 0, End: last }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    const i = Math.max(0, Math.min(last, to));
    const first = series.findIndex((_, k) => data[k + 1][i] != null);
    u.setCursor({ left: u.valToPos(data[0][i], "x"), top: u.valToPos(data[first + 1][i], "y") });
  });
  const fit = (width) => u.setSize({ width, height: height() });
  new ResizeObserver(() => { if (plot.clientWidth && plot.clientWidth !== u.width) fit(plot.clientWidth); }).observe(plot);
  figure.uplot = u;
  return { chart, u, fit };
}

const CHARTS = [...DATA.charts, ...DATA.front].map(build);

/* Paper is narrower than most screens: A4 within its margins is 672 px wide. */
addEventListener("beforeprint", () => CHARTS.forEach(({ chart, fit }) => fit(chart.id === "force" ? 660 : 320)));
addEventListener("afterprint", () => CHARTS.forEach(({ u, fit }) => fit(u.root.parentNode.clientWidth)));
