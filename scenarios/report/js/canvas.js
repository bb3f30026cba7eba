/* Drawing on a canvas: its size in pixels, a line. */
export function prepare(canvas) {
  const [width, height, ratio] = [canvas.clientWidth, Number(canvas.dataset.height), devicePixelRatio || 1];
  canvas.style.height = height + "px";
  [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.font = "12px system-ui, sans-serif";
  return [pen, width, height];
}
export function rule(pen, x0, y0, x1, y1) { pen.beginPath(); pen.moveTo(x0, y0); pen.lineTo(x1, y1); pen.stroke(); }
