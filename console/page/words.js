// Words for what the service and its settings are called, and for the sentences that they send.

import { html } from "./vendor/preact.js";

// What settings are called. A key that several tables have is called alike unless its whole path is listed.
export const NAMES = {
  "board": "Board",
  "camera": "Camera",
  "networks": "Networks",
  "solver": "Blendshape model",
  "smoothing": "Smoothing",
  "wearer": "Wearer",
  "plausibility": "Plausible faces",
  "adjust": "Adjustments",
  "failsafe": "Without a face",
  "send": "Sending",
  "realtime": "Real time",
  "hardware": "Hardware",
  "adaptation": "Slow or hot boards",
  "metrics": "Metrics",
  "console": "Console",
  "log": "Log",
  "link": "Link",
  "channel": "Channel",
  "comments": "Comments",
  "camera.device": "Camera",
  "width": "Width of the picture",
  "height": "Height of the picture",
  "fps": "Frame rate",
  "format": "Pixel format",
  "rotation": "Turn of the picture",
  "stall_timeout_ms": "Longest pause of the camera",
  "horizontal_fov_deg": "Field of view",
  "networks.folder": "Folder of the networks",
  "engine": "Engine",
  "threads": "Threads",
  "solver.method": "Method",
  "model": "File of the model",
  "lids": "Filter of the lids",
  "lids_ms": "Time of the lids' filter",
  "gaze": "Filter of the gaze",
  "gaze_ms": "Time of the gaze's filter",
  "brows": "Filter of the brows",
  "brows_ms": "Time of the brows' filter",
  "mouth": "Filter of the mouth",
  "mouth_ms": "Time of the mouth's filter",
  "jaw": "Filter of the jaw",
  "jaw_ms": "Time of the jaw's filter",
  "cheeks": "Filter of cheeks and nose",
  "cheeks_ms": "Time of this filter",
  "head": "Filter of the head",
  "head_ms": "Time of the head's filter",
  "wearer.name": "Wearer at the start",
  "wearer.folder": "Folder of the profiles",
  "wearer.neutral": "Neutral face",
  "wearer.wears": "On the face",
  "wearer.follow": "Followed among several",
  "eye_distance_mm": "Distance between the pupils",
  "plausibility.lids": "Lids close alike",
  "plausibility.gaze": "Gaze stays in a blink",
  "opposed": "No opposite movements",
  "mouth_close": "Lips only close an open jaw",
  "dead_zone": "Dead zone",
  "mirror": "Mirror",
  "live_ms": "Live for",
  "hold_ms": "Held until",
  "neutral_ms": "Neutral from",
  "slew_per_s": "Fastest change",
  "send.rate_hz": "Packets per second",
  "lock_memory": "Keep memory in RAM",
  "realtime.priority": "Real-time priority",
  "hot_cpu": "Processor for frames",
  "sender_cpu": "Processor for packets",
  "thermal_zone": "Temperature sensor",
  "temperature_limit_c": "Hot from",
  "enabled": "Fewer frames on a slow board",
  "metrics.listen": "Address of the metrics",
  "picture": "Show the camera's picture",
  "names": "Names of this machine",
  "level": "Least severe level",
  "kind": "Kind",
  "address": "Address of the receiver",
  "pace": "When it sends",
  "rate_hz": "Messages per second",
  "loss": "Without a face",
  "device": "Serial port",
  "baud": "Baud rate",
  "subject": "Name of the subject",
  "device_id": "Name of the device",
  "swap_mouth": "Exchange mouth left and right",
  "bones": "Send head and eyes",
  "bundles": "Send bundles",
  "prefix": "Prefix of the parameters",
  "floats": "Parameters as numbers",
  "bits": "Bits of binary parameters",
  "shapes": "Single movements",
  "compounds": "Combined movements",
  "link.vrchat.head": "Turn of the head",
  "native_eyes": "Eyes by VRChat's own addresses",
  "parameters": "Parameters to send",
  "link.ifacialmocap.listen": "Where receivers ask",
  "reply_port": "Port of the receivers",
  "version": "Version of the protocol",
  "to": "Where the lines go",
  "protocol": "How commands begin",
  "device_number": "Number of the Maestro",
  "crc": "Checksums",
  "multiple_targets": "Several targets in one command",
  "read_errors": "Ask for errors",
  "bus": "Number of the I2C bus",
  "link.pca9685.address": "Address of the chip",
  "pulses_hz": "Pulses per second",
  "oscillator_hz": "Frequency of the oscillator",
  "family": "Family of the servos",
  "unit": "Unit of the positions",
  "universe": "Universe",
  "from": "Address to send from",
  "link.sacn.priority": "Priority of the source",
  "source": "Name of the source",
  "whole_face": "Whole face without channels",
  "stop": "After STOP",
  "link.ifacialmocap.address": "A receiver that does not ask",
  "link.channel.channel": "Number",
  "link.channel.name": "Name",
  "sources": "Follows",
  "offset": "Plus",
  "pulse_at_0_us": "Pulse at end 0",
  "pulse_at_1_us": "Pulse at end 1",
  "position_at_0": "Place at end 0",
  "position_at_1": "Place at end 1",
  "link.channel.neutral": "Rest",
  "speed_per_s": "Highest speed",
  "acceleration_per_s2": "Highest acceleration",
  "dmx": "Value in the universe",
  "stop_value": "Value after STOP",
};

// What kinds of links are called.
export const KINDS = {
  "udp": "facewire packets by UDP",
  "serial": "Microcontroller",
  "live-link": "Unreal (Live Link)",
  "vmc": "VMC",
  "vrchat": "VRChat",
  "maestro": "Pololu Maestro",
  "pca9685": "PCA9685",
  "bus-servo": "Bus servos",
  "sacn": "DMX by sACN",
  "artnet": "DMX by Art-Net",
  "ifacialmocap": "iFacialMocap",
  "json": "Lines of JSON",
};

