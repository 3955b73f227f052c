// Drawing of vehicles and of their tracking errors, for the flying page.
const BODY = 0.055, NEAR = 0.1, REACH = 12;  // m; `shape`, the sizes of the scenario's vehicle, is from quadpend_gym/viewer/snapshot.py
const ANGLE = 1, SPIN = 40, TRAIL = 2;  // field of view, rad; rotor speed, rad/s; trail, s
const COLOURS = "sky horizon far near grid shadow rod arm rotor front wind ink soft rule page warm".split(" ");
const FARTHER = 3.4 / 2.7;  // distance of the viewer's camera relative to that of the page's
const FIRST_VIEW = {azimuth: -0.9, elevation: 0.42, distance: 2.7}, camera = {...FIRST_VIEW};
const still = matchMedia("(prefers-reduced-motion: reduce)");
let shape, colours, time = 0;

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const plus = (a, b, share = 1) => a.map((x, i) => x + share * b[i]);
const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const norm = a => Math.hypot(...a);
const mix = (a, b, share) => a.map((x, i) => x + share * (b[i] - x));
const flat = ([x, y]) => [x, y, 0];
const ring = n => Array.from({length: n}, (_, i) => [Math.cos(2 * Math.PI * i / n), Math.sin(2 * Math.PI * i / n), 0]);
const ROUND = ring(24);

