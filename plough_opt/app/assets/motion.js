"use strict";
/* The share behind its strut as it moves through soil whose strength varies along the path. */
(() => {
  const figure = document.getElementById("motion");
  if (!figure) return;
  const own = DATA.motion, canvas = figure.querySelector("canvas"), ctx = canvas.getContext("2d");
  /** @type {any[]} */
  const [button, slider, output, speed] = ["button", "input", "output", "select"].map((tag) => figure.querySelector(tag));
  const last = own.time.length - 1, end = own.time[last];
  const most = Math.max(...own.deflection.map(Math.abs)) || 1;
  let now = 0, playing = false, before = 0;

  const between = (values, t) => {
    let low = 0, high = last;
    while (high - low > 1) { const middle = (low + high) >> 1; if (own.time[middle] <= t) low = middle; else high = middle; }
    const part = Math.min(1, Math.max(0, (t - own.time[low]) / (own.time[high] - own.time[low] || 1)));
    return values[low] + part * (values[high] - values[low]);
  };
  const strength = (x) => own.waves.reduce((sum, w) => sum + w.amplitude * Math.sin(2 * Math.PI * x / w.wavelength + w.phase), 1);

  function draw() {
    const ratio = devicePixelRatio, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio; canvas.height = height * ratio;
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    const scale = Math.min(0.34 * width / own.height, 0.26 * height / Math.max(own.radius, own.front, 0.2 * own.height));
    const strut = between(own.strut, now), z = between(own.deflection, now);
    const larger = Math.max(1, Math.min(20, 0.16 * width / (most * scale)));
    const axis = 0.66 * height, mount = 0.62 * width, ground = 0.30 * height;
    /* The strut stands still in the picture; the soil passes. */
    const soilAt = (px) => strut + (px - mount) / scale;
    for (let px = 0; px < width; px += 3) {
      const s = strength(soilAt(px + 1.5)), shade = Math.round(226 - 60 * Math.max(-1, Math.min(1, s - 1)));
      ctx.fillStyle = `rgb(${shade}, ${shade - 22}, ${shade - 52})`;
      ctx.fillRect(px, ground, 3, height - ground);
    }
    const tip = mount - z * larger * scale, back = tip - own.height * scale;
    ctx.fillStyle = "#00000022";
    const wedge = (half) => {
      ctx.beginPath(); ctx.moveTo(tip, axis); ctx.lineTo(back, axis - half * scale); ctx.lineTo(back, axis + half * scale);
      ctx.closePath(); ctx.fill();
    };
    if (own.front) wedge(own.front);
    ctx.fillStyle = "#0072b2"; ctx.strokeStyle = "#12202c"; ctx.lineWidth = 1.5;
    wedge(own.radius); ctx.stroke();
    /* The mount bends from the frame down to the share. */
    const foot = back + 0.3 * own.height * scale, head = mount - 0.7 * own.height * scale;
    ctx.lineWidth = 6; ctx.strokeStyle = "#5b6874"; ctx.lineCap = "round";
    ctx.beginPath(); ctx.moveTo(head, 26); ctx.bezierCurveTo(head, 0.5 * axis, foot, 0.5 * axis, foot, axis - 0.7 * own.radius * scale * 0.7); ctx.stroke();
    ctx.fillStyle = "#1b2733"; ctx.fillRect(head - 0.16 * width, 14, 0.32 * width, 14);
    ctx.setLineDash([4, 4]); ctx.lineWidth = 1; ctx.strokeStyle = "#1b2733";
    ctx.beginPath(); ctx.moveTo(mount, ground - 6); ctx.lineTo(mount, height); ctx.stroke(); ctx.setLineDash([]);
    ctx.font = "13px system-ui, sans-serif"; ctx.fillStyle = "#1b2733"; ctx.textAlign = "left";
    ctx.fillText("tip without load", Math.min(mount + 6, width - 100), height - 8);
    ctx.fillText(`travel →`, 10, 24);
    if (own.waves.length) ctx.fillText("darker: stronger soil", 10, height - 8);
    const shown = z / own.unit.factor;
    output.textContent = `${now.toFixed(3)} s, deflection ${+shown.toPrecision(3)} ${own.unit.symbol}`;
    slider.value = Math.round(1000 * now / end);
    figure.dataset.time = now.toFixed(4);
    const magnified = larger > 1.05 ? `, deflection magnified ${larger.toPrecision(2)} times` : "";
    figure.querySelector("figcaption").textContent = `Motion of the share behind its strut${magnified}`;
  }
  function step(stamp) {
    if (!playing) return;
    now += (stamp - before) / 1000 * Number(speed.value);
    before = stamp;
    if (now > end) now = 0;
    draw();
    requestAnimationFrame(step);
  }
  function play(on) {
    playing = on;
    button.textContent = on ? "Stop" : "Play";
    if (on) { before = performance.now(); requestAnimationFrame(step); }
  }
  const to = (t) => { now = Math.max(0, Math.min(end, t)); draw(); };
  button.addEventListener("click", () => play(!playing));
  slider.addEventListener("input", () => { play(false); to(slider.value / 1000 * end); });
  figure.addEventListener("keydown", (event) => {
    if (event.target !== figure) return;
    if (event.key === " ") play(!playing);
    else if (event.key === "ArrowRight") to(now + end / 200);
    else if (event.key === "ArrowLeft") to(now - end / 200);
    else return;
    event.preventDefault();
  });
  new ResizeObserver(draw).observe(canvas);
  draw();
})();
