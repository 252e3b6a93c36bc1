// Draws an animatronic head with twelve servos. Each part moves with the horn of its servo, to which a rod joins it.
//
// Parts lie in sheets at several depths, which turn with the neck. x points to the head's left, which is right in the
// picture, y down and z out of the face. The middle of the head is at 0.

const SCALE = 0.93;
const MIDDLE = { x: 140, y: 117 };
const NECK = { y: 96, z: -24 };
const COLOURS = {
  back: "#3b4a5b",
  frame: "#506379",
  edge: "#8aa0b6",
  socket: "#141b24",
  eyeball: "#f4f7fa",
  iris: "#2f86dd",
  lid: "#f0a73c",
  lowerLid: "#c98624",
  brow: "#f0a73c",
  lip: "#e8685f",
  teeth: "#f4f7fa",
  jaw: "#6c8199",
  servo: "#1a2431",
  horn: "#4fd07a",
  rod: "#dbe4ec",
};
// The outlines of the head at its back and at its front.
const BACK = "M0-116C60-116 84-74 80-14C78 30 70 66 56 92H-56C-70 66-78 30-80-14C-84-74-60-116 0-116z";
const FRONT = "M0-108C52-108 74-72 71-14C70 22 64 44 56 58H-56C-64 44-70 22-71-14C-74-72-52-108 0-108z";
const SIDES = [["left", 1], ["right", -1]];
const EYE = { x: 36, y: -8, radius: 25, z: 36 };
// How far the horn of most servos turns to either side, in degrees.
const TRAVEL = 50;

const radians = (degrees) => (degrees * Math.PI) / 180;
// The angle of a horn, 0 in the middle of its way.
const turned = (position, travel = TRAVEL) => radians((2 * position - 1) * travel);

export function drawMachine(context, positions) {
  context.lineJoin = "round";
  context.lineCap = "round";
  const machine = new Machine(context, positions);
  machine.neck();
  machine.skull();
  machine.mouth();
  SIDES.forEach(([side, sign]) => machine.eye(side, sign));
  machine.gaze();
  SIDES.forEach(([side, sign]) => machine.brow(side, sign));
}

class Machine {
  constructor(context, positions) {
    this.context = context;
    this.positions = positions;
    const [turn, left, right] = ["turn", "left", "right"].map((name) => positions[`neck ${name}`]);
    // What the neck makes of its three servos: the inverse of their channels.
    const yaw = radians((turn - 0.5) / 0.0125);
    const pitch = radians(((left + right) / 2 - 0.5) / 0.015);
    const roll = radians((left - right) / 2 / 0.01);
    this.rotation = rotation(yaw, pitch, roll);
    this.base = context.getTransform().translate(MIDDLE.x, MIDDLE.y).scale(SCALE);
  }

  // Where a point of the head is in the picture.
  point(x, y, z) {
    const from = [x, NECK.y - y, z - NECK.z];
    const [across, up] = this.rotation.map((row) => row.reduce((sum, part, k) => sum + part * from[k], 0));
    return [across, NECK.y - up];
  }

  // Draws in a sheet of the head at a depth.
  sheet(z, draw) {
    const origin = this.point(0, 0, z);
    const [right, down] = [this.point(1, 0, z), this.point(0, 1, z)];
    const parts = [right, down].flatMap(([x, y]) => [x - origin[0], y - origin[1]]);
    this.context.save();
    this.context.setTransform(this.base.multiply(new DOMMatrix([...parts, ...origin])));
    draw(this.context);
    this.context.restore();
  }

  // Draws what does not turn with the head.
  still(draw) {
    this.context.save();
    this.context.setTransform(this.base);
    draw(this.context);
    this.context.restore();
  }

  // Draws the rod between two points of the picture.
  rod(from, to, width = 4) {
    this.still((context) => {
      line(context, [from, to], COLOURS.socket, width + 3);
      line(context, [from, to], COLOURS.rod, width);
      [from, to].forEach(([x, y]) => disc(context, x, y, 4, COLOURS.rod, COLOURS.socket, 1.5));
    });
  }

  neck() {
    const positions = this.positions;
    this.still((context) => {
      shape(context, "M-26 60H26V176H-26z", COLOURS.back, COLOURS.edge);
      for (let y = 118; y < 160; y += 12) line(context, [[-26, y], [26, y]], COLOURS.edge, 2);
      ellipse(context, 0, 172, 58, 15, COLOURS.frame, COLOURS.edge);
    });
    // The horn of the servo that turns the neck points out of the picture, and is seen from above.
    const angle = turned(positions["neck turn"], 90);
    this.still((context) => {
      const end = [48 * Math.sin(angle), 172 + 11 * Math.cos(angle)];
      line(context, [[0, 172], end], COLOURS.servo, 13);
      line(context, [[0, 172], end], COLOURS.horn, 9);
      ellipse(context, 0, 172, 9, 5, COLOURS.horn, COLOURS.servo);
    });
    for (const [side, sign] of SIDES) {
      const hub = [sign * 104, 154];
      const end = hornEnd(hub, -sign, 26, turned(positions[`neck ${side}`], 70));
      this.rod(end, this.point(sign * 56, 84, -20), 5);
      this.still((context) => drawServo(context, hub, end));
    }
  }

