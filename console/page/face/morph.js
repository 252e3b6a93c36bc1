// The moving head: adds up shapes by their coefficients, keeps the lids on the eyeballs, and computes the normals.

import { EYE, onEyeball, eyeDistance } from "./form.js";
import { softMax } from "./maths.js";
import { LOWER_SHAPES } from "./shapes-lower.js";
import { UPPER_SHAPES } from "./shapes-upper.js";

// A smaller movement is none, millimetres.
const NEGLIGIBLE = 0.02;

export class MovingHead {
  constructor(head) {
    this.rest = head.positions;
    this.indices = head.indices;
    this.positions = head.positions.slice();
    this.normals = new Float32Array(head.positions.length);
    this.shapes = new Map();
    const points = pointsOf(head);
    for (const family of [UPPER_SHAPES, LOWER_SHAPES]) {
      for (const [name, move] of Object.entries(family.one)) this.shapes.set(name, sparse(points, move, 1));
      for (const [name, move] of Object.entries(family.sided)) {
        this.shapes.set(`${name}Left`, sparse(points, move, 1));
        this.shapes.set(`${name}Right`, sparse(points, move, -1));
      }
    }
    this.lids = [...points.keys()].filter((i) => points[i].z > EYE.z && eyeDistance(points[i].x, points[i].y) < 3);
  }

  // Moves the head. `weight` returns the coefficient of a name.
  move(weight) {
    this.positions.set(this.rest);
    for (const [name, { indices, moves }] of this.shapes) {
      const amount = weight(name);
      if (amount > 0) add(this.positions, indices, moves, amount);
    }
    this.rideEyeballs();
    this.computeNormals();
  }

  // Lids run over the eyeball instead of through it.
  rideEyeballs() {
    const { positions } = this;
    for (const i of this.lids) {
      const at = 3 * i;
      const ball = onEyeball(positions[at], positions[at + 1], EYE.lid - 0.3);
      // Insides of lids lie behind the surface of the ball.
      const isInside = this.rest[at + 2] < (onEyeball(this.rest[at], this.rest[at + 1], 0) ?? -Infinity);
      if (ball !== undefined && !isInside) positions[at + 2] = softMax(positions[at + 2], ball, 0.4);
    }
  }

  computeNormals() {
    const { positions: p, normals: n, indices } = this;
    n.fill(0);
    for (let t = 0; t < indices.length; t += 3) {
      const [a, b, c] = [3 * indices[t], 3 * indices[t + 1], 3 * indices[t + 2]];
      const [ux, uy, uz] = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
      const [vx, vy, vz] = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
      const [x, y, z] = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
      n[a] += x; n[a + 1] += y; n[a + 2] += z;
      n[b] += x; n[b + 1] += y; n[b + 2] += z;
      n[c] += x; n[c + 1] += y; n[c + 2] += z;
    }
  }
}

function pointsOf(head) {
  return head.parts.map((part, i) => {
    const [x, y, z] = head.positions.subarray(3 * i, 3 * i + 3);
    return { x, y, z, part, above: y - head.edges[i] };
  });
}

// Lists the points that a shape moves. `side` is 1 for the person's left and -1 for the right.
function sparse(points, move, side) {
  const [indices, moves] = [[], []];
  points.forEach((point, i) => {
    const moved = move({ ...point, x: side * point.x });
    if (!moved) return;
    const [dx, dy, dz] = moved;
    if (Math.abs(dx) + Math.abs(dy) + Math.abs(dz) < NEGLIGIBLE) return;
    indices.push(i);
    moves.push(side * dx, dy, dz);
  });
  return { indices: new Uint16Array(indices), moves: new Float32Array(moves) };
}

function add(positions, indices, moves, amount) {
  for (let k = 0; k < indices.length; k += 1) {
    const at = 3 * indices[k];
    positions[at] += amount * moves[3 * k];
    positions[at + 1] += amount * moves[3 * k + 1];
    positions[at + 2] += amount * moves[3 * k + 2];
  }
}
