"use strict";
/* The share, its cone and the compacted soil, drawn by OGL; turned by mouse, touch, keys and buttons. */
/** Draw bodies in a figure; return a function that draws others with the same names, or null without WebGL. */
function solidView(figure, first) {
  const canvas = figure.querySelector("canvas");
  const START = { turn: 2.25, tilt: 0.36, far: 0.8 };
  const view = { ...START };
  let renderer;
  try {
    renderer = new ogl.Renderer({ canvas, dpr: Math.min(2, devicePixelRatio), alpha: true, antialias: true, preserveDrawingBuffer: true });
    if (!renderer.gl) throw new Error("WebGL");
  } catch {
    canvas.hidden = true;
    figure.querySelector(".missing").hidden = false;
    return null;
  }
  const gl = renderer.gl;
  gl.clearColor(0.984, 0.988, 0.992, 1);
  const VERTEX = `attribute vec3 position, normal; uniform mat4 modelViewMatrix, projectionMatrix; uniform mat3 normalMatrix;
    varying vec3 n; void main() { n = normalMatrix * normal; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`;
  const FRAGMENT = `precision highp float; varying vec3 n; uniform vec3 colour; uniform float opacity, lit;
    void main() { vec3 m = normalize(gl_FrontFacing ? n : -n);
      float light = 0.74 + 0.34 * max(0.0, dot(m, normalize(vec3(-0.6, 0.5, 0.6)))) + 0.12 * max(0.0, m.y);
      gl_FragColor = vec4(mix(colour, colour * light, lit), opacity); }`;
  const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);
  const programs = {};
  const material = (colour, opacity, lit) => programs[colour + opacity + lit] ||= new ogl.Program(gl, {
    vertex: VERTEX, fragment: FRAGMENT, transparent: opacity < 1, cullFace: false,
    depthWrite: opacity === 1, uniforms: { colour: { value: rgb(colour) }, opacity: { value: opacity }, lit: { value: lit } } });

  /* The data has z up; the picture y. Triangles have corners of their own, and normals of the face or, on cones, of the surface. */
  const at = (body, k) => [body.vertices[3 * k], body.vertices[3 * k + 2], -body.vertices[3 * k + 1]];
  const geometry = (position, normal) => new ogl.Geometry(gl, {
    position: { size: 3, data: new Float32Array(position) }, normal: { size: 3, data: new Float32Array(normal) } });
  const lines = (position) => new ogl.Mesh(gl, {
    mode: gl.LINES, geometry: geometry(position, Array(position.length).fill(0.5)), program: material("#12202c", 1, 0) });
  function mesh(body) {
    const position = [], normal = [];
    for (let t = 0; t < body.triangles.length; t += 3) {
      const p = [0, 1, 2].map((k) => at(body, body.triangles[t + k]));
      const [a, b] = [1, 2].map((k) => p[k].map((x, i) => x - p[0][i]));
      const n = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
      for (const q of p) { position.push(...q); normal.push(...n); }
    }
    const made = new ogl.Mesh(gl, { geometry: geometry(position, normal), program: material(body.colour, body.opacity, 1) });
    if (body.edges.length) {
      lines(body.edges.flatMap((k) => at(body, k))).setParent(made);
    }
    return made;
  }
  const shown = {};
  let scene = new ogl.Transform(), size = 0;
  function extent(body, k) {
    const along = body.vertices.filter((_, i) => i % 3 === k);
    return [Math.min(...along), Math.max(...along)];
  }
  function fill(bodies) {
    scene.traverse((one) => { if (one.geometry) one.geometry.remove(); });
    scene = new ogl.Transform();
    const wedge = bodies.find((b) => b.id === "share"), round = bodies.filter((b) => b.id !== "share");
    const reach = Math.max(...round.map((b) => extent(b, 1)[1]));
    const half = wedge ? extent(wedge, 1)[1] : 0, gap = wedge ? half + reach + 0.5 * reach : 0;
    for (const body of bodies) {
      const made = mesh(body);
      made.visible = shown[body.id]?.visible ?? true;
      shown[body.id] = made;
      const [low, high] = extent(body, 0), [down, up] = extent(body, 2);
      made.position.set(-(low + high) / 2, body.id === "share" ? -(down + up) / 2 : 0, body.id === "share" ? gap / 2 : -gap / 2);
      made.setParent(scene);
    }
    /* An arrow along the direction of travel, between the bodies. */
    const long = Math.max(...bodies.map((b) => extent(b, 0)[1])), above = 1.05 * reach, head = 0.08 * long;
    const places = [[0.4, 0], [-0.5, 0], [-0.5, 0], [-0.5 + head / long, 0.5 * head], [-0.5, 0], [-0.5 + head / long, -0.5 * head]];
    lines(places.flatMap(([x, z]) => [x * long, above, z])).setParent(scene);
    /* The largest bodies so far decide the scale, so that later ones are seen to grow and shrink. */
    size = Math.max(size, Math.hypot(Math.max(...bodies.map((b) => extent(b, 0)[1])), gap + half + reach, 2 * reach) / 2);
  }
  fill(first);
  const camera = new ogl.Camera(gl, { fov: 28, near: 0.01 * size, far: 40 * size });

  function draw() {
    const width = canvas.clientWidth, height = canvas.clientHeight;
    renderer.setSize(width, height);
    canvas.style.width = canvas.style.height = "";
    const away = view.far * size / Math.sin(14 * Math.PI / 180) * Math.max(1, 1.45 * height / width);
    camera.perspective({ aspect: width / height });
    const flat = away * Math.cos(view.tilt), turn = view.turn - Math.PI / 2;
    camera.position.set(flat * Math.sin(turn), away * Math.sin(view.tilt), flat * Math.cos(turn));
    camera.lookAt([0, 0, 0]);
    renderer.render({ scene, camera });
    figure.dataset.view = [view.turn, view.tilt, view.far].map((v) => v.toFixed(3)).join(" ");
  }
  const MOVES = { left: () => view.turn += 0.12, right: () => view.turn -= 0.12, up: () => view.tilt += 0.1, down: () => view.tilt -= 0.1,
    in: () => view.far *= 0.9, out: () => view.far /= 0.9, reset: () => Object.assign(view, START) };
  function move(name) {
    MOVES[name]();
    view.tilt = Math.max(-1.5, Math.min(1.5, view.tilt));
    view.far = Math.max(0.3, Math.min(4, view.far));
    draw();
  }
  const KEYS = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", "+": "in", "=": "in", "-": "out", 0: "reset" };
  figure.addEventListener("keydown", (event) => {
    if (event.target.closest("input, button") || !(event.key in KEYS)) return;
    event.preventDefault();
    move(KEYS[event.key]);
  });
  figure.querySelectorAll("[data-turn]").forEach((button) => button.addEventListener("click", () => move(button.dataset.turn)));
  figure.querySelectorAll("[data-body]").forEach((box) => box.addEventListener("change", () => { shown[box.dataset.body].visible = box.checked; draw(); }));
  let held = null;
  canvas.addEventListener("pointerdown", (event) => { held = event; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    view.turn -= 0.01 * (event.clientX - held.clientX);
    if (event.pointerType === "mouse") view.tilt = Math.max(-1.5, Math.min(1.5, view.tilt + 0.01 * (event.clientY - held.clientY)));
    held = event;
    draw();
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { held = null; });
  canvas.addEventListener("wheel", (event) => { if (event.ctrlKey) { event.preventDefault(); move(event.deltaY < 0 ? "in" : "out"); } }, { passive: false });
  new ResizeObserver(draw).observe(canvas);
  draw();
  return (bodies) => { fill(bodies); draw(); };
}
solidView(document.getElementById("solid"), DATA.bodies);