  skull() {
    this.sheet(-22, (context) => shape(context, BACK, COLOURS.back, COLOURS.edge));
    this.sheet(14, (context) => shape(context, FRONT, COLOURS.frame, COLOURS.edge));
  }

  // The jaw with its servo, and the mouth, whose lower lip the jaw moves.
  mouth() {
    const hub = [-100, 104];
    const end = hornEnd(hub, 1, 25, -turned(this.positions.jaw));
    const shut = hornEnd(hub, 1, 25, -turned(0));
    const drop = end[1] - shut[1];
    const [side, low, chin] = [84 + drop, 112 + drop, 122 + drop];
    const jaw = `M-50 50V${side}C-46 ${low}-24 ${chin} 0 ${chin}C24 ${chin} 46 ${low} 50 ${side}V50z`;
    this.sheet(20, (context) => shape(context, jaw, COLOURS.jaw, COLOURS.edge));
    const corners = SIDES.map(([name, sign]) => this.corner(name, sign));
    this.lips(corners.map(({ at }) => at), drop);
    for (const corner of corners) {
      this.rod(this.point(...corner.end, 10), this.point(...corner.at, 40));
      this.sheet(10, (context) => drawServo(context, corner.hub, corner.end));
    }
    this.rod(this.point(...end, 10), this.point(-46, 98 + drop, 24));
    this.sheet(10, (context) => drawServo(context, hub, end));
  }

  lips([[leftX, leftY], [rightX, rightY]], drop) {
    const corners = (leftY + rightY) / 2;
    const top = 2 * 68 - corners;
    const bottom = 2 * (74 + drop) - corners;
    const lips = new Path2D(`M${rightX} ${rightY}Q0 ${top} ${leftX} ${leftY}Q0 ${bottom} ${rightX} ${rightY}z`);
    this.sheet(40, (context) => {
      context.fillStyle = COLOURS.socket;
      context.fill(lips);
      context.save();
      context.clip(lips);
      teeth(context, 60, 16);
      teeth(context, 72 + drop, 18);
      context.restore();
      context.strokeStyle = COLOURS.lip;
      context.lineWidth = 7;
      context.stroke(lips);
    });
  }

  // Where a corner of the mouth is, and its servo.
  corner(side, sign) {
    const hub = [sign * 100, 56];
    const angle = turned(this.positions[`${side} corner of the mouth`]);
    const end = hornEnd(hub, -sign, 25, angle);
    return { hub, end, at: [sign * (32 + 8 * Math.sin(angle)), end[1] + 1] };
  }

  eye(side, sign) {
    const { positions } = this;
    const [yaw, pitch] = [turned(positions["eyes sideways"], 45), turned(positions["eyes up and down"], 40)];
    const hub = [sign * 102, EYE.y];
    const end = hornEnd(hub, -sign, 22, turned(positions[`${side} upper lid`]));
    this.sheet(EYE.z, (context) => {
      context.translate(sign * EYE.x, EYE.y);
      disc(context, 0, 0, EYE.radius + 3, COLOURS.socket, COLOURS.edge);
      disc(context, 0, 0, EYE.radius, COLOURS.eyeball);
      context.save();
      context.beginPath();
      context.arc(0, 0, EYE.radius, 0, 2 * Math.PI);
      context.clip();
      const [x, y] = [EYE.radius * Math.sin(yaw) * Math.cos(pitch), -EYE.radius * Math.sin(pitch)];
      disc(context, x, y, 12, COLOURS.iris, "#123a66", 2);
      disc(context, x, y, 5.5, "#0c1118");
      disc(context, x + 4, y - 4, 2.5, "#ffffff");
      context.restore();
      lids(context, positions[`${side} upper lid`]);
    });
    this.rod(this.point(...end, 8), this.point(sign * (EYE.x + EYE.radius), end[1], EYE.z));
    this.sheet(8, (context) => drawServo(context, hub, end));
  }

  // The two servos that turn both eyes: one on the forehead, whose rod goes up and down, and one in place of the nose.
  gaze() {
    const up = [-17, -66];
    const upEnd = hornEnd(up, 1, 19, turned(this.positions["eyes up and down"]));
    const yoke = upEnd[1] + 56;
    this.rod(this.point(upEnd[0], yoke, 40), this.point(...upEnd, 40));
    this.sheet(40, (context) => line(context, [[-8, yoke], [12, yoke]], COLOURS.rod, 5));
    this.sheet(40, (context) => drawServo(context, up, upEnd, 0.75));
    const side = [0, 44];
    const angle = turned(this.positions["eyes sideways"]);
    const sideEnd = [side[0] + 20 * Math.sin(angle), side[1] - 20 * Math.cos(angle)];
    this.rod(this.point(sideEnd[0] - EYE.x, 23, 44), this.point(sideEnd[0] + EYE.x, 23, 44));
    this.sheet(46, (context) => drawServo(context, side, sideEnd, 0.75));
  }