// The scene
const bright = colour => dot([0.3, 0.6, 0.1], [1, 3, 5].map(i => parseInt(colour.slice(i, i + 2), 16))) > 140;
const ink = colour => colour === "currentColor" ? colours.ink : colour;
function readColours(root) {
  const style = getComputedStyle(root);
  colours = Object.fromEntries(COLOURS.map(name => [name, style.getPropertyValue("--" + name).trim()]));
}
function sized(shape) {  // complete the sizes of a vehicle
  return {...shape, longest: shape.distance_scale, distance_scale: shape.distance_scale * FARTHER};
}
function placed(state) {  // complete a state by the places of its parts
  const {position, direction} = state, rotate = attitude(state.euler), pivot = plus(position, rotate(shape.pivot));
  const [bob, tip] = [1, shape.pole_ratio].map(share => plus(pivot, direction, share * shape.rod_length));
  return {...state, rotate, pivot, bob, tip, hubs: shape.hubs.map(hub => plus(position, rotate(hub)))};
}
function prepare(canvas) {  // clear the canvas at the screen's resolution; return a context in units of CSS pixels
  const sharp = window.devicePixelRatio || 1, {clientWidth: width, clientHeight: height} = canvas, pen = canvas.getContext("2d");
  const size = [width, height].map(x => Math.round(x * sharp));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  pen.setTransform(size[0] / width, 0, 0, size[1] / height, 0, 0);
  pen.clearRect(0, 0, width, height);
  return {pen, width, height};
}
function project(at, width, height) {  // perspective projection as in quadpend_gym/viewer/camera.py
  const {azimuth: a, elevation: e} = camera, distance = shape.distance_scale * camera.distance, [ca, sa, ce, se] = [Math.cos(a), Math.sin(a), Math.cos(e), Math.sin(e)];
  const back = [ce * ca, ce * sa, se], right = [-sa, ca, 0], up = [-se * ca, -se * sa, ce], eye = plus(at, back, distance);
  const focal = height / 2 / Math.tan(ANGLE / 2);
  const toCamera = ([x, y, z]) => [right, up, back].map((axis, i) => (i < 2 ? 1 : -1) * (axis[0] * (x - eye[0]) + axis[1] * (y - eye[1]) + axis[2] * (z - eye[2])));
  const pixel = ([x, y, depth]) => [width / 2 + focal * x / depth, height / 2 - focal * y / depth];
  const depth = point => toCamera(point)[2], size = (metres, point) => metres * focal / Math.max(depth(point), NEAR);
  const inPlane = ([across, down], point) => right.map((r, i) => (across * r - down * up[i]) * depth(point) / focal);  // m, of pixels at a point's depth
  return {toCamera, pixel, depth, size, inPlane, right, horizon: ce > 1e-6 ? height / 2 - focal * se / ce : -Infinity};
}
function setPen(pen, colour, width, dashes = []) {
  Object.assign(pen, {strokeStyle: colour, lineWidth: width, lineJoin: "round", lineCap: width > 3 ? "round" : "butt"}).setLineDash(dashes);
  pen.beginPath();
}
function stroke(pen, points, ...style) {
  setPen(pen, ...style);
  for (const point of points) pen.lineTo(...point);
  pen.stroke();
}
function write(pen, text, at, colour, align, font, halo) {
  Object.assign(pen, {fillStyle: colour, textAlign: align, textBaseline: "middle", font: `${font} system-ui, sans-serif`}).setLineDash([]);
  if (halo) Object.assign(pen, {strokeStyle: bright(colour) ? "#14181d" : "#ffffff", lineWidth: 3}).strokeText(text, ...at);
  pen.fillText(text, ...at);
}
function disc(pen, at, radius, colour, edge = 0) {
  Object.assign(pen, {fillStyle: colour, strokeStyle: colour, lineWidth: edge}).setLineDash([]);
  pen.beginPath();
  pen.arc(...at, radius, 0, 2 * Math.PI);
  edge ? pen.stroke() : pen.fill();
}
function arrowHead(pen, tip, ahead, long, colour) {
  const aside = [-0.45 * long * ahead[1], 0.45 * long * ahead[0]], foot = plus(tip, ahead, -long);
  stroke(pen, [tip, plus(foot, aside), plus(foot, aside, -1), tip], colours.page, 3);
  pen.fillStyle = colour;
  pen.fill();
}
function withOpacity(pen, opacity, draw) {
  const clear = pen.globalAlpha;
  pen.globalAlpha = clear * opacity;
  draw();
  pen.globalAlpha = clear;
}
function primitives(pen, {toCamera, pixel}) {  // drawing functions in metres
  function lines(pairs, colour, width = 1, opacity = 1, dashes = []) {
    const clipped = (p, q) => p[2] < NEAR ? mix(p, q, (NEAR - p[2]) / (q[2] - p[2])) : p;
    setPen(pen, colour, width, dashes);
    for (const [a, b] of pairs.map(ends => ends.map(toCamera)))
      if (Math.max(a[2], b[2]) >= NEAR) pen.moveTo(...pixel(clipped(a, b))), pen.lineTo(...pixel(clipped(b, a)));
    withOpacity(pen, opacity, () => pen.stroke());
  }
  const line = (a, b, ...style) => lines([[a, b]], ...style);
  function area(points, colour, opacity = 1, edge = 0) {
    const corners = points.map(toCamera);
    if (corners.some(corner => corner[2] < NEAR)) return;
    stroke(pen, [...corners, corners[0]].map(pixel), edge ? colour : "transparent", edge || 1);
    pen.fillStyle = colour;
    withOpacity(pen, opacity, () => pen.fill());
  }
  function arrow(start, force, colour) {
    const long = shape.metres_per_newton * norm(force), ends = [start, plus(start, force, shape.metres_per_newton * Math.min(1, shape.longest / long))].map(toCamera);
    if (!(long > 0.015 * shape.longest) || Math.min(ends[0][2], ends[1][2]) < NEAR) return;
    const [a, b] = ends.map(pixel), way = plus(b, a, -1), ahead = way.map(x => x / Math.max(norm(way), 1)), size = Math.min(20, norm(way));
    for (const edge of [3, 0]) stroke(pen, [a, plus(b, ahead, -size)], edge ? colours.page : colour, 4 + edge);
    for (const back of long > shape.longest ? [0.6, 0] : [0]) arrowHead(pen, plus(b, ahead, -back * size), ahead, size, colour);
  }
  return {line, lines, area, arrow};
}
const land = document.createElement("canvas");
let landKey;
function ground(pen, eye, width, height, at) {  // drawn again only where the camera, the size or the colours changed
  const scale = pen.getTransform().a, key = JSON.stringify([camera, width, height, scale, at, colours]);
  if (key !== landKey) {
    [land.width, land.height, landKey] = [pen.canvas.width, pen.canvas.height, key];
    const own = land.getContext("2d", {alpha: false});
    own.setTransform(pen.getTransform());
    drawGround(own, eye, primitives(own, eye), width, height, at);
  }
  pen.drawImage(land, 0, 0, width, height);
}
function drawGround(pen, eye, {lines}, width, height, at) {
  const level = clamp(eye.horizon, 0, height), [x, y] = at.map(Math.round);
  const bottom = level + 0.6 * height, tone = pen.createLinearGradient(0, 0, 0, bottom);
  for (const [down, name] of [[0, "sky"], [level, "horizon"], [level, "far"], [bottom, "near"]]) tone.addColorStop(down / bottom, colours[name]);
  Object.assign(pen, {fillStyle: tone}).fillRect(0, 0, width, height);
  const levels = Array.from({length: REACH + 1}, () => []);  // of opacity
  for (let across = -REACH; across <= REACH; across++)
    for (let along = -REACH; along < REACH; along += 2)
      levels[Math.max(Math.round(REACH - Math.hypot(across, along + 1)), 0)].push(
        [[x + across, y + along, 0], [x + across, y + along + 2, 0]], [[x + along, y + across, 0], [x + along + 2, y + across, 0]]);
  levels.forEach((pairs, i) => i && lines(pairs, colours.grid, 1, i / REACH));
}
function attitude([roll, pitch, yaw]) {  // Rz(yaw) Ry(pitch) Rx(roll)
  const [cx, sx, cy, sy, cz, sz] = [roll, pitch, yaw].flatMap(angle => [Math.cos(angle), Math.sin(angle)]);
  const x = [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx], y = [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx];
  return vector => [x, y, [-sy, cy * sx, cy * cx]].map(row => dot(row, vector));
}
function shadow({line, area}, {position, bob, tip, hubs}) {
  const spots = [...hubs.map(hub => [hub, shape.rotor, 0.25]), [position, 1.2 * shape.scale * BODY, 0.5], [bob, 1.2 * shape.bob, 0.5]];
  for (const [at, radius, depth] of spots) area(ROUND.map(p => flat(plus(at, p, radius))), colours.shadow, depth);
  for (const end of [...hubs, tip]) line(flat(position), flat(end), colours.shadow, 1, 0.6);
  line(position, flat(position), colours.soft, 1, 0.7, [4, 5]);
}
function trail({line}, {bobAt, colour, dashes}) {  // dashes are intervals of time, so they do not move along the path
  const intervals = (dashes.length ? dashes : [2.5, 0]).map(x => 0.02 * x), period = intervals.reduce((a, b) => a + b);
  for (let i = 0, t = period * Math.floor((time - TRAIL) / period), end; t < time; t = end, i++) {
    end = t + intervals[i % intervals.length];
    if (i % 2 === 0) line(bobAt(t), bobAt(Math.min(end, time)), colour, 3, clamp(1 - 0.85 * (time - t) / TRAIL, 0, 1));
  }
}
function vehicle(pen, eye, {line, area, arrow}, state) {  // return the parts with their depths
  const {position, pivot, bob, tip, hubs, rotate, colour, dashes} = state, px = eye.size(1, position), parts = [];
  const add = (at, draw) => eye.depth(at) > 2 * NEAR && parts.push([eye.depth(at), () => withOpacity(pen, state.fallen ? 0.5 : 1, draw)]);
  hubs.forEach((hub, i) => {
    add(mix(position, hub, 0.5), () => line(position, hub, colours.arm, 0.022 * shape.scale * px));
    add(plus(hub, rotate([0, 0, 0.06 * shape.scale])), () => {
      const middle = plus(hub, rotate([0, 0, 0.03 * shape.scale])), tint = shape.front[i] ? colours.front : colours.rotor;
      const angle = still.matches ? 0.6 : -shape.spins[i] * SPIN * Math.min(time, state.fell ?? time);
      const blade = rotate([Math.cos(angle), Math.sin(angle), 0]);
      area(ROUND.map(p => plus(middle, rotate(p), shape.rotor)), tint, 0.35, shape.front[i] ? 3.5 : 1.2);
      line(plus(middle, blade, -0.95 * shape.rotor), plus(middle, blade, 0.95 * shape.rotor), tint, 2);
    });
  });
  add(position, () => area(ROUND.map(p => plus(position, rotate(p), shape.scale * BODY)), colour));
  if (norm(shape.pivot)) add(mix(position, pivot, 0.5), () => line(position, pivot, colours.arm, 0.022 * shape.scale * px));
  add(plus(mix(pivot, tip, 0.5), rotate([0, 0, 0.01])), () => line(pivot, tip, colours.rod, shape.pole * px));
  add(bob, () => {
    const at = eye.pixel(eye.toCamera(bob)), radius = eye.size(shape.bob, bob);
    disc(pen, at, radius, colours.rod);
    disc(pen, at, 0.88 * radius, colour);
    if (dashes[1]) disc(pen, at, 0.45 * radius, colours.page);  // another policy may have the same colour
    disc(pen, plus(at, [-0.3 * radius, -0.3 * radius]), 0.25 * radius, "#ffffff99");
  });
  const arrows = [[position, state.force, colours.wind], [bob, state.bob_force, colours.wind]];
  if (!state.fallen) add(position, () => arrows.forEach(given => arrow(...given)));
  return parts;
}
function markOutside(pen, eye, place, colour, text, size) {  // mark a point outside the picture at its edge; return whether it is
  const [across, up, depth] = eye.toCamera(place), middle = size.map(x => x / 2);
  const way = depth > NEAR ? plus(eye.pixel([across, up, depth]), middle, -1) : [across, -up], ahead = way.map(x => x / norm(way));
  const reach = Math.min(...way.map((x, i) => (middle[i] - 8) / Math.abs(x))), tip = plus(middle, way, reach);
  if (depth > NEAR && reach > 1) return false;
  arrowHead(pen, tip, ahead, 16, colour);
  write(pen, text, plus(tip, ahead, -26), colour, ["left", "center", "right"][Math.round(ahead[0]) + 1], "600 15px", true);
  return true;
}
// Draw vehicles and the rings of their targets; the camera looks at the vehicles' middle. Return the projection.
function drawScene(canvas, middle, all, aims) {
  const {pen, width, height} = prepare(canvas), [x, y, z] = middle, at = [x, y, z + shape.lift - 0.22 * FIRST_VIEW.distance * shape.distance_scale], eye = project(at, width, height), tools = primitives(pen, eye);
  ground(pen, eye, width, height, at);
  for (const state of all) if (!state.fallen) shadow(tools, state);
  for (const one of all) trail(tools, one);
  for (const [, drawPart] of all.flatMap(state => vehicle(pen, eye, tools, state)).sort((a, b) => b[0] - a[0])) drawPart();
  for (const aim of aims)
    if (!markOutside(pen, eye, aim, colours.ink, "target", [width, height]))
      for (const [colour, edge] of [[colours.page, 6], [colours.ink, 2.5]]) disc(pen, eye.pixel(eye.toCamera(aim)), eye.size(1.35 * shape.bob, aim), colour, edge);
  const font = "600 15px", [one, two = one] = all.map(({bob}) => eye.pixel(eye.toCamera(bob))[0]), swapped = one - two > eye.size(shape.bob, aims[0]);
  all.forEach(({bob, letter, colour, fallen, fell}, i) => {
    const side = swapped === (i > 0) ? -1 : 1;
    if (fallen) write(pen, `${letter} fell at ${fell.toFixed(1)} s`, [12, 18 + 22 * i], colour, "left", font, true);
    if (markOutside(pen, eye, bob, colour, letter, [width, height])) return;
    write(pen, letter, plus(eye.pixel(eye.toCamera(bob)), [eye.size(shape.bob, bob) + 8, 0], side), colour, side > 0 ? "left" : "right", font, true);
  });
  return eye;
}

