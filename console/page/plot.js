// The plot of chosen coefficients over the last seconds.

const SECONDS = 10;
const COLOURS = ["#2a9bb0", "#e07b39", "#7a5cc9", "#3f9a4c", "#d0488c", "#9a8a1f"];
// Room for 60 samples a second, and some more.
const MOST_SAMPLES = 60 * SECONDS + 60;

export class Plot {
  constructor(canvas, legend, names) {
    this.canvas = canvas;
    this.legend = legend;
    this.names = names;
    this.samples = [];
    this.colours = new Map();
  }

  // Adds or removes a coefficient. If all colours are in use, this removes the coefficient that was chosen first.
  toggle(index) {
    if (!this.colours.delete(index)) {
      if (this.colours.size === COLOURS.length) this.colours.delete(this.colours.keys().next().value);
      const used = new Set(this.colours.values());
      this.colours.set(index, COLOURS.find((colour) => !used.has(colour)));
    }
    this.legend.replaceChildren(...[...this.colours].map(([chosen, colour]) => {
      const item = document.createElement("li");
      item.textContent = this.names[chosen];
      item.style.setProperty("--colour", colour);
      return item;
    }));
  }

  clear() {
    this.samples = [];
  }

  add(time, coefficients) {
    this.samples.push({ time, coefficients });
    while (this.samples.length > MOST_SAMPLES || time - this.samples[0].time > SECONDS) this.samples.shift();
  }

  draw(now) {
    const { canvas } = this;
    const scale = Math.min(2, window.devicePixelRatio || 1);
    const [width, height] = [Math.round(canvas.clientWidth * scale), Math.round(canvas.clientHeight * scale)];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    const pad = 3 * scale;
    const x = (time) => width * (1 - (now - time) / SECONDS);
    const y = (value) => pad + (1 - value) * (height - 2 * pad);
    context.lineWidth = 1;
    context.strokeStyle = getComputedStyle(canvas).getPropertyValue("--line");
    for (const level of [0, 0.5, 1]) line(context, [[0, y(level)], [width, y(level)]]);
    context.lineWidth = 2 * scale;
    context.lineJoin = "round";
    for (const [index, colour] of this.colours) {
      context.strokeStyle = colour;
      line(context, this.samples.map(({ time, coefficients }) => [x(time), y(coefficients[index])]));
    }
  }
}

function line(context, points) {
  context.beginPath();
  for (const [x, y] of points) context.lineTo(x, y);
  context.stroke();
}
