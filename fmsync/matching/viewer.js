"use strict";
// Draws the three shapes of a chosen pair: triangles far to near, turned by dragging. And gives the pair to the explorer.
const data = JSON.parse(document.getElementById("data").textContent);
const unpack = (text, Kind) => new Kind(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
const shapes = data.shapes.map((s) => ({
  name: s.name, points: unpack(s.points, Int16Array), faces: unpack(s.faces, Uint16Array),
  colours: unpack(s.colours, Uint8Array),
}));
const solid = data.shapes.map((s, k) => ({ // as the explorer has them
  name: s.name, picks: unpack(s.picks, Uint16Array), triangles: shapes[k].faces,
  points: Float32Array.from(shapes[k].points, (x) => (x * s.size) / 32000),
}));
const from = document.getElementById("from"), to = document.getElementById("to");
const view = { turn: 0.7, tilt: 0.25 };
let panels = [];

function ramp(x) {
  const at = x * (data.ramp.length - 1), k = Math.min(Math.floor(at), data.ramp.length - 2);
  return data.ramp[k].map((a, c) => 255 * (a + (data.ramp[k + 1][c] - a) * (at - k)));
}

function choose() {
  const i = +from.value, j = +to.value;
  const pair = data.pairs[`${i},${j}`], source = shapes[i], target = shapes[j];
  const same = !pair;
  const image = same ? null : unpack(pair.image, Uint16Array);
  const unsure = same ? null : unpack(pair.unsure, Uint8Array), double = same ? null : unpack(pair.double, Uint8Array);
  const carried = new Uint8Array(source.colours.length), warm = new Uint8Array(source.colours.length);
  for (let v = 0; v < carried.length / 3; v++) {
    const w = same ? v : image[v];
    const heat = same ? ramp(0) : double[v] ? [216, 27, 154] : ramp(unsure[v] / 254);
    for (let c = 0; c < 3; c++) { carried[3 * v + c] = target.colours[3 * w + c]; warm[3 * v + c] = heat[c]; }
  }
  panels = [["target", target, target.colours], ["carried", source, carried], ["unsure", source, warm]];
  const matched = pair && pair.distortion !== null && pair.distortion !== undefined;
  document.getElementById("words").textContent = same
    ? "A shape and itself."
    : `${source.name} to ${target.name}: half of the vertices have a region of radius below ${pair.median.toFixed(3)}. ` +
      (matched ? `The pair was matched, with distortion ${pair.distortion.toFixed(3)}.`
               : "The pair was not matched itself: its map comes through others.");
  draw();
  explore(i, j);
}

async function explore(i, j) { // an explorer of this pair in the place of the last one
  const place = document.getElementById("explorer");
  if (i === j || !shapes[i].faces.length || !shapes[j].faces.length) {
    place.textContent = i === j ? "Choose two different shapes." : "A point cloud has no surface to click on.";
    return;
  }
  const ways = await Promise.all([[i, j], [j, i]].map(async (way) => {
    const pair = data.pairs[way], packed = new Blob([unpack(pair.draws, Uint8Array)]);
    const draws = packed.stream().pipeThrough(new DecompressionStream("deflate"));
    const images = new Uint16Array(await new Response(draws).arrayBuffer());
    images.forEach((_, k) => { if (k % pair.count) images[k] += images[k - 1]; });
    const [radius, region] = [pair.radius, pair.region].map((r) => Float32Array.from(unpack(r, Uint16Array), (x) => x * data.step));
    const centres = unpack(pair.centres, Uint16Array), observed = pair.observed && unpack(pair.observed, Uint16Array);
    return { posterior: { images, centres, radius }, calibrated: { images: centres, centres, radius: region },
      synchronised: { images: centres }, observed: observed && { images: observed } };
  }));
  if (+from.value !== i || +to.value !== j) return; // another one was chosen meanwhile
  const [p, half] = [solid[i].points, data.shapes[i].size / 2]; // first, the vertex nearest to the reader's eye
  const away = Array.from(solid[i].picks, (v) => Math.hypot(p[3 * v] - 1.5 * half, p[3 * v + 1] + 1.2 * half, p[3 * v + 2] - half));
  const views = ["observed", "synchronised", "posterior", "calibrated"].filter((view) => ways[0][view]);
  const figure = document.createElement("div");
  const alt = `${shapes[i].name} and ${shapes[j].name}: a chosen vertex of one, and its images on the other`;
  Object.assign(figure, { className: "fm-explorer", role: "group", ariaLabel: alt, explored: {
    shapes: [solid[i], solid[j]], vertices: [data.shapes[i].choice, data.shapes[j].choice],
    states: views.map((view) => ({
      view, noise: 0, temperature: "", images: view === "posterior" ? data.pairs[[i, j]].count : 1,
      region: "radius" in ways[0][view], ways: ways.map((way) => way[view]),
    })),
    unit: 1, glow: 0.03, level: data.level,
    start: [Math.max(0, views.indexOf(place.querySelector("div")?.dataset.view ?? "calibrated")), away.indexOf(Math.min(...away))],
  } });
  figure.textContent = "Open this page in a browser to choose a vertex."; // what paper shows
  place.style.minHeight = `${place.offsetHeight}px`; // so that nothing jumps
  place.replaceChildren(figure);
  dispatchEvent(new Event("fm-explorer"));
}

function draw() {
  for (const [id, shape, colours] of panels) paint(document.getElementById(id), shape, colours);
}

function paint(canvas, shape, colours) {
  const g = canvas.getContext("2d"), size = canvas.width, n = shape.points.length / 3;
  const c = Math.cos(view.turn), s = Math.sin(view.turn), ct = Math.cos(view.tilt), st = Math.sin(view.tilt);
  const seen = new Float32Array(3 * n);
  for (let v = 0; v < n; v++) {
    const x = shape.points[3 * v] / 32000, y = shape.points[3 * v + 1] / 32000, z = shape.points[3 * v + 2] / 32000;
    const across = c * x + s * y, deep = -s * x + c * y;
    seen[3 * v] = size * (0.5 + 0.47 * across);
    seen[3 * v + 1] = size * (0.5 - 0.47 * (ct * z - st * deep));
    seen[3 * v + 2] = ct * deep + st * z;  // away from the eye
  }
  g.clearRect(0, 0, size, size);
  if (!shape.faces.length) {
    for (let v = 0; v < n; v++) {
      g.fillStyle = `rgb(${colours[3 * v]},${colours[3 * v + 1]},${colours[3 * v + 2]})`;
      g.fillRect(seen[3 * v] - 2, seen[3 * v + 1] - 2, 4, 4);
    }
    return;
  }
  const f = shape.faces, count = f.length / 3, depth = new Float32Array(count);
  for (let t = 0; t < count; t++) {
    depth[t] = seen[3 * f[3 * t] + 2] + seen[3 * f[3 * t + 1] + 2] + seen[3 * f[3 * t + 2] + 2];
  }
  for (const t of Array.from(depth.keys()).sort((a, b) => depth[b] - depth[a])) {
    const [a, b, d] = [3 * f[3 * t], 3 * f[3 * t + 1], 3 * f[3 * t + 2]];
    const ux = seen[b] - seen[a], uy = seen[b + 1] - seen[a + 1], wx = seen[d] - seen[a], wy = seen[d + 1] - seen[a + 1];
    const uz = size * 0.47 * (seen[b + 2] - seen[a + 2]), wz = size * 0.47 * (seen[d + 2] - seen[a + 2]);
    const nx = uy * wz - uz * wy, ny = uz * wx - ux * wz, nz = ux * wy - uy * wx;
    const light = 0.72 + 0.28 * Math.abs(nz) / (Math.hypot(nx, ny, nz) || 1);
    g.fillStyle = g.strokeStyle =
      "rgb(" + [0, 1, 2].map((k) => Math.round(light * (colours[a + k] + colours[b + k] + colours[d + k]) / 3)) + ")";
    g.beginPath();
    g.moveTo(seen[a], seen[a + 1]); g.lineTo(seen[b], seen[b + 1]); g.lineTo(seen[d], seen[d + 1]);
    g.closePath(); g.fill(); g.stroke();
  }
}

shapes.forEach((s, k) => { from.add(new Option(s.name, k)); to.add(new Option(s.name, k)); });
from.value = 1;
to.value = 0;
from.onchange = to.onchange = choose;
for (const canvas of document.querySelectorAll("canvas")) {
  canvas.onpointerdown = (e) => canvas.setPointerCapture(e.pointerId);
  canvas.onpointermove = (e) => {
    if (!e.buttons) return;
    view.turn += e.movementX / 120;
    view.tilt = Math.max(-1.5, Math.min(1.5, view.tilt + e.movementY / 120));
    draw();
  };
}
choose();