// Returns the name of a setting at a path such as link.0.channel.2.neutral, or link.vrchat.head for a kind of links.
export function nameOf(path) {
  const keys = path.split(".").filter((key) => !/^\d+$/.test(key));
  const words = (key) => `${key[0].toUpperCase()}${key.slice(1).replaceAll("_", " ")}`;
  return NAMES[keys.join(".")] ?? NAMES[keys.at(-1)] ?? words(keys.at(-1) ?? path);
}

// What cannot be done on a page is not asked for: commands that start and stop services.
const COMMANDS = [
  [/ \(the service: `?(sudo )?systemctl stop [\w-]+`?\)/g, ""],
  [/ with `?(sudo )?systemctl stop [\w-]+`?/g, ""],
  [/ \(`?(sudo )?systemctl enable --now ([\w-]+)`?\)/g, ", if the service $2 runs"],
  [/`?(sudo )?systemctl (?:enable --now|start|restart) ([\w-]+)`?/g, "the service $2 to run"],
  [/`(sudo|systemctl) [^`]*`/g, "a command in a terminal"],
];

// Returns a text with what is between backticks set as code.
export function marked(text) {
  const plain = COMMANDS.reduce((sentence, [command, words]) => sentence.replace(command, words), String(text ?? ""));
  return plain.split("`").map((part, index) => (index % 2 === 1 ? html`<code>${part}</code>` : part));
}

// A clause of the service, which begins with a small letter and ends without a full stop, as a sentence.
const ended = (text) => `${text[0].toUpperCase()}${text.slice(1)}${/[.!?]$/.test(text) ? "" : "."}`;
export const sentence = (text) => marked(ended(text));

// What is wrong with a link: a clause for each of its servos.
export const sentences = (text) => marked(text.split("\n").map(ended).join("\n"));

// Returns the receiver of a link, and its trouble without the receiver, which stands in the name already.
const receiverOf = ({ name, kind }) => name.slice(kind.length).trim();
const troubleOf = (link) => {
  const before = `${receiverOf(link)}: `;
  return link.trouble?.startsWith(before) ? link.trouble.slice(before.length) : link.trouble;
};

const since = (s) => (s < 60 ? `${s} s` : s < 3600 ? `${Math.floor(s / 60)} min` : `${Math.floor(s / 3600)} h`);

// Kinds whose receivers need not answer, so that nobody knows whether they are there.
const SILENT = ["udp", "live-link", "vmc", "vrchat", "sacn", "artnet", "json", "ifacialmocap"];

// Returns how a link is, as words and their style, and what is wrong with it or what it waits for.
export function stateOfLink(link) {
  const [receiver, trouble] = [receiverOf(link), troubleOf(link)];
  const elsewhere = link.vrchat?.elsewhere.join(", ");
  const ofVrchat = (words, waits) => ({ kind: "dim", words, waits });
  const ago = link.answered_s_ago;
  const isFine = link.open && !trouble;
  if (isFine && link.vrchat?.answers) return { kind: "state-good", words: "answers" };
  if (isFine && elsewhere && !(ago < 10))
    return ofVrchat("VRChat answers elsewhere", `VRChat answers at ${elsewhere}; set this link's address to match`);
  const isUnheard = link.unheard && trouble?.startsWith("nobody listens ");
  const waits = isUnheard || (!link.open && trouble?.startsWith("waits for "));
  const why = waits ? { waits: trouble } : { trouble };
  const state = (kind, words) => ({ kind, words, ...why });
  if (waits) return state("dim", isUnheard ? "nobody listens" : "waiting");
  const is = (good, waiting) => (link.open ? state("state-good", good) : state("dim", waiting));
  const isAsked = receiver.startsWith("those who ask") && !receiver.includes(", and ");
  if (isAsked && !trouble) return is("a receiver asks for the face", "waiting for a receiver that asks");
  const isSocket = link.kind === "json" && receiver.startsWith("/");
  if (isSocket && !trouble) return is("a program reads", "waiting for a program that reads");
  const isSilent = SILENT.includes(link.kind);
  if (!link.open && !trouble) return state("dim", "not connected yet");
  if (!link.open) return state("state-bad", isSilent ? "not sending" : "not connected");
  if (isSilent && ago < 10) return state("state-good", "answers");
  if (link.vrchat && !trouble)
    return ofVrchat(
      "no answer",
      "is OSC switched on in VRChat, at Options > OSC > Enabled? A firewall that blocks mDNS can also be the cause",
    );
  if (isSilent) return state("dim", `sending to ${receiver}${ago === undefined ? "" : `, which answered ${since(ago)} ago`}`);
  return state("state-good", link.kind === "serial" ? "plugged in" : "connected");
}

// The name of a link, without a receiver that stands in its state.
export function titleOfLink(link) {
  const { words } = stateOfLink(link);
  const [kind, receiver] = [KINDS[link.kind] ?? link.kind, receiverOf(link)];
  return words.includes(receiver) || receiver === "auto" ? kind : `${kind} ${receiver}`;
}

// The state of a link beside its name.
export function LinkState({ link }) {
  const { kind, words } = stateOfLink(link);
  return html`<small class=${kind}>${words}</small>`;
}

// What is wrong with a link, or, without alarm, what it waits for.
export function LinkTrouble({ link }) {
  const { trouble, waits } = stateOfLink(link);
  if (waits) return html`<p class="dim">${sentence(waits)}</p>`;
  return trouble ? html`<p class="trouble" role="alert">${sentences(trouble)}</p>` : null;
}