  brow(side, sign) {
    const hub = [sign * 34, -82];
    const end = hornEnd(hub, sign, 23, turned(this.positions[`${side} brow`], 60));
    const rise = end[1] - hub[1];
    this.rod(this.point(...end, 32), this.point(end[0], rise - 42, 40));
    this.sheet(40, (context) => {
      const arch = new Path2D(`M${sign * 14} ${rise - 38}Q${sign * 40} ${rise - 53} ${sign * 64} ${rise - 36}`);
      for (const [colour, width] of [[COLOURS.servo, 12], [COLOURS.brow, 8]]) {
        context.strokeStyle = colour;
        context.lineWidth = width;
        context.stroke(arch);
      }
    });
    this.sheet(32, (context) => drawServo(context, hub, end, 0.85));
  }
}

// The rows of the matrix of a head that turns first, nods next and tilts last; y points up.
function rotation(yaw, pitch, roll) {
  const [sy, cy, sp, cp, sr, cr] = [yaw, pitch, roll].flatMap((angle) => [Math.sin(angle), Math.cos(angle)]);
  return [
    [cr * cy + sr * sp * sy, -sr * cp, cr * sy - sr * sp * cy],
    [sr * cy - cr * sp * sy, cr * cp, sr * sy + cr * sp * cy],
  ];
}

// The end of a horn that points to a side in its middle, and upwards with a positive angle.
function hornEnd([x, y], direction, length, angle) {
  return [x + direction * length * Math.cos(angle), y - length * Math.sin(angle)];
}

function drawServo(context, [x, y], end, size = 1) {
  const [width, height] = [26 * size, 32 * size];
  context.beginPath();
  context.roundRect(x - width / 2, y - height / 2, width, height, 4);
  paint(context, COLOURS.servo, COLOURS.edge, 2);
  line(context, [[x, y], end], COLOURS.socket, 14 * size);
  line(context, [[x, y], end], COLOURS.horn, 10 * size);
  disc(context, x, y, 8.5 * size, COLOURS.horn, COLOURS.socket, 2);
  disc(context, ...end, 2.5, COLOURS.socket);
}

// Both lids: the upper one is a shell that turns about the eye from wide open (1) to shut (0), the lower one stands still.
function lids(context, position) {
  const radius = EYE.radius + 1.5;
  const height = (degrees) => radius * Math.sin(radians(degrees));
  const [meeting, wide] = [-38, 65];
  const low = height(meeting);
  const edge = height(meeting + (wide - meeting) * position);
  context.beginPath();
  context.arc(0, 0, radius, radians(-meeting), Math.PI + radians(meeting));
  context.ellipse(0, -low, halfWidth(radius, low), 4, 0, Math.PI, 0, true);
  context.closePath();
  paint(context, COLOURS.lowerLid, COLOURS.socket, 2);
  const angle = Math.asin(edge / radius);
  context.beginPath();
  context.arc(0, 0, radius, Math.PI + angle, -angle);
  context.ellipse(0, -edge, halfWidth(radius, edge), 0.28 * Math.abs(edge) + 1, 0, 0, Math.PI, edge > 0);
  context.closePath();
  paint(context, COLOURS.lid, COLOURS.socket, 2);
}

// Half the width of a ball at a height above its middle.
function halfWidth(radius, height) {
  return Math.sqrt(radius * radius - height * height);
}

function teeth(context, top, height) {
  context.fillStyle = COLOURS.teeth;
  context.fillRect(-34, top, 68, height);
  for (let x = -24; x <= 24; x += 12) line(context, [[x, top], [x, top + height]], "#9aa9b8", 1.5);
}

function paint(context, fill, stroke, width = 2.5) {
  if (fill) {
    context.fillStyle = fill;
    context.fill();
  }
  if (!stroke) return;
  context.strokeStyle = stroke;
  context.lineWidth = width;
  context.stroke();
}

function shape(context, path, fill, stroke) {
  const outline = new Path2D(path);
  context.fillStyle = fill;
  context.fill(outline);
  context.strokeStyle = stroke;
  context.lineWidth = 2.5;
  context.stroke(outline);
}

function disc(context, x, y, radius, fill, stroke, width) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  paint(context, fill, stroke, width);
}

function ellipse(context, x, y, across, down, fill, stroke) {
  context.beginPath();
  context.ellipse(x, y, across, down, 0, 0, 2 * Math.PI);
  paint(context, fill, stroke);
}

function line(context, points, colour, width) {
  context.beginPath();
  points.forEach(([x, y]) => context.lineTo(x, y));
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.stroke();
}
