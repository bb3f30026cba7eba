/* What the time plot shows of a flight. */
export const RAD = Math.PI / 180;
const zip = (s, f) => Float32Array.from(s.roll, (_, k) => f(k));
const down = (roll, pitch) => [-Math.sin(pitch), Math.sin(roll) * Math.cos(pitch), Math.cos(roll) * Math.cos(pitch)];
export function inclination(s) {
  return zip(s, (k) => {
    const [a, b] = [down(s.roll[k] * RAD, s.pitch[k] * RAD), down(s.roll_est[k] * RAD, s.pitch_est[k] * RAD)];
    const cross = Math.hypot(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]);
    return Math.atan2(cross, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) / RAD;
  });
}
/** Whether there is wind in what the flights of a scenario share. */
export const windy = (shared) => ["wind_x", "wind_y", "wind_z"].some((name) => shared?.[name]?.some((v) => v !== 0));
export const QUANTITIES = {
  inclination: { label: "Inclination error [deg]", main: inclination },
  roll: { label: "Roll, estimated and true [deg]", main: (s) => s.roll_est, truth: (s) => s.roll },
  pitch: { label: "Pitch, estimated and true [deg]", main: (s) => s.pitch_est, truth: (s) => s.pitch },
  roll_error: { label: "Roll error [deg]", main: (s) => zip(s, (k) => s.roll_est[k] - s.roll[k]) },
  pitch_error: { label: "Pitch error [deg]", main: (s) => zip(s, (k) => s.pitch_est[k] - s.pitch[k]) },
  distance: { label: "Distance from the set point [m]", main: (s) => zip(s, (k) => Math.hypot(s.x[k] - s.x_ref[k], s.y[k] - s.y_ref[k], s.z[k] - s.z_ref[k])) },
  x: { label: "x and set point [m]", main: (s) => s.x, truth: (s) => s.x_ref },
  y: { label: "y and set point [m]", main: (s) => s.y, truth: (s) => s.y_ref },
  z: { label: "Height and set point [m]", main: (s) => s.z, truth: (s) => s.z_ref },
};
