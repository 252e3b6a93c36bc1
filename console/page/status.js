// What the page says about the packets: state, numbers, notices, and help while nothing arrives.

const ms = (value) => (value >= 10_000 ? `${(value / 1000).toFixed(0)} s` : value >= 1000 ? `${(value / 1000).toFixed(1)} s` : `${value.toFixed(0)} ms`);

// Returns the state to show: a word for the style, and a text.
export function stateOf(snapshot, silence, { connection, status }) {
  if (connection !== "open") return ["lost", connection];
  if (status && !status.running) return ["lost", "service stopped"];
  if (status?.service?.released) return ["lost", "released"];
  if (status?.service?.driven) return ["hold", "driven by hand"];
  if (!snapshot?.packet) return ["waiting", "waiting for packets"];
  if (silence !== undefined) return ["silent", "silent: the face is neutral"];
  const { state, reason, visibility } = snapshot.packet;
  return [state, [reason === "none" ? state : `${state}: ${reason}`, ...coveredOf(visibility)].join(", ")];
}

// Names what is covered, of which less than half is in view: ["eyes covered", "mouth covered"]. The whole face is named only
// if no part is.
function coveredOf({ left_eye: left, right_eye: right, brows, mouth, cheeks, face }) {
  const isCovered = (value) => value < 0.5;
  const eyes = isCovered(left) ? (isCovered(right) ? "eyes" : "left eye") : isCovered(right) && "right eye";
  const parts = [eyes, isCovered(brows) && "brows", isCovered(mouth) && "mouth", isCovered(cheeks) && "cheeks"];
  const covered = parts.filter(Boolean);
  return (covered.length === 0 && isCovered(face) ? ["face"] : covered).map((part) => `${part} covered`);
}

// Returns the numbers to show, as pairs of a name and a text.
export function factsOf({ packet, packets, lost, refused, rate_hz: rate }, since) {
  const share = packets + lost > 0 ? (100 * lost) / (packets + lost) : 0;
  const [yaw, pitch, roll] = packet.angles_deg.map((angle) => angle.toFixed(0).replace("-0", "0"));
  // The longest age that a packet can carry means that no face was seen yet.
  const isAged = packet.age_ms < 6553;
  return [
    ["age of the pose", isAged ? ms(packet.age_ms + since) : "none yet"],
    ["rate", `${rate.toFixed(1)} / s`],
    ["lost", `${lost} (${share.toFixed(1)} %)`],
    ["neutral face", packet.neutral_face],
    ["packets", String(packets)],
    ["refused", String(refused)],
    ["yaw, pitch, roll", `${yaw}°, ${pitch}°, ${roll}°`],
    ["x, y, z in mm", packet.position_mm.join(", ")],
    ["from", packet.from],
  ];
}

export function noticeOf({ trouble, rival, refused, fault, packet, packets }) {
  if (trouble) return `Nothing can arrive: ${trouble}.`;
  if (rival) return `Two senders send here, ${packet.from} and ${rival}: the face jumps between them. Give each a port of its own.`;
  if (fault && refused > packets / 20) return `${refused} of what arrived were no packets. The last one: ${fault}.`;
  return "";
}

export function showState(element, [word, text]) {
  element.dataset.state = word;
  if (element.textContent !== text) element.textContent = text;
}

export function showFacts(element, facts) {
  if (element.children.length !== facts.length) {
    element.replaceChildren(...facts.map(([name]) => {
      const [item, term, value] = ["div", "dt", "dd"].map((tag) => document.createElement(tag));
      term.textContent = name;
      item.append(term, value);
      return item;
    }));
  }
  facts.forEach(([, text], index) => {
    const value = element.children[index].lastChild;
    if (value.textContent !== text) [value.textContent, value.title] = [text, text];
  });
}

// Says what to do so that packets arrive.
export function showHelp(element, { place, links }) {
  const make = (tag, text) => Object.assign(document.createElement(tag), { textContent: text });
  element.replaceChildren(
    make("h2", "No packet has arrived yet"),
    make("p", `This program waits for packets at ${place}. Start “facewire run” with settings that have these lines:`),
    ...links.flatMap(({ sender, lines }) => [make("p", `${sender}:`), make("pre", lines)]),
    make("p", "Settings that have a link replace the default links. After a change, start facewire again or reload it."),
    make("p", "If packets still do not arrive, check the firewall of this machine, and run “facewire check” where facewire runs."),
  );
}
