// The bars of all coefficients, in groups. Each is a button that adds its coefficient to the plot.

export const GROUPS = [
  ["Eyes", /^eye/],
  ["Brows, cheeks, nose", /^(brow|cheek|nose)/],
  ["Jaw, tongue", /^(jaw|tongue)/],
  ["Mouth", /^mouth/],
];

export class Bars {
  // Calls `toggle` with the index of a coefficient that was chosen.
  constructor(parent, names, toggle) {
    this.parent = parent;
    this.bars = new Array(names.length);
    parent.replaceChildren();
    for (const [title, pattern] of GROUPS) {
      const members = names.map((name, index) => ({ name, index })).filter(({ name }) => pattern.test(name));
      const heading = document.createElement("h2");
      heading.textContent = title;
      const list = document.createElement("div");
      list.className = "bars";
      list.append(...paired(members, names).map((member) => this.bar(member, toggle)));
      parent.append(heading, list);
    }
  }

  bar({ name, index, isAlone }, toggle) {
    const button = document.createElement("button");
    button.type = "button";
    button.className = isAlone ? "bar alone" : "bar";
    button.dataset.name = name;
    button.setAttribute("aria-pressed", "false");
    const [fill, label, number] = ["i", "span", "b"].map((tag) => document.createElement(tag));
    label.textContent = name;
    number.textContent = "0.00";
    button.append(fill, label, number);
    button.addEventListener("click", () => toggle(index));
    this.bars[index] = { button, fill, number, shown: 0 };
    return button;
  }

  show(coefficients, isLive) {
    this.parent.classList.toggle("stale", !isLive);
    coefficients.forEach((value, index) => {
      const bar = this.bars[index];
      if (bar.shown === value) return;
      bar.shown = value;
      bar.fill.style.transform = `scaleX(${value})`;
      bar.number.textContent = value.toFixed(2);
    });
  }

  // Marks the chosen coefficients with the colours of their lines.
  mark(colours) {
    this.bars.forEach(({ button }, index) => {
      const colour = colours.get(index);
      button.setAttribute("aria-pressed", String(colour !== undefined));
      button.style.setProperty("--colour", colour ?? "");
    });
  }
}

// Puts the right side first, because it is on the left of the picture, and what has one side in a row of its own.
function paired(members, names) {
  const sideless = members.filter(({ name }) => !/(Left|Right)$/.test(name));
  const pairs = members.filter(({ name }) => /Left$/.test(name));
  return [
    ...pairs.flatMap((left) => {
      const right = left.name.replace(/Left$/, "Right");
      return [{ name: right, index: names.indexOf(right) }, left];
    }),
    ...sideless.map((member) => ({ ...member, isAlone: sideless.length % 2 === 1 && member === sideless.at(-1) })),
  ];
}