// Tracking errors
const axes = canvas => ({left: 46, right: canvas.clientWidth - 24, top: 24, bottom: canvas.clientHeight - 20});
function tickInterval(duration, width) {  // s, 1, 2 or 5 times a power of ten, so that the labels of the time axis do not overlap
  const least = duration * Math.max(0.12, 50 / width), power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find(factor => factor * power >= 0.999 * least);
}
function labelHeights(ends, top, bottom) {  // of the letters at the ends of the curves: inside the axes, and one above the other
  const heights = ends.map(([, down]) => clamp(down, top + 6, bottom - 8));
  if (ends.length < 2 || ends.some((end, i) => Math.max(Math.abs(end[0] - ends[1 - i][0]), Math.abs(heights[i] - heights[1 - i])) > 14)) return heights;
  const middle = clamp((heights[0] + heights[1]) / 2, top + 13, bottom - 15), up = heights[0] <= heights[1] ? 7 : -7;
  return [middle - up, middle + up];
}
// Draw tracking errors from `begin` to `end` (s) and from 10^low to 10^high mm; the points of a curve are times (s) and errors (mm); marks are times
function drawErrors(canvas, curves, [begin, end], [low, high], marks) {
  const {pen} = prepare(canvas), {left, right, top, bottom} = axes(canvas);
  const x = t => left + (right - left) * (t - begin) / (end - begin);
  const y = mm => bottom - (bottom - top) * (Math.log10(clamp(mm, 1, 10 ** high)) - low) / (high - low);
  const note = (text, at, align) => write(pen, text, at, colours.soft, align, "12px");
  note("tracking error (mm)", [left, 9], "left");
  for (let power = low; power <= high; power++) {
    stroke(pen, [[left, y(10 ** power)], [right, y(10 ** power)]], colours.rule, 1);
    note(power ? 10 ** power : "≤ 1", [left - 6, y(10 ** power)], "right");
  }
  const interval = tickInterval(end - begin, right - left);
  for (let t = begin; t < begin + 1.001 * (end - begin); t += interval) note(`${+t.toPrecision(6)} s`, [x(t), bottom + 12], "center");
  for (const t of marks) stroke(pen, [[x(t), top], [x(t), bottom]], colours.warm, 1, [3, 3]);
  const drawn = curves.map(curve => ({...curve, points: curve.points.map(([t, mm]) => [x(t), y(mm)])}));
  const last = drawn.filter(curve => curve.letter).map(({points}) => points[points.length - 1]), heights = labelHeights(last, top, bottom);
  for (const {points, fell, colour, dashes, letter} of drawn) {
    const tip = points[points.length - 1];
    stroke(pen, points, colour, 2, dashes);
    if (fell) for (const arm of [[5, 5], [5, -5]]) stroke(pen, [plus(tip, arm, -1), plus(tip, arm)], colour, 2.5);
    if (letter) write(pen, letter, [tip[0] + (fell ? 9 : 5), heights.shift()], colour, "left", "600 13px", true);
  }
  return {pen, x, top, bottom};
}

