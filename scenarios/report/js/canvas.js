/* Drawing on a canvas: its size in pixels, the ticks of an axis, a line. */
export function prepare(canvas) {
  const [width, height, ratio] = [canvas.clientWidth, Number(canvas.dataset.height), devicePixelRatio || 1];
  canvas.style.height = height + "px";
  [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.font = "12px system-ui, sans-serif";
  return [pen, width, height];
}
export function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
  const out = [];
  for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step; v += step) out.push(Math.abs(v) < step * 1e-6 ? 0 : v);
  return [out, Math.max(0, -Math.floor(Math.log10(step)))];
}

export function rule(pen, x0, y0, x1, y1) { pen.beginPath(); pen.moveTo(x0, y0); pen.lineTo(x1, y1); pen.stroke(); }
