// A recording: what arrives, as CSV with the columns of `facewire track`.

// Half an hour at 60 rows a second.
export const MOST_ROWS = 108_000;
// Rows are packed into blobs, which a browser may move to the disk.
const ROWS_OF_A_BLOB = 1000;
const PARTS = ["left_eye", "right_eye", "brows", "mouth", "cheeks", "face"];
const HEAD = ["head_yaw_deg", "head_pitch_deg", "head_roll_deg", "head_x_mm", "head_y_mm", "head_z_mm"];

export class Recorder {
  constructor(names) {
    this.blobs = [];
    this.rows = [["frame", "time_s", "state", ...names, ...HEAD, ...PARTS.map((part) => `visibility_${part}`)].join(",")];
    this.count = 0;
    // The packet at frame 0 and time 0, and the last row.
    this.origin = undefined;
    this.last = undefined;
  }

  get isFull() {
    return this.count >= MOST_ROWS;
  }

  // Adds a packet. The same packet is added once.
  add(packet) {
    if (packet.number === this.last?.number || this.isFull) return;
    if (packet.number < this.last?.number) this.goOn(packet);
    this.origin ??= { number: packet.number, time: packet.time_s };
    this.last = { number: packet.number, time: packet.time_s };
    this.count += 1;
    const visibility = PARTS.map((part) => packet.visibility[part]);
    const numbers = [...packet.coefficients, ...packet.angles_deg, ...packet.position_mm, ...visibility];
    const values = numbers.map((value) => value.toFixed(6));
    const time = (packet.time_s - this.origin.time).toFixed(6);
    this.rows.push([packet.number - this.origin.number, time, packet.state, ...values].join(","));
    if (this.rows.length >= ROWS_OF_A_BLOB) this.pack();
  }

  // Continues the numbers and times after a restart of facewire-console, which counts packets from 1 again.
  goOn({ number, time_s: time }) {
    this.origin = {
      number: number - 1 - (this.last.number - this.origin.number),
      time: time - (this.last.time - this.origin.time),
    };
  }

  pack() {
    this.blobs.push(new Blob([`${this.rows.join("\n")}\n`]));
    this.rows = [];
  }

  // Hands the file to the browser.
  save() {
    if (this.rows.length > 0) this.pack();
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob(this.blobs, { type: "text/csv" }));
    link.download = `facewire-${new Date().toISOString().slice(0, 19).replaceAll(":", "")}.csv`;
    link.click();
    // The browser has taken the file by then.
    setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
  }
}
