// Servos: a card for each channel, arming, and a puppet.

import { Action, LetMove, Trouble, useEvery } from "./common.js";
import { change, draft, isBoard, isDmx, useDraft } from "./draft.js";
import { Drive } from "./drive.js";
import { learn } from "./learn.js";
import { Puppet } from "./puppet.js";
import { Check, Choice, Entry, Slider } from "./hand.js";
import { get, hasService, mayOperate, store, update, useStore } from "./store.js";
import { SETS } from "./sets.js";
import { html, useEffect, useMemo, useState } from "./vendor/preact.js";
import { KINDS, LinkState, LinkTrouble, titleOfLink } from "./words.js";

const STATUS_PERIOD_MS = 250;
// What the number of a channel is, its bounds, and what a channel is called.
const NUMBERS = {
  maestro: ["Channel on the board", 0, 23, "channel"],
  pca9685: ["Channel on the board", 0, 15, "channel"],
  "bus-servo": ["ID of the servo", 1, 252, "servo"],
  sacn: ["Address in the universe", 1, 512, "channel"],
  artnet: ["Address in the universe", 1, 512, "channel"],
};
const HEAD_SOURCES = ["headYaw", "headPitch", "headRoll"];
// At this factor the head goes from one end to the other while it turns by 80 degrees.
const HEAD_FACTOR = 0.0125;
const DEFAULTS = {
  name: "",
  sources: {},
  offset: 0,
  pulse_at_0_us: 1000,
  pulse_at_1_us: 2000,
  position_at_0: 0,
  position_at_1: 0,
  neutral: -1,
  speed_per_s: 0,
  acceleration_per_s2: 0,
  dead_zone: 0,
  loss: "neutral",
  dmx: "8-bit",
};
const FORMS = [
  ["8-bit", "8 bits: 1 to 255"],
  ["16-bit", "16 bits at two addresses"],
  ["microseconds", "microseconds at two addresses"],
];

const isBus = (link) => link.kind === "bus-servo";
// What distinguishes a board from others: all its settings but those of its channels.
const identity = ({ channel, ...board }) => JSON.stringify(Object.entries(board).sort());

// Returns for each link of the draft its place among the kept links, by which the service knows it, or undefined if the draft has
// added or changed it.
function keptPlaces(links) {
  const kept = (draft.used.link ?? []).map(identity);
  return links.map((link) => {
    const place = kept.indexOf(identity(link));
    if (place < 0) return undefined;
    kept[place] = undefined;
    return place;
  });
}

// How many numbers a channel takes.
const width = (link, { dmx = DEFAULTS.dmx }) => (isDmx(link) && dmx !== "8-bit" ? 2 : 1);

// The settings of a new channel: it moves a little around its middle, and slowly, until somebody has found out how far its
// mechanism lets it go.
function beginning(link) {
  const slow = { speed_per_s: 0.5 };
  if (!isBus(link)) return { pulse_at_0_us: 1450, pulse_at_1_us: 1550, ...slow };
  const isNarrow = ["dynamixel-ax", "feetech-scs"].includes(link.family);
  const [degrees, steps] = isNarrow ? [300, 1024] : [360, 4096];
  const middle = (link.unit === "degrees" ? degrees : steps) / 2;
  return { position_at_0: Math.round(0.97 * middle), position_at_1: Math.round(1.03 * middle), ...slow };
}

