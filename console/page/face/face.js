// Draws the face: a camera in front of it, the head that moves, and its parts.

import { EYE } from "./form.js";
import { buildHead } from "./head.js";
import { about, clamp, perspective, product, rotation, translation, turn } from "./maths.js";
import { MovingHead } from "./morph.js";
import { cavity, ear, eyeball, neck, teeth, tongue } from "./parts.js";
import { FRAGMENT, KIND, VERTEX } from "./shaders.js";
import { JAW } from "./shapes-lower.js";
import { EYE_TURN, upperLidHeight } from "./shapes-upper.js";

const FIELD_OF_VIEW = 0.44;
const CAMERA = { y: -16, z: 730 };
// The head turns about the top of the spine.
const SPINE = { y: -72, z: -22 };
// Head movements are shown at this scale and within this distance, so that the face stays in the picture.
const MOVEMENT = { scale: 0.25, limit: 40 };
const STILL = translation(0, 0, 0);
const still = () => STILL;

export class Face {
  // Throws an error if the browser has no WebGL 2.
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true });
    if (!this.gl) throw new Error("no WebGL 2");
    const head = buildHead();
    this.head = new MovingHead(head);
    this.program = link(this.gl);
    // The side of its triangles that is not drawn, if any.
    const { BACK, FRONT } = this.gl;
    const part = (kind, mesh, matrix, hidden, side) => ({ kind, matrix, hidden, side, buffers: upload(this.gl, this.program, mesh) });
    this.parts = [
      part(KIND.skin, { ...head, normals: this.head.normals }, still, BACK),
      ...[1, -1].map((side) => part(KIND.eye, eyeball(), (pose) => gaze(pose, side), BACK, side)),
      part(KIND.teeth, teeth(1), still),
      part(KIND.teeth, teeth(-1), jaw),
      part(KIND.tongue, tongue(), tongueMatrix, BACK),
      part(KIND.cavity, cavity(), still, FRONT),
      part(KIND.cavity, cavity(), jaw, FRONT),
      ...[1, -1].map((side) => part(KIND.ear, ear(side), still)),
      part(KIND.neck, neck(), still, BACK),
    ];
    this.locations = Object.fromEntries(
      ["uHead", "uPart", "uCamera", "uKind", "uEye", "uLid", "uGreyness"].map((name) => [name, this.gl.getUniformLocation(this.program, name)]),
    );
    const { gl } = this;
    gl.useProgram(this.program);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  // Draws a pose: { weight: coefficient of a name, rotation, position, isLive, isMirrored }.
  draw(pose) {
    const { gl, locations } = this;
    this.fit();
    this.head.move(pose.weight);
    const [skin] = this.parts;
    refill(gl, skin.buffers.position, this.head.positions);
    refill(gl, skin.buffers.normal, this.head.normals);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.frontFace(pose.isMirrored ? gl.CW : gl.CCW);
    gl.uniformMatrix4fv(locations.uHead, false, headMatrix(pose));
    gl.uniformMatrix4fv(locations.uCamera, false, this.camera(pose.isMirrored));
    gl.uniform3f(locations.uEye, 0, CAMERA.y, CAMERA.z);
    gl.uniform1f(locations.uGreyness, pose.isLive ? 0 : 0.75);
    for (const part of this.parts) {
      gl.uniform1i(locations.uKind, part.kind);
      gl.uniform1f(locations.uLid, part.side ? upperLidHeight(pose.weight, part.side > 0 ? "Left" : "Right") : 0);
      gl.uniformMatrix4fv(locations.uPart, false, part.matrix(pose));
      gl.bindVertexArray(part.buffers.array);
      if (part.hidden) gl.cullFace(part.hidden);
      (part.hidden ? gl.enable : gl.disable).call(gl, gl.CULL_FACE);
      gl.drawElements(gl.TRIANGLES, part.buffers.count, gl.UNSIGNED_SHORT, 0);
    }
  }

  // Keeps the picture as sharp as the screen.
  fit() {
    const scale = Math.min(2, window.devicePixelRatio || 1);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((size) => Math.max(1, Math.round(size * scale)));
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
  }

  camera(isMirrored) {
    const aspect = this.canvas.width / this.canvas.height;
    // A narrow picture shows the whole width of the head.
    const view = perspective(aspect < 0.85 ? 2 * Math.atan((Math.tan(FIELD_OF_VIEW / 2) * 0.85) / aspect) : FIELD_OF_VIEW, aspect, 100, 2000);
    if (isMirrored) view[0] = -view[0];
    return product(view, translation(0, -CAMERA.y, -CAMERA.z));
  }
}

function headMatrix({ rotation: quaternion, position }) {
  const [x, y] = position.map((mm) => clamp(mm * MOVEMENT.scale, -MOVEMENT.limit, MOVEMENT.limit));
  // The position is that of the camera's picture: y points down, and z away from the camera. z stays, because nobody
  // knows at which distance the head is at rest.
  return product(translation(x, -y, 0), about(0, SPINE.y, SPINE.z, rotation(quaternion)));
}

function jaw({ weight }) {
  const shift = translation(JAW.side * (weight("jawLeft") - weight("jawRight")), 0, JAW.forward * weight("jawForward"));
  return product(shift, about(0, JAW.y, JAW.z, turn(0, JAW.turn * weight("jawOpen"))));
}

function tongueMatrix(pose) {
  const out = pose.weight("tongueOut");
  return product(jaw(pose), translation(0, 9 * out, 34 * out));
}

// Turns an eyeball. In and out are seen from the nose.
function gaze({ weight }, side) {
  const of = (name) => weight(`eyeLook${name}${side > 0 ? "Left" : "Right"}`);
  const yaw = side * EYE_TURN * (of("Out") - of("In"));
  const pitch = EYE_TURN * (of("Down") - of("Up"));
  return product(translation(side * EYE.x, EYE.y, EYE.z), turn(1, yaw), turn(0, pitch));
}

function link(gl) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

// Puts a mesh into the memory of the graphics card.
function upload(gl, program, { positions, normals, tints, indices }) {
  const array = gl.createVertexArray();
  gl.bindVertexArray(array);
  const attribute = (name, values, size, usage) => {
    const location = gl.getAttribLocation(program, name);
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, values, usage);
    if (location < 0) return buffer;
    gl.enableVertexAttribArray(location);
    gl.vertexAttribPointer(location, size, gl.FLOAT, false, 0, 0);
    return buffer;
  };
  const position = attribute("aPosition", positions, 3, gl.DYNAMIC_DRAW);
  const normal = attribute("aNormal", normals, 3, gl.DYNAMIC_DRAW);
  attribute("aRest", positions, 3, gl.STATIC_DRAW);
  attribute("aTint", tints, 4, gl.STATIC_DRAW);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
  return { array, position, normal, count: indices.length };
}

function refill(gl, buffer, values) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferSubData(gl.ARRAY_BUFFER, 0, values);
}
