"use strict";
// Choose a vertex on one of two shapes: its images light up on the other. Everything shown was computed before.
// One WebGL context draws for all explorers of a page, onto 2-D canvases that carry the marks. For two cats of 5,000
// vertices at 390 px the script works 1 to 16 ms a frame; triangles sorted and filled on the canvas, which stand in where
// there is no WebGL, took 110 to 360 ms on the same busy machine, with facets in place of smooth light.
(() => {
  const VIEW = [0.74, -0.61, 0.28], TAN = Math.tan(Math.PI / 12); // camera of all scenes of the book
  const THEMES = {
    light: { ramp: ["b9c4cf", "f0b43c", "dd6a1b", "9c1f45"], region: "69aae6", mark: "#0b4f8a", halo: "#fff" },
    dark: { ramp: ["7d8995", "b05a2a", "ee9a33", "ffe98a"], region: "2f7fd6", mark: "#8fd0ff", halo: "#10151b" },
  };
  for (const t of Object.values(THEMES)) {
    [t.region, ...t.ramp] = [t.region, ...t.ramp].map((c) => [0, 2, 4].map((k) => parseInt(c.slice(k, k + 2), 16)));
  }
  const STYLE = `
    :host { display: block; margin: 0; font: inherit }
    .stage { display: grid; grid-template-columns: 1fr 1fr; gap: .5rem }
    .panel { position: relative; min-width: 0 }
    h4 { margin: 0; font-size: .95em; font-weight: 600; text-align: center }
    h4 small { font-weight: 400; opacity: .8 }
    canvas { display: block; width: 100%; aspect-ratio: 1.25; touch-action: pan-y; cursor: crosshair; border-radius: 8px }
    canvas:focus-visible { outline: 2px solid currentColor; outline-offset: -2px }
    .controls { display: flex; flex-wrap: wrap; gap: .5rem 1.1rem; align-items: center; margin: .5rem 0; font-size: .9em }
    fieldset { display: flex; flex-wrap: wrap; border: 0; margin: 0; padding: 0; min-width: 0 }
    legend { position: absolute; clip-path: inset(50%); width: 1px; height: 1px; overflow: hidden }
    fieldset label { display: block; position: relative; padding: .3rem .7rem; border: 1px solid #8886; margin-left: -1px; cursor: pointer }
    fieldset label:first-of-type { border-radius: 6px 0 0 6px; margin: 0 }
    fieldset label:last-of-type { border-radius: 0 6px 6px 0 }
    fieldset label:has(:checked) { background: #0b62a8; color: #fff }
    fieldset label:has(:focus-visible) { outline: 2px solid currentColor; outline-offset: 2px; z-index: 1 }
    fieldset input { position: absolute; inset: 0; opacity: 0; margin: 0; cursor: pointer }
    .slider { display: flex; align-items: center; gap: .5rem } .slider[hidden] { display: none }
    .slider input { width: 6rem; min-height: 1.5rem } .slider span { min-width: 4.5em }
    .slider:has(:disabled) { opacity: .55 }
    p { margin: .3rem 0; font-size: .9em; min-height: 1.6em }
    .key { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; font-size: .85em; min-height: 1.4em }
    .key span { display: inline-flex; align-items: center; gap: .4em } .key [hidden] { display: none }
    .key i { flex: none; width: .75em; height: .75em; border-radius: 50%; box-sizing: border-box }
    slot { display: none }
    @media (max-width: 600px) { .stage { grid-template-columns: 1fr } p { min-height: 4.3em } fieldset { font-size: .9em } fieldset label { padding: .4rem } }
    @media print { .live { display: none } slot { display: block } }`;
  const PAGE = `<style>${STYLE}</style><div class="live">
    <div class="stage"><div class="panel"><h4></h4><canvas tabindex="0" role="application"></canvas></div>
    <div class="panel"><h4></h4><canvas tabindex="0" role="application"></canvas></div></div>
    <div class="key"><span><i class="chosen"></i>chosen vertex</span><span><i class="glow"></i><b></b></span>
    <span class="region"><i></i><b></b></span><span class="right"><i></i>where it belongs</span></div>
    <p role="status" aria-live="polite"></p>
    <div class="controls"><fieldset><legend>What is shown</legend></fieldset>
    <label class="slider">map noise σ² <input type="range" min="0" step="1"><span aria-hidden="true"></span></label>
    <label class="slider">temperature <input type="range" min="0" step="1"><span aria-hidden="true"></span></label></div>
    </div><slot></slot>`.replace(/<b>/g, '<b style="font-weight:inherit">');

  // ---- data
  async function unpack(text) {
    const packed = new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))]);
    const plain = await new Response(packed.stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
    let at = new Uint8Array(plain).indexOf(10) + 1;
    const data = JSON.parse(new TextDecoder().decode(plain.slice(0, at)));
    const take = (Kind, count) => new Kind(plain.slice(at, (at += count * Kind.BYTES_PER_ELEMENT)));
    data.shapes.forEach((s, k) => {
      const count = data.vertices[k].length;
      s.points = Float32Array.from(take(Int16Array, 3 * s.points), (x) => x * data.scale);
      s.triangles = take(Uint16Array, 3 * s.faces);
      s.picks = take(Uint16Array, count); // drawn vertices that can be chosen
      if (data.truth) s.right = take(Uint16Array, count); // where they belong, drawn vertices of the other shape
    });
    for (const state of data.states) {
      state.ways = data.vertices.map((own) => {
        const way = { images: take(Uint16Array, own.length * state.images) }; // steps from one to the next of a vertex
        way.images.forEach((_, k, all) => { if (k % state.images) all[k] += all[k - 1]; });
        if (state.region) Object.assign(way, { centres: take(Uint16Array, own.length), radius: take(Float32Array, own.length) });
        return way;
      });
    }
    return data;
  }

  function prepare(s) { // smooth normals, and the neighbours of every vertex
    const p = s.points, t = s.triangles, n = p.length / 3;
    s.normals = new Float32Array(3 * n);
    s.around = Array.from({ length: n }, () => new Set());
    let volume = 0; // negative where faces are inside out
    for (let k = 0; k < t.length; k += 3) {
      const [a, b, c] = [t[k], t[k + 1], t[k + 2]];
      const normal = cross(minus(at(p, b), at(p, a)), minus(at(p, c), at(p, a)));
      volume += dot(normal, at(p, a));
      for (const v of [a, b, c]) for (let x = 0; x < 3; x++) s.normals[3 * v + x] += normal[x];
      s.around[a].add(b).add(c); s.around[b].add(a).add(c); s.around[c].add(a).add(b);
    }
    for (let v = 0; v < n; v++) s.normals.set(unit(at(s.normals, v)).map((x) => (volume < 0 ? -x : x)), 3 * v);
  }

  const short = (x) => (x < 0.01 ? "below .01" : x.toFixed(2).replace(/^0/, ""));
  const at = (array, v) => [array[3 * v], array[3 * v + 1], array[3 * v + 2]];
  const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const unit = (a) => { const l = Math.hypot(...a) || 1; return [a[0] / l, a[1] / l, a[2] / l]; };

  function apart(p, a, b) {
    const x = p[3 * a] - p[3 * b], y = p[3 * a + 1] - p[3 * b + 1], z = p[3 * a + 2] - p[3 * b + 2];
    return Math.sqrt(x * x + y * y + z * z);
  }

  function within(s, from, reach) { // geodesic distance where it is below reach: two edges at a time, nearly straight
    const far = new Float32Array(s.around.length).fill(Infinity), queue = [from];
    far[from] = 0;
    for (const a of queue) {
      for (const c of s.around[a]) {
        for (const b of s.around[c]) {
          const d = far[a] + apart(s.points, a, b);
          if (d < reach && d < far[b] - 1e-6) { far[b] = d; queue.push(b); }
        }
      }
    }
    return far;
  }

  // ---- painting
  const LIGHTS = [[[-0.5, 0.7, 0.5], 0.72], [[0.85, 0.05, 0.45], 0.2], [[0.3, 0.6, -0.75], 0.3]]; // key, fill, back
  const shader = { vertex: `attribute vec3 p, n, c; uniform mat3 turn; uniform vec3 lens; varying vec3 normal, colour, eye;
      void main() { vec3 e = turn * p; float w = lens.x - e.z; normal = turn * n; colour = c; eye = vec3(-e.xy, w);
        gl_Position = vec4(e.x * lens.y / lens.z, e.y * lens.y, w * (w - lens.x) / lens.x, w); }`,
    pixel: `precision mediump float; varying vec3 normal, colour, eye; uniform vec3 ramp[5];
      void main() { vec3 n = normalize(normal), e = normalize(eye);
        float place = 3.0 * colour.x, edge = smoothstep(0.46, 0.54, colour.y);
        float rim = edge * (1.0 - smoothstep(0.6, 0.72, colour.y)); // of the region, which the light would hide
        vec3 glow = mix(mix(ramp[0], ramp[1], min(place, 1.0)), ramp[2], clamp(place - 1.0, 0.0, 1.0));
        glow = mix(glow, ramp[3], clamp(place - 2.0, 0.0, 1.0));
        vec3 ink = mix(mix(ramp[0], ramp[4], edge), glow, min(1.0, 6.0 * colour.x) * (1.0 - rim));
        float light = 0.12 + 0.1 * n.y + 0.16 * max(dot(n, e), 0.0)` + LIGHTS.map(([d, power]) =>
        ` + ${power} * max(dot(n, vec3(${unit(d).map((x) => x.toFixed(4))})), 0.0)`).join("") + `;
        float shine = 0.1 * pow(max(dot(n, normalize(e + vec3(${unit(LIGHTS[0][0]).map((x) => x.toFixed(4))}))), 0.0), 24.0);
        gl_FragColor = vec4(pow(pow(ink, vec3(2.2)) * light * 1.25 + shine, vec3(0.4545)), 1.0); }` };
  let gl; // undefined until first asked for, null where there is none

  function context() {
    gl = document.createElement("canvas").getContext("webgl", { antialias: true });
    if (!gl) return;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, shader.vertex], [gl.FRAGMENT_SHADER, shader.pixel]]) {
      const part = gl.createShader(kind);
      gl.shaderSource(part, text); gl.compileShader(part); gl.attachShader(program, part);
    }
    ["p", "n", "c"].forEach((name, k) => { gl.bindAttribLocation(program, k, name); gl.enableVertexAttribArray(k); });
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) { gl = null; return; }
    gl.useProgram(program);
    gl.turn = gl.getUniformLocation(program, "turn");
    gl.lens = gl.getUniformLocation(program, "lens");
    gl.ramp = gl.getUniformLocation(program, "ramp");
    gl.enable(gl.DEPTH_TEST);
  }

  function paint(canvas, s, values, ramp, axes, distance) { // values: light of images, and reach of the region
    if (gl === undefined || gl?.isContextLost()) context();
    const g = canvas.getContext("2d"), { width, height } = canvas;
    g.clearRect(0, 0, width, height);
    if (!gl) return paintFlat(g, s, values, ramp, axes, distance);
    if (gl.canvas.width !== width || gl.canvas.height !== height) Object.assign(gl.canvas, { width, height });
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (s.gl !== gl) {
      s.gl = gl;
      s.buffers = [s.points, s.normals, s.triangles, null].map((array, k) => {
        const buffer = gl.createBuffer(), kind = k === 2 ? gl.ELEMENT_ARRAY_BUFFER : gl.ARRAY_BUFFER;
        gl.bindBuffer(kind, buffer);
        if (array) gl.bufferData(kind, array, gl.STATIC_DRAW);
        return buffer;
      });
    }
    [s.buffers[0], s.buffers[1], s.buffers[3]].forEach((buffer, k) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      if (k === 2) gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
      gl.vertexAttribPointer(k, 3, k === 2 ? gl.UNSIGNED_BYTE : gl.FLOAT, k === 2, 0, 0);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, s.buffers[2]);
    gl.uniformMatrix3fv(gl.turn, false, [0, 1, 2].flatMap((x) => axes.map((a) => a[x])));
    gl.uniform3fv(gl.ramp, ramp.flat().map((x) => x / 255));
    gl.uniform3f(gl.lens, distance, 1 / TAN, width / height);
    gl.drawElements(gl.TRIANGLES, s.triangles.length, gl.UNSIGNED_SHORT, 0);
    g.drawImage(gl.canvas, 0, 0);
  }

  function paintFlat(g, s, values, ramp, axes, distance) { // without WebGL: triangles far to near
    g.lineWidth = 0.7;
    g.lineJoin = "round";
    const t = s.triangles, seen = project(s, axes, distance, g.canvas), near = new Float32Array(t.length / 3);
    for (let k = 0; k < near.length; k++) near[k] = seen[3 * t[3 * k] + 2] + seen[3 * t[3 * k + 1] + 2] + seen[3 * t[3 * k + 2] + 2];
    for (const f of Array.from(near.keys()).sort((a, b) => near[a] - near[b])) {
      const corners = [t[3 * f], t[3 * f + 1], t[3 * f + 2]];
      const normal = unit(corners.map((v) => at(s.normals, v)).reduce((a, b) => a.map((x, i) => x + b[i])));
      const e = axes.map((a) => dot(a, normal));
      if (e[2] < -0.3) continue;
      let light = 0.12 + 0.1 * e[1] + 0.16 * Math.max(0, e[2]);
      for (const [d, power] of LIGHTS) light += power * Math.max(0, dot(e, unit(d)));
      light = (light * 1.25) ** 0.4545;
      const [bright, reach] = [0, 1].map((x) => corners.reduce((sum, v) => sum + values[3 * v + x], 0) / 765);
      const place = 3 * bright, k = Math.min(2, Math.floor(place)), under = ramp[reach > 0.5 ? 4 : 0];
      const show = reach > 0.5 && reach < 0.66 ? 0 : Math.min(1, 6 * bright); // the rim of the region stays
      const ink = under.map((x, c) => x + show * (ramp[k][c] + (place - k) * (ramp[k + 1][c] - ramp[k][c]) - x));
      g.fillStyle = g.strokeStyle = `rgb(${ink.map((x) => light * x)})`;
      g.beginPath();
      for (const v of corners) g.lineTo(seen[3 * v], seen[3 * v + 1]);
      g.closePath(); g.fill(); g.stroke();
    }
  }

  function project(s, axes, distance, { width, height }) { // pixels across and down, and how near to the eye
    const seen = new Float32Array(s.points.length), half = height / 2;
    const [a, b, c] = axes;
    for (let v = 0; v < seen.length; v += 3) {
      const x = s.points[v], y = s.points[v + 1], z = s.points[v + 2];
      const near = c[0] * x + c[1] * y + c[2] * z, zoom = half / (TAN * (distance - near));
      seen[v] = width / 2 + zoom * (a[0] * x + a[1] * y + a[2] * z);
      seen[v + 1] = half - zoom * (b[0] * x + b[1] * y + b[2] * z);
      seen[v + 2] = near;
    }
    return seen;
  }

  // ---- one explorer
  async function build(figure) {
    figure.dataset.fm = "building";
    const data = figure.explored ?? await unpack(figure.querySelector("script").textContent); // a page may unpack its own
    for (const s of data.shapes) s.normals ?? prepare(s);
    const root = figure.attachShadow({ mode: "open" });
    root.innerHTML = PAGE;
    const $ = (q) => root.querySelector(q), all = (q) => [...root.querySelectorAll(q)];
    const canvases = all("canvas"), [noise, heat] = all("input[type=range]"), fieldset = $("fieldset");
    const views = [...new Set(data.states.map((s) => s.view))];
    const camera = { turn: Math.atan2(VIEW[1], VIEW[0]), tilt: Math.asin(VIEW[2] / Math.hypot(...VIEW)), aside: [0, 0] };
    const chosen = { from: 0, row: data.start[1], ...data.states[data.start[0]] }; // and what the controls say
    let values = [], hover = null, distance = 1, fitted = "", seen = [], theme = THEMES.light, state;

    const options = (key, only) => [...new Set(data.states.filter(only).map((s) => s[key]))];
    const noises = options("noise", () => true).sort((a, b) => a - b);
    const heats = options("temperature", (s) => s.temperature !== "");
    const axesOf = (k) => {
      const turn = camera.turn + camera.aside[k], [c, s] = [Math.cos(turn), Math.sin(turn)];
      const eye = [Math.cos(camera.tilt) * c, Math.cos(camera.tilt) * s, Math.sin(camera.tilt)], right = [-s, c, 0];
      return [right, cross(eye, right), eye];
    };

    function select() { // the state nearest to what the controls say, its light and words
      const { view, from, row } = chosen;
      const some = data.states.filter((s) => s.view === view && s.noise === chosen.noise);
      state = some.find((s) => s.temperature === chosen.temperature) ?? some[0] ?? data.states.find((s) => s.view === view);
      const to = 1 - from, way = state.ways[from], target = data.shapes[to];
      const images = way.images.subarray(row * state.images, (row + 1) * state.images);
      light(target, images, state.region ? [way.centres[row], way.radius[row]] : null, to);
      const name = data.vertices[from][row], names = data.shapes.map((s) => s.name);
      const level = Math.round(100 * data.level), places = new Set(images).size;
      const what = state.images === 1 ? "one image" : `${state.images} images at ${places} ${places === 1 ? "vertex" : "vertices"}`;
      const right = data.truth && data.shapes[from].right[row], off = images.reduce((d, v) => d + apart(target.points, v, right), 0);
      $("p").textContent = `Vertex ${name} of ${names[from]}, ${view}: ${what} on ${names[to]}` +
        (data.truth ? `, ${state.images === 1 ? "" : "mean "}${short(off / images.length / data.unit)} √area off` : "") +
        (state.region ? `, radius of the ${level} % region ${short(way.radius[row] / data.unit)} √area.` : ".");
      Object.assign(figure.dataset, { fm: "ready", from, vertex: name, places, view: state.view, noise: state.noise,
        temperature: state.temperature, image: images[0] });
      all("h4").forEach((h, k) => {
        h.textContent = names[k];
        h.append(Object.assign(document.createElement("small"), { textContent: k === from ? " · click a place" : ` · where it goes, ${view}` }));
      });
      canvases.forEach((c, k) => c.setAttribute("aria-label", `${names[k]}: arrow keys choose a vertex, Shift and arrow keys turn the shapes`));
      $(".glow + b").textContent = state.images === 1 ? "its image" : `its images under ${state.images} draws`;
      $(".region").hidden = !state.region;
      $(".region b").textContent = `region of ${level} %`;
      heat.disabled = options("temperature", (s) => s.view === view && s.temperature !== "").length < 2;
      noise.disabled = options("noise", (s) => s.view === view).length < 2;
      [[noise, noises, state.noise], [heat, heats, state.temperature || chosen.temperature]].forEach(([slider, list, value]) => {
        slider.nextElementSibling.textContent = value;
        slider.setAttribute("aria-valuetext", value);
        slider.value = list.indexOf(value);
      });
      face(to);
      draw();
    }

    function light(target, images, region, to) { // what the shapes show at each vertex, as bytes
      const p = target.points, count = target.around.length, sum = new Float32Array(count);
      const width = data.unit * data.glow * (images.length === 1 ? 0.5 : 1);
      for (const v of images) {
        for (let w = 0; w < count; w++) {
          const d = apart(p, v, w) / width;
          if (d < 3.5) sum[w] += Math.exp(-d * d / 2);
        }
      }
      values = data.shapes.map((s) => new Uint8Array(3 * s.around.length));
      const top = sum.reduce((a, b) => Math.max(a, b), 0), soft = 0.05 * data.unit;
      const far = region && within(target, region[0], region[1] + soft);
      for (let v = 0; v < count; v++) {
        values[to][3 * v] = (255 * sum[v]) / top;
        if (far) values[to][3 * v + 1] = 255 * Math.min(1, Math.max(0, 0.5 + (region[1] - far[v]) / (2 * soft)));
      }
    }

    function face(k) { // turn the other shape about its upright axis where light would not be seen, as little as will do
      const lit = Array.from(data.shapes[k].around.keys()).filter((v) => values[k][3 * v] > 100);
      const few = Math.ceil(lit.length / 10), some = lit.filter((_, n) => n % few === 0);
      let best = [-2, 0];
      fit();
      for (let n = 0; n < 16 && 1 - 0.14 * Math.ceil(n / 2) > best[0]; n++) { // a radian is worth a third of the light
        camera.aside[k] = 0.4 * Math.ceil(n / 2) * (n % 2 ? 1 : -1);
        seen[k] = null;
        const eye = axesOf(k)[2], seeing = (v) => dot(at(data.shapes[k].normals, v), eye) > 0.15 && visible(k, v);
        const share = some.filter(seeing).length / some.length || -1, worth = share - 0.14 * Math.ceil(n / 2);
        if (worth > best[0]) best = [worth, camera.aside[k]];
      }
      camera.aside[k] = best[1];
      seen[k] = null;
    }

    function fit() { // device pixels, and far enough that no turn about the upright axis leaves the frame
      const ratio = Math.min(2, devicePixelRatio || 1);
      canvases.forEach((canvas) => {
        const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
        if (width && (canvas.width !== width || canvas.height !== height)) Object.assign(canvas, { width, height });
      });
      const aspect = canvases[0].width / canvases[0].height, up = Math.cos(camera.tilt), lift = Math.sin(camera.tilt);
      if (fitted === `${aspect} ${camera.tilt}`) return ratio;
      fitted = `${aspect} ${camera.tilt}`;
      distance = 0;
      for (let turn = 0; turn < 2 * Math.PI; turn += 0.2) {
        const [c, q] = [Math.cos(turn), Math.sin(turn)];
        for (const { points: p } of data.shapes) {
          for (let v = 0; v < p.length; v += 9) { // a third of the vertices
            const away = c * p[v] + q * p[v + 1], near = up * away + lift * p[v + 2];
            const wide = Math.abs(c * p[v + 1] - q * p[v]) / aspect, high = Math.abs(up * p[v + 2] - lift * away);
            distance = Math.max(distance, near + (1.04 * Math.max(wide, high)) / TAN);
          }
        }
      }
      return ratio;
    }

    function draw() {
      const ratio = fit();
      canvases.forEach((canvas, k) => {
        const s = data.shapes[k], axes = axesOf(k), g = canvas.getContext("2d"), { from, row } = chosen;
        seen[k] = project(s, axes, distance, canvas);
        paint(canvas, s, values[k], [...theme.ramp, theme.region], axes, distance);
        if (hover && hover.k === k) ring(g, k, s.picks[hover.row], theme.mark, ratio * 6, 1.5 * ratio, []);
        if (k === from) ring(g, k, s.picks[row], theme.mark, ratio * 9, 3 * ratio, []);
        else if (data.truth) ring(g, k, data.shapes[from].right[row], theme.mark, ratio * 9, 2.5 * ratio, [3.5 * ratio, 3 * ratio]);
      });
    }

    function ring(g, k, v, colour, radius, width, dash) { // open, so that it does not hide the place; pale from behind
      g.globalAlpha = visible(k, v) ? 1 : 0.4;
      for (const [ink, extra, pattern] of [[theme.halo, 2.5, []], [colour, 0, dash]]) {
        g.beginPath();
        g.setLineDash(pattern);
        g.arc(seen[k][3 * v], seen[k][3 * v + 1], radius, 0, 2 * Math.PI);
        g.strokeStyle = ink;
        g.lineWidth = width + extra;
        g.stroke();
      }
      g.globalAlpha = 1;
    }

    function hit(k, x, y) { // the vertex nearest to where the line of sight through a pixel meets the surface
      const s = data.shapes[k], t = s.triangles, p = seen[k];
      let best = -Infinity, vertex = -1;
      for (let f = 0; f < t.length; f += 3) {
        const a = 3 * t[f], b = 3 * t[f + 1], c = 3 * t[f + 2];
        const area = (p[b] - p[a]) * (p[c + 1] - p[a + 1]) - (p[c] - p[a]) * (p[b + 1] - p[a + 1]);
        const u = ((x - p[a]) * (p[c + 1] - p[a + 1]) - (p[c] - p[a]) * (y - p[a + 1])) / area;
        const w = ((p[b] - p[a]) * (y - p[a + 1]) - (x - p[a]) * (p[b + 1] - p[a + 1])) / area;
        if (!(u >= 0 && w >= 0 && u + w <= 1)) continue;
        const near = p[a + 2] + u * (p[b + 2] - p[a + 2]) + w * (p[c + 2] - p[a + 2]);
        if (near > best) { best = near; vertex = u > 0.5 ? b / 3 : w > 0.5 ? c / 3 : a / 3; }
      }
      return [vertex, best];
    }
    function visible(k, v) {
      const p = (seen[k] = seen[k] ?? project(data.shapes[k], axesOf(k), distance, canvases[k]));
      return hit(k, p[3 * v], p[3 * v + 1])[1] < p[3 * v + 2] + 0.02 * data.unit;
    }
    function nearestRow(k, v) {
      const { picks, points } = data.shapes[k];
      const away = Array.from(picks, (w) => apart(points, v, w));
      return away.indexOf(Math.min(...away));
    }
    function pick(k, event) {
      const box = canvases[k].getBoundingClientRect(), zoom = canvases[k].width / box.width;
      const [v] = hit(k, (event.clientX - box.left) * zoom, (event.clientY - box.top) * zoom);
      return v < 0 ? null : nearestRow(k, v);
    }
    function choose(from, row) { Object.assign(chosen, { from, row }); hover = null; select(); }
    function turn(across, down) {
      camera.turn -= across;
      camera.tilt = Math.max(-0.4, Math.min(1.2, camera.tilt + down));
      draw();
    }

    function step(k, across, down) { // the nearest vertex in this direction that is seen; where there is none, turn
      const { picks } = data.shapes[k], p = seen[k];
      const start = k === chosen.from ? chosen.row : nearestRow(k, state.ways[chosen.from].images[chosen.row * state.images]);
      const [x, y] = [p[3 * picks[start]], p[3 * picks[start] + 1]];
      const ahead = Array.from(picks, (v, row) => {
        const along = (p[3 * v] - x) * across + (p[3 * v + 1] - y) * down;
        const beside = Math.abs((p[3 * v] - x) * down) + Math.abs((p[3 * v + 1] - y) * across);
        return [along > 2 && beside <= 1.2 * along ? along + 2 * beside : Infinity, row];
      }).filter(([cost]) => cost < Infinity).sort((a, b) => a[0] - b[0]);
      const next = ahead.find(([, row]) => visible(k, picks[row]));
      if (next) choose(k, next[1]); else if (across) turn(-0.3 * across, 0);
    }

    canvases.forEach((canvas, k) => {
      let start = null, moved = false;
      canvas.onpointerdown = (e) => { start = [e.clientX, e.clientY]; moved = false; canvas.setPointerCapture(e.pointerId); };
      canvas.onpointermove = (e) => {
        if (start) {
          moved ||= Math.hypot(e.clientX - start[0], e.clientY - start[1]) > 5;
          if (moved) turn((e.clientX - start[0]) / 120, (e.clientY - start[1]) / 120);
          if (moved) start = [e.clientX, e.clientY];
        } else if (e.pointerType === "mouse") {
          const row = pick(k, e);
          if (row !== (hover?.k === k ? hover.row : null)) { hover = row === null ? null : { k, row }; draw(); }
        }
      };
      canvas.onpointerup = (e) => {
        const row = start && !moved ? pick(k, e) : null;
        start = null;
        if (row !== null) choose(k, row);
      };
      canvas.onpointercancel = () => (start = null);
      canvas.onpointerleave = () => { if (hover) { hover = null; draw(); } };
      canvas.onkeydown = (e) => {
        const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[e.key];
        if (!way || e.ctrlKey || e.altKey || e.metaKey) return;
        e.preventDefault();
        if (e.shiftKey) turn(0.2 * way[0], 0.2 * way[1]); else step(k, ...way);
      };
    });
    views.forEach((view) => {
      const label = document.createElement("label"), radio = document.createElement("input");
      Object.assign(radio, { type: "radio", name: "view", value: view, checked: view === chosen.view });
      radio.onchange = () => { chosen.view = view; select(); };
      label.append(radio, view);
      fieldset.append(label);
    });
    fieldset.hidden = views.length < 2;
    [[noise, noises, "noise"], [heat, heats, "temperature"]].forEach(([slider, list, key]) => {
      slider.max = list.length - 1;
      slider.parentNode.hidden = list.length < 2;
      chosen[key] = list.includes(chosen[key]) ? chosen[key] : list[0] ?? "";
      slider.oninput = () => { chosen[key] = list[slider.value]; select(); };
    });
    const dress = () => { // dark is where the text is light
      const colour = getComputedStyle(figure).color.match(/[\d.]+/g);
      if (!colour) return;  // a page that is being left has no style
      const [r, g, b] = colour.map(Number);
      theme = r + g + b > 384 ? THEMES.dark : THEMES.light;
      const css = (c) => `rgb(${c})`, [chosenKey, glowKey] = all(".chosen, .glow");
      chosenKey.style.border = `3px solid ${theme.mark}`;
      glowKey.style.background = `radial-gradient(${theme.ramp.slice(1).reverse().map(css)})`;
      $(".region i").style.background = css(theme.region);
      $(".right i").style.border = `2px dashed ${theme.mark}`;
      $(".right").hidden = !data.truth;
      select();
    };
    dress();
    new ResizeObserver(draw).observe(figure);
    new MutationObserver(dress).observe(document.documentElement, { attributes: true });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", dress);
  }

  function wake() {
    const near = new IntersectionObserver((entries) => entries.forEach((e) => {
      if (!e.isIntersecting || e.target.dataset.fm) return;
      near.unobserve(e.target);
      build(e.target);
    }), { rootMargin: "400px" });
    document.querySelectorAll(".fm-explorer:not([data-fm])").forEach((figure) => near.observe(figure));
  }
  addEventListener("fm-explorer", wake); // there is a new one
  if (document.readyState === "loading") addEventListener("DOMContentLoaded", wake); else wake();
})();