export function Servos() {
  const { status } = useStore();
  const { values, trouble } = useDraft();
  const [, redraw] = useState(0);
  const [ended, setEnded] = useState();
  const [othersFollow, setOthersFollow] = useState(false);
  const drive = useMemo(
    () =>
      new Drive((reason) => {
        setEnded(reason);
        redraw((count) => count + 1);
      }),
    [],
  );
  useEffect(() => () => drive.disarm(), []);
  // The events bring a status once a second, which is too seldom to see a servo follow.
  useEvery(
    STATUS_PERIOD_MS,
    () =>
      hasService() &&
      get("status").then(
        (newest) => update({ status: newest }),
        () => undefined,
      ),
  );
  const isReleased = status?.service?.released;
  const links = values.link ?? [];
  const places = keptPlaces(links);
  const boards = links
    .map((link, index) => ({ link, index, place: places[index] }))
    .filter(({ link }) => isBoard(link));
  if (trouble) return html`<h2>Servos</h2><${Trouble}>${trouble}<//>`;
  return html`
    <h2>Servos</h2>
    <div class="panel" id="arming">
      <p>${
        drive.isArmed
          ? html`<b class="state-bad">Armed.</b> ${isReleased ? "A slider moves its servo, and all others stay as STOP has left them." : "Sliders move servos."}`
          : "Sliders move nothing before you arm. Keep hands away from the mechanism."
      }</p>
      <div class="row">
      ${
        drive.isArmed
          ? html`<button type="button" onClick=${() => drive.disarm()}>Disarm</button>`
          : html`<${Action} kind=${isReleased ? "" : "primary"} disabled=${!status?.running} run=${() => drive.arm(othersFollow)}>Arm<//>`
      }
      ${isReleased && html`<${LetMove} />`}
      </div>
    </div>
    ${
      boards.length > 1 &&
      !drive.isArmed &&
      html`<label class="check" id="others"><${Check} value=${othersFollow} keep=${setOthersFollow} />Other boards follow the face meanwhile</label>`
    }
    ${ended && !status?.service?.released && html`<${Trouble}>Moving by hand has ended: ${ended}<//>`}
    ${boards.length === 0 && html`<p class="panel">No servo board is set up. <a
      href="#start">Start</a> offers the boards that are plugged in. Add a line of bus servos (bus-servo) or a DMX universe (sacn, artnet) as
      a link in the <a href="#links">settings</a>.</p>`}
    ${boards.map(({ link, index, place }) => html`<${Board} key=${index} index=${index} place=${place} link=${link} drive=${drive}
      live=${status?.service?.links?.[place]} />`)}
    <${Puppet} drive=${drive} boards=${boards.filter(({ place }) => place !== undefined)} />`;
}

function Board({ index, place, link, drive, live }) {
  const channels = link.channel ?? [];
  const [, first, last, word] = NUMBERS[link.kind];
  const isTaken = (number) =>
    channels.some((other) => number >= (other.channel ?? 0) && number < (other.channel ?? 0) + width(link, other));
  const free = [...Array(last + 1).keys()].slice(first).filter((number) => !isTaken(number));
  const add = (servos) => {
    const settings = servos.flatMap((servo, k) =>
      Object.entries({ channel: free[k], sources: {}, ...beginning(link), ...servo }).map(([key, value]) => [
        `link.${index}.channel.${channels.length + k}.${key}`,
        value,
      ]),
    );
    return change(Object.fromEntries(settings));
  };
  // A board that is not kept yet is known by its place in the list of links.
  const receiver = link.device ?? link.address ?? (link.bus === undefined ? "" : `I2C bus ${link.bus}`);
  const name = live?.name ?? [link.kind, receiver, `(link ${index + 1})`].filter(Boolean).join(" ");
  const title = live ? titleOfLink(live) : [KINDS[link.kind], receiver, `(link ${index + 1}, new)`].filter(Boolean).join(" ");
  const isNamed = (servo) => channels.some((other) => other.name === servo.name);
  const liveOf = (channel) => live?.channels?.find(({ number }) => number === (channel.channel ?? 0));
  return html`<section class="board" aria-label=${name}>
    <h3>${title} ${live && html`<${LinkState} link=${live} />`}</h3>
    ${place === undefined && html`<p class="dim">This board is new or changed. Keep the settings before you move its servos.</p>`}
    ${live && html`<${LinkTrouble} link=${live} />`}
    ${channels.length > 2 && html`<${Overview} name=${name} word=${word} channels=${channels} liveOf=${liveOf} />`}
    ${isDmx(link) && channels.length === 0 && html`<p class="dim">Without a channel of its own, it sends the whole face.</p>`}
    ${channels.map(
      (channel, k) => html`<${Channel} key=${k} place=${[index, k]} kept=${place} board=${link} channel=${channel} drive=${drive}
      live=${liveOf(channel)} />`,
    )}
    <div class="row" role="group" aria-label=${`Ready-made servos for ${name}`}><span class="dim">Ready-made:</span>
      ${SETS.map(([set, servos]) => {
        const missing = servos.filter((servo) => !isNamed(servo));
        return html`<${Action} key=${set} kind="small" disabled=${missing.length === 0 || missing.length > free.length}
          label=${`${set}, for ${name}`} run=${() => add(missing)}>${set}<//>`;
      })}
    </div>
    ${free.length > 0 && html`<${Action} run=${() => add([{}])}>Add a ${word}<//>`}
  </section>`;
}

// All servos of a board in one view. Each leads to its card.
function Overview({ name, word, channels, liveOf }) {
  const show = (event) => {
    const card = [...event.currentTarget.closest(".board").querySelectorAll(".channel")][event.currentTarget.value];
    card?.scrollIntoView({ block: "center" });
  };
  return html`<div class="panel overview" role="group" aria-label=${`All servos of ${name}`}>${channels.map((channel, k) => {
    const live = liveOf(channel);
    const now = live?.measured ?? live?.position;
    return html`<button type="button" key=${k} value=${k} onClick=${show}><span>${channel.name || `${word} ${channel.channel ?? 0}`}</span>
      <${Progress} target=${live?.target} position=${now} /><b>${number2(now)}</b></button>`;
  })}</div>`;
}

// A channel at its place in the draft, on the board at the place `kept` of the kept links.
function Channel({ place: [link, k], kept, board, channel, drive, live }) {
  const [end0, end1] = isBus(board) ? ["position_at_0", "position_at_1"] : ["pulse_at_0_us", "pulse_at_1_us"];
  const unit = isBus(board) ? (board.unit ?? "steps") : "µs";
  const bounds = isBus(board) ? { min: 0, max: 4095, step: "any" } : { min: 64, max: 4080, step: 1 };
  const [label, first, last, word] = NUMBERS[board.kind];
  const [whatAt, released] = isBus(board) ? ["Place", "no torque"] : ["Pulse", isDmx(board) ? "no pulses, value 0" : "no pulses"];
  const none = store.status?.service?.released && isDmx(board) ? "stopped" : `none: ${released}`;
  const settings = { ...DEFAULTS, ...channel };
  const number = channel.channel ?? 0;
  const [jog, setJog] = useState();
  const path = (key) => `link.${link}.channel.${k}.${key}`;
  const set = (key, value) => change({ [path(key)]: value });
  const names = Object.keys(settings.sources);
  const name = `${word} ${number}${settings.name && ` (${settings.name})`}`;
  const title = `${name[0].toUpperCase()}${name.slice(1)}`;
  // Only bus servos report where they are. For others, the service computes how far they have come.
  const isMeasured = live?.measured !== undefined;
  const now = isMeasured ? live.measured : live?.position;
  const position = Math.min(1, Math.max(0, (drive.isArmed ? jog : undefined) ?? now ?? settings.neutral));
  // The service moves within the ends that it knows, whatever ends wait to be kept.
  const used = { ...DEFAULTS, ...draft.used.link?.[kept]?.channel?.find((other) => (other.channel ?? 0) === number) };
  // A step, a microsecond or a tenth of a degree.
  const finest = unit === "degrees" ? 10 : 1;
  const at = (part) => Math.round(finest * (used[end0] + part * (used[end1] - used[end0]))) / finest;
  const pulse = at(position);
  const place = (pulse - settings[end0]) / (settings[end1] - settings[end0] || 1);
  const rest = Number(Math.min(1, Math.max(0, place)).toFixed(3));
  // What the slider shows is where the servo is only while somebody moves it.
  const isOff = jog === undefined || !drive.isArmed;
  const move = (part) => {
    setJog(part);
    drive.move({ link: kept, channel: number, position: part });
  };
  useEffect(() => {
    if (!drive.isArmed) setJog(undefined);
  }, [drive.isArmed]);
  return html`<article class="panel channel" aria-label=${title}>
    <h4>${title} <span class="dim">${names.join(" + ") || "follows nothing"}</span></h4>
    <${Slider} min="0" max="1" step="0.005" value=${position} disabled=${!drive.isArmed || !live} move=${move}
      aria-label=${`Move ${name}`}
        aria-valuetext=${`${(100 * position).toFixed(0)} %, ${pulse} ${unit === "µs" ? "microseconds" : unit}`} />
    <${Progress} target=${live?.target} position=${now} />
    <p class="numbers"><span>wanted <b>${number2(live?.target)}</b></span>
      <span>${isMeasured ? "is" : "computed"} <b>${number2(now)}</b></span>
      <span>${whatAt.toLowerCase()} <b>${live ? (live.pulse_us === null ? none : `${at(now)} ${unit}`) : "–"}</b></span></p>
    <${Health} live=${live} />
    <div class="row">
      <${Action} disabled=${isOff} run=${() => set(end0, pulse)}
        label=${`Set end 0 here, ${name}`}>Set end 0 here<//>
      <${Action} disabled=${isOff} run=${() => set(end1, pulse)}
        label=${`Set end 1 here, ${name}`}>Set end 1 here<//>
      <${Action} disabled=${isOff} run=${() => set("neutral", rest)}
        label=${`Set rest here, ${name}`}>Set rest here<//>
    </div>
    <${Sources} settings=${settings} name=${name} set=${set} path=${path} />
    <details>
      <summary>Ends, speed and more</summary>
      <div class="fields">
        <label><span>Name <code>name</code></span><${Entry} type="text" maxlength="64" autocomplete="off" value=${settings.name}
          keep=${(value) => set("name", value === "" ? null : value)} /></label>
        <${Number1} label=${label} name="channel" value=${number} min=${first} max=${last} step="1"
          set=${(value) => set("channel", value)} />
        <${Number1} label=${`${whatAt} at end 0 (${unit})`} name=${end0} value=${settings[end0]} ...${bounds}
          set=${(value) => set(end0, value)} />
        <${Number1} label=${`${whatAt} at end 1 (${unit})`} name=${end1} value=${settings[end1]} ...${bounds}
          set=${(value) => set(end1, value)} />
        <${Number1} label="Rest (0 to 1, −1: that of the neutral face)" name="neutral" value=${settings.neutral} min="-1" max="1"
          step="0.01" set=${(value) => set("neutral", value)} />
        <${Number1} label="Highest speed (1/s, 0: no limit)" name="speed_per_s" value=${settings.speed_per_s} min="0" max="100" step="0.1"
          set=${(value) => set("speed_per_s", value)} />
        <${Number1} label="Highest acceleration (1/s², 0: no limit)" name="acceleration_per_s2" value=${settings.acceleration_per_s2} min="0"
          max="1000" step="0.1" set=${(value) => set("acceleration_per_s2", value)} />
        <${Number1} label="Dead zone" name="dead_zone" value=${settings.dead_zone} min="0" max="0.2" step="0.005"
          set=${(value) => set("dead_zone", value)} />
        <label><span>Without a face <code>loss</code></span><${Choice} value=${settings.loss} keep=${(value) => set("loss", value)}
          choices=${[["neutral", "stay at rest"], ["release", released]]} /></label>
        ${isDmx(board) && html`<label><span>Value in the universe <code>dmx</code></span><${Choice} value=${settings.dmx}
          keep=${(value) => set("dmx", value)} choices=${FORMS} /></label>`}
      </div>
      <p class="dim">A new servo has ends close to its middle, and moves slowly. The slider reaches a wider end once you have typed and kept it
        here. Widen it in small steps, and stop before the mechanism binds. Raise the speed when you have found both ends.</p>
      <${Action} run=${() => change({ [`link.${link}.channel.${k}`]: null })}>Remove ${name}<//>
    </details>
  </article>`;
}

// The readings that a bus servo reports of itself.
function Health({ live: { volts, celsius, load } = {} }) {
  const readings = [
    [volts?.toFixed(1), "V"],
    [celsius?.toFixed(0), "°C"],
    [load === undefined ? undefined : (100 * load).toFixed(0), "% load"],
  ].filter(([number]) => number !== undefined);
  return html`${readings.length > 0 && html`<p class="numbers">${readings.map(([number, unit]) => html`<span key=${unit}><b>${number}</b> ${unit}</span>`)}</p>`}`;
}

const number2 = (value) => (value === undefined || value === null ? "–" : value.toFixed(2));

function Progress({ target, position }) {
  return html`<div class="progress" aria-hidden="true"><i style=${{ transform: `scaleX(${position ?? 0})` }}></i>
    <b style=${{ left: `${100 * (target ?? 0)}%` }}></b></div>`;
}

const Number1 = ({ label, name, set, ...rest }) => html`<label><span>${label} ${name && html`<code>${name}</code>`}</span><${Entry} type="number" inputmode="decimal"
  keep=${set} ...${rest} /></label>`;

// What a channel follows: a factor for each source, and an offset.
function Sources({ settings, name, set, path }) {
  const { sources, offset } = settings;
  const [found, setFound] = useState();
  const [chosen, setChosen] = useState("");
  const choose = (source) => {
    const isHead = HEAD_SOURCES.includes(source);
    return change({
      [path("sources")]: { ...sources, [source]: isHead ? HEAD_FACTOR : 1 },
      ...(isHead && { [path("offset")]: 0.5 }),
    });
  };
  const find = async () => {
    setFound(undefined);
    setFound(await learn());
  };
  const names = [...(store.hello?.names ?? []), ...HEAD_SOURCES].filter((source) => !(source in sources));
  const without = (source) => Object.fromEntries(Object.entries(sources).filter(([other]) => other !== source));
  return html`<fieldset class="sources"><legend>Follows</legend>
    ${Object.entries(sources).map(
      ([source, factor]) => html`<div class="row" key=${source}>
      <${Number1} label=${`${source} times`} value=${factor} min="-10" max="10" step="any"
        set=${(value) => set("sources", { ...sources, [source]: value })} />
      <${Action} run=${() => set("sources", without(source))} label=${`Remove ${source} from ${name}`}>Remove<//>
    </div>`,
    )}
    ${Object.keys(sources).length > 0 && html`<${Number1} label="plus" value=${offset} min="-10" max="10" step="any"
      set=${(value) => set("offset", value)} />`}
    <div class="row">
      <label class="grow">Add from the list
        <select disabled=${!mayOperate()} value=${chosen} onInput=${(event) => setChosen(event.target.value)}>
          <option value="">choose …</option>${names.map((source) => html`<option key=${source}
            value=${source}>${source}</option>`)}
        </select>
      </label>
      <${Action} disabled=${chosen === ""} run=${() => choose(chosen).then(() => setChosen(""))}
        label=${`Add ${chosen || "a source"} to ${name}`}>Add<//>
      <${Action} run=${find} label=${`Learn it for ${name}`}>Learn it<//>
    </div>
    <p role="status" class="dim">${
      found === undefined
        ? "Learn: press, then make the movement for three seconds."
        : found.length === 0
          ? "No movement was seen. Make it wider, with the face in the picture."
          : "These moved most:"
    }</p>
    ${
      found?.length > 0 &&
      html`<div class="row">${found.map(
        ({ name: source, moved }) => html`
      <${Action} key=${source}
        run=${() => choose(source).then(() => setFound(undefined))}>${source} (${moved.toFixed(2)})<//>`,
      )}</div>`
    }
  </fieldset>`;
}
