"use strict";
/* Draws the run, and lets the page point to times: href="#t=1.25", rows with data-t, plots with data-axes. */
document.addEventListener("DOMContentLoaded", () => {
  const data = JSON.parse(document.getElementById("replay-data").textContent);
  const box = document.getElementById("replay-box"), find = (what) => box.querySelector(what);
  const canvas = find("canvas"), slider = find("input"), output = find("output"), labels = find(".labels");
  const gl = canvas.getContext("webgl2", {antialias: true, preserveDrawingBuffer: true});
  const end = data.t[data.t.length - 1];
  let now = 0, playing = false, dirty = true;

  /* Time, whoever sets it: the slider, a link, a plot, a row, the clock. */
  const lines = [];
  const go = (t) => {
    now = Math.min(Math.max(t, 0), end);
    slider.value = now;
    output.textContent = now.toFixed(2) + " s";
    find(".said").textContent = data.said[frame()];
    for (const line of lines) line(now);
    dirty = true;
  };
  const frame = () => Math.round(now / end * (data.t.length - 1));
  const show = (t) => { play(false); go(t); box.scrollIntoView({block: "nearest"}); };
  const play = (on) => { playing = on; find("[data-do=play]").textContent = on ? "⏸" : "▶"; };
  const hash = () => { const m = /^#t=([0-9.]+)$/.exec(location.hash); if (m) show(+m[1]); };
  slider.max = end;
  slider.addEventListener("input", () => { play(false); go(+slider.value); });
  addEventListener("hashchange", hash);

  /* Of plots: which time lies below a pointer, and a line at the time that is shown. */
  const stepped = (step) => {
    const k = data.steps.findIndex(([n]) => n >= step), b = data.steps[k < 0 ? data.steps.length - 1 : k];
    const a = data.steps[Math.max(0, (k < 0 ? data.steps.length : k) - 1)];
    return b[0] === a[0] ? b[1] : a[1] + (b[1] - a[1]) * Math.min(1, Math.max(0, (step - a[0]) / (b[0] - a[0])));
  };
  const step_at = (t) => {
    const k = data.steps.findIndex(([, s]) => s > t);
    if (k <= 0) return k < 0 ? data.steps[data.steps.length - 1][0] : data.steps[0][0];
    const [[m, a], [n, b]] = [data.steps[k - 1], data.steps[k]];
    return m + (n - m) * (t - a) / (b - a);
  };
  for (const plot of document.querySelectorAll("[data-axes]")) {
    const tip = plot.appendChild(document.createElement("span"));
    tip.className = "tip"; tip.hidden = true;
    const panels = JSON.parse(plot.dataset.axes).filter((a) => a.kind === "time" || data.steps.length > 1);
    for (const {kind, box: [x, y, w, h], from, to} of panels) {
      const mark = plot.appendChild(document.createElement("i"));
      mark.className = "now";
      mark.style.top = 100 * y + "%"; mark.style.height = 100 * h + "%";
      lines.push((t) => {
        const share = ((kind === "step" ? step_at(t) : t) - from) / (to - from);
        mark.hidden = share < 0 || share > 1;
        mark.style.left = 100 * (x + share * w) + "%";
      });
    }
    const at = (event) => {
      const r = plot.getBoundingClientRect(), px = (event.clientX - r.left) / r.width, py = (event.clientY - r.top) / r.height;
      for (const {kind, box: [x, y, w, h], from, to} of panels)
        if (px >= x && px <= x + w && py >= y && py <= y + h) {
          const value = from + (to - from) * (px - x) / w;
          return kind === "step" ? stepped(Math.round(value)) : Math.max(0, value);
        }
      return null;
    };
    plot.addEventListener("pointermove", (event) => {
      const t = at(event), r = plot.getBoundingClientRect();
      tip.hidden = t === null;
      plot.style.cursor = t === null ? "" : "pointer";
      if (t !== null) { tip.textContent = t.toFixed(2) + " s"; tip.style.left = event.clientX - r.left + "px"; tip.style.top = event.clientY - r.top + "px"; }
    });
    plot.addEventListener("pointerleave", () => { tip.hidden = true; });
    plot.addEventListener("click", (event) => { const t = at(event); if (t !== null) show(t); });
  }
  for (const row of document.querySelectorAll("[data-t]"))
    row.addEventListener("click", (event) => { if (!event.target.closest("details, a")) show(+row.dataset.t); });
  if (!gl) { go(0); hash(); return; }
  box.classList.add("works");
  find(".controls").hidden = false;

  /* Arrays. */
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const metres = (text) => Float32Array.from(new Int16Array(bytes(text)), (v) => v / 1e3);
  const rgb = (text) => [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16) / 255);
  const shader = (kind, text) => {
    const s = gl.createShader(kind);
    gl.shaderSource(s, "#version 300 es\nprecision highp float;\n" + text); gl.compileShader(s);
    return s;
  };
  const program = (vertex, fragment) => {
    const p = gl.createProgram();
    gl.attachShader(p, shader(gl.VERTEX_SHADER, vertex)); gl.attachShader(p, shader(gl.FRAGMENT_SHADER, fragment));
    gl.bindAttribLocation(p, 0, "at"); gl.bindAttribLocation(p, 1, "p"); gl.linkProgram(p);
    return (name) => name ? gl.getUniformLocation(p, name) : gl.useProgram(p);
  };
  const solid = program(
    "in vec3 at; uniform mat4 view, pose; out vec3 seen; void main() { vec4 w = pose * vec4(at, 1.); seen = w.xyz; gl_Position = view * w; }",
    "in vec3 seen; uniform vec3 eye; uniform vec4 colour; out vec4 o; void main() {" +
    " vec3 n = normalize(cross(dFdx(seen), dFdy(seen)));" +
    " o = vec4(colour.rgb * (colour.a < 1. ? 1. : .45 + .55 * abs(dot(n, normalize(eye - seen)))), 1.) * colour.a; }");
  const cloud = program(
    "in vec3 at; in float p; uniform mat4 view; uniform float size, least; out float q; void main() { q = p;" +
    " gl_Position = p < least ? vec4(2., 2., 2., 1.) : view * vec4(at, 1.); gl_PointSize = size / gl_Position.w; }",
    "in float q; out vec4 o; void main() { vec3 a = vec3(.992,.953,.882), b = vec3(.941,.627,.294), c = vec3(.612,.165,.063);" +
    " o = vec4(q < .5 ? mix(a, b, 2. * q) : mix(b, c, 2. * q - 1.), 1.); }");
  const buffer = (array) => { const b = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, b); gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW); return b; };
  const mesh = ({at, colour}) => { const v = metres(at); return {buffer: buffer(v), n: v.length / 3, colour: rgb(colour)}; };
  const still = data.still.map(mesh);
  const moving = ["robot", "ghost", "people"].map((name) => {
    const meshes = data[name].meshes.map(mesh);
    return {name, meshes, poses: new Float32Array(bytes(data[name].poses))};
  });
  moving[1].meshes = moving[0].meshes;
  const clouds = data.occupancy.map(({t, at, p}) => {
    const v = metres(at);
    return {t, n: v.length / 3, at: buffer(v), p: buffer(new Uint8Array(bytes(p)))};
  });
  const ball = (() => {  /* an octahedron with its faces cut once: enough for a dot */
    let faces = [];
    for (const x of [-1, 1]) for (const y of [-1, 1]) for (const z of [-1, 1]) faces.push([[x, 0, 0], [0, y, 0], [0, 0, z]]);
    const unit = (v) => { const l = Math.hypot(...v); return v.map((c) => c / l); };
    const mid = (a, b) => unit(a.map((c, k) => c + b[k]));
    for (let i = 0; i < 2; i++) faces = faces.flatMap(([a, b, c]) => { const [d, e, f] = [mid(a, b), mid(b, c), mid(c, a)]; return [[a, d, f], [d, b, e], [f, e, c], [d, e, f]]; });
    const v = new Float32Array(faces.flat(2).map((c) => 0.025 * c));
    return {buffer: buffer(v), n: v.length / 3};
  })();
  for (const {name} of data.tasks) labels.appendChild(document.createElement("span")).textContent = name;

  /* The camera turns about the middle of the tasks. */
  let target = data.middle.slice(), turn = 0, tilt = 0.4, away = 2.5;
  const look = (name) => {
    const [a, l, u] = data.views[name], [x, y] = data.ahead, d = [a * x - l * y, a * y + l * x, u];
    target = data.middle.slice(); away = Math.hypot(...d); turn = Math.atan2(d[1], d[0]); tilt = Math.asin(d[2] / away); dirty = true;
  };
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const camera = () => {
    const back = [Math.cos(tilt) * Math.cos(turn), Math.cos(tilt) * Math.sin(turn), Math.sin(tilt)];
    const right = [-Math.sin(turn), Math.cos(turn), 0], up = cross(back, right);
    const eye = back.map((c, k) => target[k] + away * c), f = 1 / Math.tan(0.45), near = 0.05, far = 60;
    const aspect = canvas.width / canvas.height, w = Math.min(1, aspect / 1.3) * f, m = [];
    const A = (far + near) / (near - far), B = 2 * far * near / (near - far);
    for (let k = 0; k < 3; k++) m.push(w / aspect * right[k], w * up[k], A * back[k], -back[k]);
    m.push(-w / aspect * dot(right, eye), -w * dot(up, eye), -A * dot(back, eye) + B, dot(back, eye));
    return {eye, view: new Float32Array(m), scale: w};
  };
  const group = (name, entries, act) => entries.forEach((entry) => {
    const b = find(`[data-list=${name}]`).appendChild(document.createElement("button"));
    b.type = "button"; b.textContent = entry; act(b, entry);
  });
  const shown = {robot: true, ghost: true, people: true, occupancy: true};
  group("views", Object.keys(data.views), (b, name) => b.addEventListener("click", () => look(name)));
  group("layers", Object.keys(shown), (b, name) => {
    if (name === "ghost") b.textContent = "going to";
    b.ariaPressed = "true";
    b.addEventListener("click", () => { shown[name] = !shown[name]; b.ariaPressed = String(shown[name]); dirty = true; });
  });
  const threshold = find("[name=threshold]");
  threshold.addEventListener("input", () => { dirty = true; });
  const pointers = new Map();
  let apart = 0;
  canvas.addEventListener("pointerdown", (e) => { canvas.setPointerCapture(e.pointerId); pointers.set(e.pointerId, e); apart = 0; });
  for (const up of ["pointerup", "pointercancel"]) canvas.addEventListener(up, (e) => pointers.delete(e.pointerId));
  canvas.addEventListener("pointermove", (e) => {
    const before = pointers.get(e.pointerId);
    if (!before) return;
    if (pointers.size === 1) {
      turn -= 0.008 * (e.clientX - before.clientX);
      tilt = Math.min(1.57, Math.max(-1.2, tilt + 0.008 * (e.clientY - before.clientY)));
    }
    pointers.set(e.pointerId, e);
    if (pointers.size === 2) {
      const [a, b] = [...pointers.values()], d = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
      if (apart) away *= apart / d;
      apart = d;
    }
    dirty = true;
  });
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); away = Math.min(12, Math.max(0.4, away * Math.exp(0.001 * e.deltaY))); dirty = true; }, {passive: false});
  find("[data-do=play]").addEventListener("click", () => { if (!playing && now >= end) go(0); play(!playing); });
  for (const [name, way] of [["back", -1], ["next", 1]]) find(`[data-do=${name}]`).addEventListener("click", () => {
    const turns = data.turns.filter(([t]) => way * (t - now) > 1e-3), found = way > 0 ? turns[0] : turns[turns.length - 1];
    play(false);
    if (found) go(found[0]);
    find(".said").textContent = found ? `${found[0].toFixed(2)} s: ${found[1]}` : "no switch and no hold there";
  });

  const identity = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);
  const path = gl.createBuffer();
  const draw = () => {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    canvas.width = Math.max(1, canvas.clientWidth * ratio); canvas.height = Math.max(1, canvas.clientHeight * ratio);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.933, 0.945, 0.957, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    const {eye, view, scale} = camera(), k = frame();
    solid(); gl.uniformMatrix4fv(solid("view"), false, view); gl.uniform3fv(solid("eye"), eye);
    const put = ({buffer: b, n}, colour, opacity, pose = identity, kind = gl.TRIANGLES) => {
      gl.uniformMatrix4fv(solid("pose"), false, pose); gl.uniform4fv(solid("colour"), [...colour, opacity]);
      gl.bindBuffer(gl.ARRAY_BUFFER, b); gl.enableVertexAttribArray(0); gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
      gl.drawArrays(kind, 0, n);
    };
    for (const m of still) put(m, m.colour, 1);
    for (const {at, colour} of data.tasks) put(ball, rgb(colour), 1, new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, ...at, 1]));
    const go_through = ({name, meshes, poses}, opacity) => {
      if (shown[name]) meshes.forEach((m, i) => {
        const a = poses.subarray(12 * (k * meshes.length + i), 12 * (k * meshes.length + i + 1));
        if (m.n && !Number.isNaN(a[0]))
          put(m, m.colour, opacity, new Float32Array([a[0], a[4], a[8], 0, a[1], a[5], a[9], 0, a[2], a[6], a[10], 0, a[3], a[7], a[11], 1]));
      });
    };
    go_through(moving[0], 1); go_through(moving[2], 1);
    if (shown.ghost && data.paths[k]) {
      const v = metres(data.paths[k]);
      gl.bindBuffer(gl.ARRAY_BUFFER, path); gl.bufferData(gl.ARRAY_BUFFER, v, gl.DYNAMIC_DRAW);
      put({buffer: path, n: v.length / 3}, rgb(data.ink), 1, identity, gl.LINE_STRIP);
    }
    const seen = clouds.filter(({t}) => t <= now + 1e-6).pop();
    if (shown.occupancy && seen) {
      cloud(); gl.uniformMatrix4fv(cloud("view"), false, view);
      gl.uniform1f(cloud("size"), 0.5 * data.voxel * scale * canvas.height / 2); gl.uniform1f(cloud("least"), +threshold.value);
      gl.bindBuffer(gl.ARRAY_BUFFER, seen.at); gl.enableVertexAttribArray(0); gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
      gl.bindBuffer(gl.ARRAY_BUFFER, seen.p); gl.enableVertexAttribArray(1); gl.vertexAttribPointer(1, 1, gl.UNSIGNED_BYTE, true, 0, 0);
      gl.drawArrays(gl.POINTS, 0, seen.n);
      gl.disableVertexAttribArray(1);
    }
    solid(); gl.enable(gl.BLEND); gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA); gl.depthMask(false);
    go_through(moving[1], 0.3);
    gl.depthMask(true); gl.disable(gl.BLEND);
    data.tasks.forEach(({at}, i) => {
      const c = [0, 1, 3].map((r) => view[r] * at[0] + view[4 + r] * at[1] + view[8 + r] * at[2] + view[12 + r]), l = labels.children[i];
      l.style.left = 50 * (1 + c[0] / c[2]) + "%"; l.style.top = 50 * (1 - c[1] / c[2]) + "%"; l.hidden = c[2] <= 0;
    });
  };
  let last = performance.now();
  const tick = (at) => {
    if (playing) { go(now + (at - last) / 1e3 * +find("select").value); if (now >= end) play(false); }
    last = at;
    if (dirty) { dirty = false; draw(); }
    requestAnimationFrame(tick);
  };
  new ResizeObserver(() => { dirty = true; }).observe(canvas);
  look(Object.keys(data.views)[0]); go(0); hash(); draw(); requestAnimationFrame(tick);
});
