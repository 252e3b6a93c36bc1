// Numbers, falloffs and 4 x 4 matrices (column by column, as WebGL takes them).

export const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
export const mix = (from, to, part) => from + (to - from) * part;
export const gauss = (distance) => Math.exp(-distance * distance);

// Rises from 0 at `from` to 1 at `to`, smoothly.
export function smoothstep(from, to, value) {
  const part = clamp((value - from) / (to - from), 0, 1);
  return part * part * (3 - 2 * part);
}

// A round hill around a point: 1 on its top.
export const hill = (x, y, atX, atY, widthX, widthY) => gauss(Math.hypot((x - atX) / widthX, (y - atY) / widthY));

// The larger of two numbers, rounded off where they are closer than `soft`.
export function softMax(a, b, soft) {
  const part = clamp(0.5 + (a - b) / (2 * soft), 0, 1);
  return mix(b, a, part) + soft * part * (1 - part);
}

// A smooth curve through points [x, ...values] with rising x; returns the values at x. Monotone cubic in each value.
export function curve(points) {
  const slope = (i, k) => {
    if (i <= 0 || i >= points.length - 1) return 0;
    const before = (points[i][k] - points[i - 1][k]) / (points[i][0] - points[i - 1][0]);
    const after = (points[i + 1][k] - points[i][k]) / (points[i + 1][0] - points[i][0]);
    return before * after <= 0 ? 0 : (2 * before * after) / (before + after);
  };
  return (x) => {
    let i = 0;
    while (i < points.length - 2 && x > points[i + 1][0]) i += 1;
    const [from, to] = [points[i], points[i + 1]];
    const width = to[0] - from[0];
    const t = clamp((x - from[0]) / width, 0, 1);
    return from.slice(1).map((value, k) => {
      const [m0, m1] = [slope(i, k + 1) * width, slope(i + 1, k + 1) * width];
      const [t2, t3] = [t * t, t * t * t];
      return (2 * t3 - 3 * t2 + 1) * value + (t3 - 2 * t2 + t) * m0 + (3 * t2 - 2 * t3) * to[k + 1] + (t3 - t2) * m1;
    });
  };
}

export function multiply(a, b) {
  const out = new Float32Array(16);
  for (let column = 0; column < 4; column += 1) {
    for (let row = 0; row < 4; row += 1) {
      let sum = 0;
      for (let k = 0; k < 4; k += 1) sum += a[k * 4 + row] * b[column * 4 + k];
      out[column * 4 + row] = sum;
    }
  }
  return out;
}

export const product = (...matrices) => matrices.reduce(multiply);

export const translation = (x, y, z) => new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1]);

// The rotation of a unit quaternion x y z w.
export function rotation([x, y, z, w]) {
  return new Float32Array([
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), 0,
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), 0,
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), 0,
    0, 0, 0, 1,
  ]);
}

export function turn(axis, radians) {
  const quaternion = [0, 0, 0, Math.cos(radians / 2)];
  quaternion[axis] = Math.sin(radians / 2);
  return rotation(quaternion);
}

// A rotation about a point.
export const about = (x, y, z, matrix) => product(translation(x, y, z), matrix, translation(-x, -y, -z));

export function perspective(fieldOfView, aspect, near, far) {
  const f = 1 / Math.tan(fieldOfView / 2);
  const out = new Float32Array(16);
  out[0] = f / aspect;
  out[5] = f;
  out[10] = (far + near) / (near - far);
  out[11] = -1;
  out[14] = (2 * far * near) / (near - far);
  return out;
}
