/* The replay in three dimensions, drawn with nothing but lines. */
import { prepare, rule } from "./canvas.js";
import { colour, data, flights, setTime, state } from "./data.js";
import { $, css } from "./dom.js";
import { drawMarker } from "./markers.js";
import { inclination, RAD, windy } from "./quantities.js";

const camera = { azimuth: -0.9, elevation: 0.42, zoom: 1 };
export function drawStage() {
  const [pen, width, height] = prepare($("stage"));
  const crew = flights();
  if (!crew.length) return;
  const long = crew.reduce((a, b) => (b[1].x.length > a[1].x.length ? b : a))[1];
  const k = Math.min(long.x.length - 1, Math.round(state.time / long.dt));
  const centre = span(long), size = (Math.min(width, height) * 0.72 * camera.zoom) / centre.extent;
  const [ca, sa, ce, se] = [Math.cos(camera.azimuth), Math.sin(camera.azimuth), Math.cos(camera.elevation), Math.sin(camera.elevation)];
  let project = (x, y, z) => {
    [x, y, z] = [x - centre.x, y - centre.y, z - centre.z];
    const [u, v] = [ca * x - sa * y, sa * x + ca * y];
    const depth = 1 / (1 + (0.22 * (ce * v - se * z)) / centre.extent);
    return [width / 2 + size * u * depth, height / 2 - size * (se * v + ce * z) * depth];
  };
  const path = (points, stroke, thick, alpha = 1) => {
    pen.beginPath(); pen.strokeStyle = stroke; pen.lineWidth = thick; pen.globalAlpha = alpha; pen.lineCap = "round";
    points.forEach((p, i) => { const [u, v] = project(...p); i ? pen.lineTo(u, v) : pen.moveTo(u, v); });
    pen.stroke(); pen.globalAlpha = 1;
  };
  const half = centre.extent * 0.75, step = half > 6 ? 2 : half > 2.5 ? 1 : 0.5;
  const x0 = Math.round(centre.x / step) * step, y0 = Math.round(centre.y / step) * step, n = Math.ceil(half / step);
  for (let i = -n; i <= n; i++) {
    path([[x0 + i * step, y0 - n * step, centre.floor], [x0 + i * step, y0 + n * step, centre.floor]], css("--line"), 1);
    path([[x0 - n * step, y0 + i * step, centre.floor], [x0 + n * step, y0 + i * step, centre.floor]], css("--line"), 1);
  }
  const [rx, ry, rz] = [long.x_ref[k], long.y_ref[k], long.z_ref[k]], mark = centre.extent * 0.03;
  for (const [dx, dy, dz] of [[mark, 0, 0], [0, mark, 0], [0, 0, mark]]) path([[rx - dx, ry - dy, rz - dz], [rx + dx, ry + dy, rz + dz]], css("--ink"), 2);
  const big = Math.max(1, (centre.extent * 0.075) / 0.17); // drawn larger than life in a wide scene
  /* Arms, the front ones in another colour, and rotor discs; broad and filled for a ghost. Angles [deg]. */
  const body = (here, angles, stroke, front, alpha, ghost) => {
    const rotate = rotation(...angles.map((angle) => angle * RAD));
    const place = (x, y, z) => { const r = rotate(x * big, y * big, z * big); return [here[0] + r[0], here[1] + r[1], here[2] + r[2]]; };
    for (const [x, y, z] of data.bodies[state.scenario].hubs) {
      path([place(0, 0, 0), place(x, y, z)], x > 0.5 * Math.hypot(x, y) ? front : stroke, ghost ? 6 : 3.5, alpha);
      const ring = [];
      for (let a = 0; a <= 16; a++) ring.push(place(x + data.bodies[state.scenario].prop_radius * Math.cos(a * Math.PI / 8), y + data.bodies[state.scenario].prop_radius * Math.sin(a * Math.PI / 8), z));
      path(ring, stroke, 1.5, alpha);
      if (ghost) { pen.globalAlpha = 0.7 * alpha; pen.fillStyle = stroke; pen.fill(); pen.globalAlpha = 1; }
    }
  };
  /* The chosen vehicle and its ghost, large, in the corner. */
  const closeUp = (name, s) => {
    const j = Math.min(k, s.x.length - 1), side = Math.min(170, 0.4 * width), foot = width < 500 ? 30 : 10;
    const scale = (0.36 * side) / (big * (Math.max(...data.bodies[state.scenario].hubs.map(([x, y]) => Math.hypot(x, y))) + data.bodies[state.scenario].prop_radius));
    project = (x, y, z) => {
      const v = sa * x + ca * y;
      return [10 + side / 2 + scale * (ca * x - sa * y), height - foot - 0.42 * side - scale * (se * v + ce * z)];
    };
    pen.fillStyle = css("--card"); pen.strokeStyle = css("--line"); pen.lineWidth = 1;
    pen.beginPath(); pen.roundRect(10, height - foot - 0.84 * side, side, 0.84 * side, 8); pen.fill(); pen.stroke();
    both(name, s, j, [0, 0, 0], 1);
    pen.fillStyle = css("--soft"); pen.textAlign = "left"; pen.textBaseline = "top";
    pen.fillText("true and estimated", 18, height - foot + 6 - 0.84 * side);
  };
  const both = (name, s, j, here, alpha) => {
    if (name === state.inside) body(here, [s.roll_est[j], s.pitch_est[j], s.yaw[j]], colour[name], colour[name], 0.35 * alpha, true);
    body(here, [s.roll[j], s.pitch[j], s.yaw[j]], colour[name], css("--accent"), alpha, false);
  };
  for (const [name, s] of crew) {
    const j = Math.min(k, s.x.length - 1), crashed = k > s.x.length - 1;
    const trail = [];
    for (let i = Math.max(0, j - Math.round(3 / s.dt)); i <= j; i++) trail.push([s.x[i], s.y[i], s.z[i]]);
    path(trail, colour[name], 1.5, 0.55);
    const here = [s.x[j], s.y[j], s.z[j]], alpha = crashed ? 0.35 : 1;
    path([[here[0], here[1], centre.floor], here], css("--soft"), 1, 0.35);
    both(name, s, j, here, alpha);
  }
  const inside = crew.find(([name]) => name === state.inside);
  if (inside) closeUp(...inside);
  pen.textAlign = "left"; pen.textBaseline = "middle";
  crew.forEach(([name, s], i) => {
    drawMarker(pen, data.looks[name], 15, 18 + 18 * i, 5);
    const off = name === state.inside ? `, estimate ${errors(s)[Math.min(k, s.x.length - 1)].toFixed(1)}° off` : "";
    pen.fillStyle = css("--ink"); pen.fillText(name + off + (k > s.x.length - 1 ? "  ✕ crashed" : ""), 27, 18.5 + 18 * i);
  });
  pen.fillStyle = css("--soft"); pen.textAlign = "right";
  pen.fillText(`squares of ${step} m` + (centre.floor > 0 ? `, ${centre.floor.toFixed(1)} m above ground` : " on the ground"), width - 8, height - 10);
  drawWind(pen, width - 70, 52, k, [ca, sa, ce, se]);
  $("ghost-name").textContent = state.inside;
  $("clock").max = (long.x.length - 1) * long.dt;
  $("clock").value = state.time;
  $("clock-text").textContent = state.time.toFixed(1) + " s";
}
/* The wind at sample k as an arrow, full length at the largest speed of the flight. */
function drawWind(pen, u, v, k, [ca, sa, ce, se]) {
  const wind = data.shared[state.scenario]?.flight;
  if (!windy(wind)) return;
  const at = (i) => [wind.wind_x[i], wind.wind_y[i], wind.wind_z[i]], i = Math.min(k, wind.wind_x.length - 1);
  const most = (wind.most ??= wind.wind_x.reduce((m, _, j) => Math.max(m, Math.hypot(...at(j))), 0));
  const [x, y, z] = at(i), speed = Math.hypot(x, y, z), scale = 38 / (most || 1);
  const [dx, dy] = [(ca * x - sa * y) * scale, -(se * (sa * x + ca * y) + ce * z) * scale], long = Math.hypot(dx, dy);
  pen.strokeStyle = pen.fillStyle = css("--ink"); pen.lineWidth = 2.5; pen.lineCap = "butt"; pen.textAlign = "center";
  if (long > 1) {
    const [ex, ey] = [dx / long, dy / long], head = Math.min(9, long), [tx, ty] = [u + dx / 2, v + dy / 2];
    rule(pen, u - dx / 2, v - dy / 2, tx - ex * head, ty - ey * head);
    pen.beginPath(); pen.moveTo(tx, ty); pen.lineTo(tx - head * ex - 0.5 * head * ey, ty - head * ey + 0.5 * head * ex); pen.lineTo(tx - head * ex + 0.5 * head * ey, ty - head * ey - 0.5 * head * ex); pen.fill();
  }
  pen.fillText(`wind ${speed.toFixed(1)} m/s`, u, v + 36);
}
const errors = (s) => (s.errors ??= inclination(s));
function span(s) {
  const range = (values) => { let [a, b] = [Infinity, -Infinity]; for (const v of values) { a = Math.min(a, v); b = Math.max(b, v); } return [a, b]; };
  const [x, y, z] = [range(s.x), range(s.y), range(s.z)];
  const extent = Math.max(1.6, x[1] - x[0], y[1] - y[0], z[1] - z[0]);
  const floor = Math.max(0, z[0] - 0.4 * extent); // the ground, or where it is far below, a grid that hovers
  return { x: (x[0] + x[1]) / 2, y: (y[0] + y[1]) / 2, z: Math.max(z[0] * 0.75 + z[1] * 0.25 - 0.08 * extent, floor + 0.2 * extent), extent, floor };
}
function rotation(roll, pitch, yaw) { // intrinsic z-y'-x''
  const [cr, sr, cp, sp, cy, sy] = [Math.cos(roll), Math.sin(roll), Math.cos(pitch), Math.sin(pitch), Math.cos(yaw), Math.sin(yaw)];
  return (x, y, z) => [
    cy * cp * x + (cy * sp * sr - sy * cr) * y + (cy * sp * cr + sy * sr) * z,
    sy * cp * x + (sy * sp * sr + cy * cr) * y + (sy * sp * cr - cy * sr) * z,
    -sp * x + cp * sr * y + cp * cr * z,
  ];
}
export function turnable(canvas) {
  const fingers = new Map();
  let gap = 0;
  canvas.onpointerdown = (event) => { fingers.set(event.pointerId, event); canvas.setPointerCapture(event.pointerId); };
  canvas.onpointermove = (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    fingers.set(event.pointerId, event);
    if (fingers.size === 2) {
      const [a, b] = [...fingers.values()], now = Math.hypot(a.offsetX - b.offsetX, a.offsetY - b.offsetY);
      if (gap) camera.zoom = Math.min(6, Math.max(0.4, (camera.zoom * now) / gap));
      gap = now;
    } else {
      camera.azimuth += (event.offsetX - before.offsetX) * 0.008;
      camera.elevation = Math.min(1.5, Math.max(0.02, camera.elevation + (event.offsetY - before.offsetY) * 0.006));
    }
    drawStage();
  };
  canvas.onpointerup = canvas.onpointercancel = (event) => { fingers.delete(event.pointerId); gap = 0; };
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.zoom = Math.min(6, Math.max(0.4, camera.zoom * Math.exp(-event.deltaY * 0.001)));
    drawStage();
  }, { passive: false });
}
export function player() {
  let last = null;
  const tick = (now) => {
    if (last === null) return;
    const most = Number($("clock").max), time = Math.min(most, state.time + ((now - last) / 1000) * Number($("speed").value));
    last = now;
    if (time >= most) stop();
    setTime(time);
    if (last !== null) requestAnimationFrame(tick);
  };
  const stop = () => { last = null; state.playing = false; $("play").textContent = "▶ Play"; };
  $("play").onclick = () => {
    if (last !== null) return stop();
    if (state.time >= Number($("clock").max)) state.time = 0;
    last = performance.now();
    state.playing = true;
    $("play").textContent = "❚❚ Pause";
    requestAnimationFrame(tick);
  };
  $("clock").oninput = () => setTime(Number($("clock").value));
}
