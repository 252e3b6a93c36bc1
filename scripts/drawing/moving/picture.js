// Draws the frames of the moving picture, one after the other, and gives each to scripts/draw-moving.
//
// A frame shows what the camera sees, the head of the console with the coefficients of this frame, and the animatronic head
// with its servos where they go by the same coefficients.

import { Face } from "/console/page/face/face.js";
import { drawMachine } from "./machine.js";
import { positionsOf } from "./servos.js";

const WIDTH = 760;
const HEIGHT = 388;
const TOP = 12;
const PANEL_HEIGHT = 292;
const CAMERA = { left: 12, width: 218 };
const HEAD = { left: 240, width: 218 };
const MACHINE = { left: 468, width: 280 };
const CORNER = 10;
// The part of the camera's picture that is shown, in its pixels.
const CROP = { left: 134, top: 2, width: 326, height: 437 };
// The console's head is drawn larger than its panel, so that the camera is closer to it than on the console.
const HEAD_ZOOM = { scale: 1.17, down: 6 };

const COLOURS = {
  page: "#161d26",
  text: "#eef2f6",
  dim: "#9fb0c2",
  bar: "#2a3644",
  value: "#3d8fe0",
  headPanel: "#d5dfe8",
  machinePanel: "#222d3a",
};
// A pixel whose colour changes by no more than this is left as it was, so that the file stays small: a little in a frame that
// stays long, and more in one that passes.
const CHANGE = { ofLong: 3, ofShort: 12 };
const LONG_TICKS = 3;
const BARS = ["browInnerUp", "eyeBlinkLeft", "mouthSmileLeft", "jawOpen"];

const picture = document.getElementById("picture");
picture.width = WIDTH;
picture.height = HEIGHT;
const context = picture.getContext("2d", { alpha: false, willReadFrequently: true });
let shown;

async function main() {
  const rows = await (await fetch("rows.json")).json();
  const face = new Face(document.getElementById("face"));
  for (const [number, row] of rows.entries()) {
    const camera = await createImageBitmap(await (await fetch(`camera/${row.frame}.jpg`)).blob());
    face.draw(poseOf(row));
    drawFrame(row, camera, face.canvas);
    keepWhatChangesLittle(row.ticks >= LONG_TICKS ? CHANGE.ofLong : CHANGE.ofShort);
    await post(`frame/${String(number).padStart(3, "0")}.png`, await new Promise((done) => picture.toBlob(done, "image/png")));
  }
  await post("done", "");
}

async function post(path, body) {
  await fetch(path, { method: "POST", body });
}

// The pose as the console's head takes it.
function poseOf(row) {
  return {
    weight: (name) => Number(row[name] ?? 0),
    rotation: quaternionOf(...["yaw", "pitch", "roll"].map((name) => (Number(row[`head_${name}_deg`]) * Math.PI) / 180)),
    position: ["x", "y", "z"].map((axis) => Number(row[`head_${axis}_mm`])),
    isLive: row.state === "live",
    isMirrored: false,
  };
}

// The quaternion of a head that turns first, nods next and tilts last, as that of a packet.
function quaternionOf(yaw, pitch, roll) {
  const half = (angle, axis) => [0, 1, 2].map((k) => (k === axis ? Math.sin(angle / 2) : 0)).concat(Math.cos(angle / 2));
  return times(times(half(roll, 2), half(-pitch, 0)), half(yaw, 1));
}

function times([ax, ay, az, aw], [bx, by, bz, bw]) {
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

function drawFrame(row, camera, head) {
  context.fillStyle = COLOURS.page;
  context.fillRect(0, 0, WIDTH, HEIGHT);
  panel(CAMERA, COLOURS.page, () => {
    const { left, top, width, height } = CROP;
    context.drawImage(camera, left, top, width, height, 0, 0, CAMERA.width, PANEL_HEIGHT);
  });
  panel(HEAD, COLOURS.headPanel, () => {
    const height = PANEL_HEIGHT * HEAD_ZOOM.scale;
    const width = (height * head.width) / head.height;
    context.imageSmoothingQuality = "high";
    context.drawImage(head, (HEAD.width - width) / 2, (PANEL_HEIGHT - height) / 2 + HEAD_ZOOM.down, width, height);
  });
  panel(MACHINE, COLOURS.machinePanel, () => drawMachine(context, positionsOf(row)));
  label(CAMERA, "camera");
  label(HEAD, "blendshapes");
  label(MACHINE, "servos");
  arrow((CAMERA.left + CAMERA.width + HEAD.left) / 2);
  arrow((HEAD.left + HEAD.width + MACHINE.left) / 2);
  BARS.forEach((name, place) => bar(name, Number(row[name]), place));
}

function keepWhatChangesLittle(most) {
  const image = context.getImageData(0, 0, WIDTH, HEIGHT);
  const pixels = image.data;
  for (let at = 0; shown && at < pixels.length; at += 4) {
    const isKept = [0, 1, 2].every((channel) => Math.abs(pixels[at + channel] - shown[at + channel]) <= most);
    if (isKept) [0, 1, 2].forEach((channel) => (pixels[at + channel] = shown[at + channel]));
  }
  context.putImageData(image, 0, 0);
  shown = pixels;
}

// Draws the inside of a panel in coordinates that begin at its upper left corner.
function panel({ left, width }, colour, draw) {
  context.save();
  context.translate(left, TOP);
  context.beginPath();
  context.roundRect(0, 0, width, PANEL_HEIGHT, CORNER);
  context.clip();
  context.fillStyle = colour;
  context.fillRect(0, 0, width, PANEL_HEIGHT);
  draw();
  context.restore();
}

function label({ left, width }, text) {
  context.font = "bold 21px 'DejaVu Sans', sans-serif";
  context.textAlign = "center";
  context.fillStyle = COLOURS.text;
  context.fillText(text, left + width / 2, TOP + PANEL_HEIGHT + 27);
}

// An arrow between two labels: the one leads to the other.
function arrow(x) {
  const y = TOP + PANEL_HEIGHT + 20;
  context.strokeStyle = COLOURS.dim;
  context.lineWidth = 3;
  context.beginPath();
  context.moveTo(x - 4, y - 7);
  context.lineTo(x + 4, y);
  context.lineTo(x - 4, y + 7);
  context.stroke();
}

function bar(name, value, place) {
  const gap = 10;
  const width = (WIDTH - 2 * CAMERA.left - (BARS.length - 1) * gap) / BARS.length;
  const left = CAMERA.left + place * (width + gap);
  const top = HEIGHT - 44;
  context.fillStyle = COLOURS.bar;
  context.fillRect(left, top, width, 32);
  context.fillStyle = COLOURS.value;
  context.fillRect(left, top, width * value, 32);
  context.font = "18px 'DejaVu Sans', sans-serif";
  context.textAlign = "left";
  context.fillStyle = COLOURS.text;
  context.fillText(name, left + 10, top + 22);
}

main().catch((error) => post("failed", String(error.stack ?? error)));