// Camera; `refresh` draws the page again
function moveCamera(across, down, farther = 1) {
  camera.azimuth -= across;
  camera.elevation = clamp(camera.elevation + down, -0.1, Math.PI / 2);
  camera.distance = clamp(farther * camera.distance, 0.8, 20);
  refresh();
}
function followFingers(view) {  // they turn the camera
  const fingers = new Map();
  view.onpointerdown = event => { fingers.set(event.pointerId, event); view.setPointerCapture(event.pointerId); };
  view.onpointerup = view.onpointercancel = event => fingers.delete(event.pointerId);
  view.onpointermove = event => {
    const from = fingers.get(event.pointerId), [other] = [...fingers.values()].filter(finger => finger.pointerId !== event.pointerId);
    if (!from) return;
    const apart = finger => Math.hypot(finger.clientX - other.clientX, finger.clientY - other.clientY) || 1;
    fingers.set(event.pointerId, event);
    other ? moveCamera(0, 0, apart(from) / apart(event)) : moveCamera(0.008 * (event.clientX - from.clientX), 0.008 * (event.clientY - from.clientY));
  };
  view.addEventListener("wheel", event => {  // without Ctrl, the wheel scrolls the page
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    moveCamera(0, 0, Math.exp(0.002 * clamp(event.deltaY, -200, 200)));
  }, {passive: false});
  view.ondblclick = () => { Object.assign(camera, FIRST_VIEW); refresh(); };
}
