// The frame around all pages: where to go, the state, the stop of all servos, and what everybody must know at once.

import { html, render, useEffect, useState } from "./vendor/preact.js";
import { Action, LetMove, release, useEvery } from "./common.js";
import { DraftBar, restoreLast } from "./draft.js";
import { Health } from "./health.js";
import { Links } from "./links.js";
import { Live } from "./live.js";
import { Login } from "./login.js";
import { Recordings } from "./recordings.js";
import { Servos } from "./servos.js";
import { Start } from "./start.js";
import {
  hasService,
  loadSession,
  mayOperate,
  open,
  post,
  store,
  update,
  useStore,
  whyNoStop,
} from "./store.js";
import { Wearer } from "./wearer.js";
import { marked, sentence, stateOfLink, titleOfLink } from "./words.js";

// The name in the address, the title, the page, and the path of its sign in a square of 24.
const PAGES = [
  ["live", "Live", Live, "M12 3a9 9 0 1 0 0 18a9 9 0 1 0 0-18M9 9v2M15 9v2M8 14c2 3 6 3 8 0"],
  ["start", "Start", Start, "M5 21V4h12l-3 4l3 4H5"],
  ["servos", "Servos", Servos, "M4 6h16M4 12h16M4 18h16M9 4v4M16 10v4M7 16v4"],
  ["wearer", "Wearer", Wearer, "M12 4a4 4 0 1 0 0 8a4 4 0 1 0 0-8M4 21c0-9 16-9 16 0"],
  [
    "links",
    "Settings",
    Links,
    "M10 14a4 4 0 0 0 6 0l3-3a4 4 0 0 0-6-6l-1 1M14 10a4 4 0 0 0-6 0l-3 3a4 4 0 0 0 6 6l1-1",
  ],
  ["health", "Health", Health, "M3 12h4l3-7l4 14l3-7h4"],
  ["recordings", "Record", Recordings, "M12 4a8 8 0 1 0 0 16a8 8 0 1 0 0-16M12 9a3 3 0 1 0 0 6a3 3 0 1 0 0-6"],
];

const chosen = () => PAGES.find(([name]) => name === location.hash.slice(1))?.[0] ?? "live";

function Tabs({ page }) {
  return html`<nav aria-label="Pages">${PAGES.map(
    ([name, title, , sign]) => html`
    <a key=${name} href=${`#${name}`} aria-current=${name === page ? "page" : undefined}>
      <svg viewBox="0 0 24 24" aria-hidden="true"><path d=${sign} /></svg>${title}
    </a>`,
  )}</nav>`;
}

// How often the page asks whether its session goes on.
const SESSION_PERIOD_MS = 5000;

// Stops all servos. The button shows that they are stopped as soon as the service says so.
function Stop() {
  const fail = ({ message }) => update({ stopTrouble: message });
  // The first try fails if the console has closed the idle connection meanwhile. What it answers is told at once.
  const stop = () =>
    release(true)
      .catch((error) => {
        if (error.status) fail(error);
        return release(true);
      })
      .then(() => update({ stopTrouble: undefined }), fail);
  useEffect(() => {
    const key = (event) => {
      if (!mayOperate() || event.repeat || !isStop(event)) return;
      event.preventDefault();
      stop();
    };
    addEventListener("keydown", key);
    return () => removeEventListener("keydown", key);
  }, []);
  return html`<button id="stop" type="button" disabled=${!mayOperate()} onClick=${stop} class=${whyNoStop() && "idle"}
    aria-describedby="stop-alerts"
      title=${mayOperate() ? "Lets go of all servos (Escape or space)" : "You may look, but not operate."}>STOP</button>`;
}

// Says before STOP is pressed that it does not work, and after it has failed that the servos were not released, until it succeeds.
function StopAlerts() {
  const { stopTrouble, session } = store;
  const why = whyNoStop();
  const trouble = stopTrouble?.replace(/\.$/, "");
  // The service names the boards that it has not reached, and says what to do with them.
  const which = trouble?.startsWith("not reached") ? "Some" : "The";
  const advice = trouble?.includes("supply of") ? "" : " Switch their supply off.";
  return html`<div id="stop-alerts" tabindex="0">
    ${why && html`<p role="alert">STOP does not work here: ${marked(why.replace(/\.$/, ""))}. To stop servos, ${session.role ? "" : "log in, or "}switch
      their supply off.</p>`}
    ${trouble && html`<p role="alert">${which} servos were not released: ${marked(trouble)}.${advice}</p>`}
  </div>`;
}

// Escape stops unless text is typed. Space does unless it works a control that has the focus.
function isStop({ key, target }) {
  const isTyping = target.matches?.("textarea, select, input:not([type=range], [type=checkbox], [type=radio])");
  if (key === "Escape") return !isTyping;
  return key === " " && !isTyping && !target.matches?.("button, a, summary, input:not([type=range])");
}

// What the operator's stop has done to each board.
function released({ links, driven, released_unix_s: since, release_not_kept: notKept }) {
  const at = since ? ` since ${new Date(1000 * since).toLocaleTimeString()}` : "";
  const boards = (links ?? []).filter((link) => link.released !== undefined);
  const isJogged = ({ open, channels }) => open && driven && channels.some(({ pulse_us }) => pulse_us !== null);
  const state = (board) => {
    if (board.released) return board.stop;
    return html`<strong>${isJogged(board) ? "a servo is moved by hand" : "not reached: switch its supply off"}</strong>`;
  };
  const headline = boards.every((board) => board.released)
    ? `All servos are released${at}.`
    : boards.every((board) => board.released || isJogged(board))
      ? `STOP holds${at} but for a servo in the hand.`
      : `Not all servos are released: STOP holds${at}.`;
  return html`${headline} ${boards.map((board) => html`<br />${board.name}: ${state(board)}`)}
    ${notKept && html`<br /><strong>${notKept}. Switch the supply off before a restart.</strong>`}`;
}

// What everybody must know at once stands open. All else folds into one line.
function Banners({ page }) {
  const { connection, status } = store;
  const alarm = (kind, text, rest) =>
    html`<div class=${`notice ${kind}`} role="alert"><span>${text}</span>${rest}</div>`;
  const isReleased = status?.service?.released;
  return html`<div id="banners">
    ${connection !== "open" && alarm("bad", `The connection is lost: ${connection}. What is shown is old.`)}
    ${isReleased && alarm("bad released", released(status.service), page !== "servos" && html`<${LetMove} />`)}
    ${
      status &&
      !status.running &&
      alarm(
        "bad",
        sentence(status.trouble ?? "the service does not run"),
        html`<${Action} run=${() => post("service", { do: "start" })}>Start it<//>`,
      )
    }
    ${
      status?.refused &&
      alarm(
        "bad",
        "The service refuses its settings.",
        html`<a href="#links">Look at the settings</a> <${Action} run=${restoreLast}>Back to the last that worked<//>`,
      )
    }
    ${
      status?.service?.settings_refused &&
      alarm(
        "bad",
        marked(
          `The service refuses the settings that were kept last, and goes on with the former ones: ${status.service.settings_refused}`,
        ),
        html`<${Action} run=${() => post("settings/reload")}>Try them again<//>
        <${Action} run=${restoreLast}>Back to the last that worked<//>`,
      )
    }
    <${Notices} notices=${noticesOf(page)} />
  </div>`;
}

// Returns what is worth knowing on a page: texts, each with the page to go to.
function noticesOf(page) {
  const { status, session } = store;
  const links = ["links", "servos"].includes(page) ? [] : (status?.service?.links ?? []);
  const ofLinks = links.filter((link) => stateOfLink(link).trouble);
  const operator = status?.operator?.me === false && status.operator.name;
  return [
    ...ofLinks.map((link) => [[titleOfLink(link), ": ", marked(stateOfLink(link).trouble)], "links", "Links"]),
    operator && [`${operator} moves the servos now. Until they let go you can look, and press STOP.`],
    status?.picture && ["The camera's picture can be seen here.", "links", "Settings"],
    session?.role === "look" && hasService() && ["You may look, but not operate."],
  ].filter(Boolean);
}

// A line that unfolds.
function Notices({ notices }) {
  if (notices.length === 0) return null;
  const texts = notices.flatMap(([text], index) => (index > 0 ? [" · ", text] : [text]));
  return html`<div class="notice warn" role="status"><details class="fold"><summary><span>${texts}</span></summary>
    <ul>${notices.map(([text, page, title], index) => html`<li key=${index}>${text} ${page && html`<a href=${`#${page}`}>${title}</a>`}</li>`)}</ul>
  </details></div>`;
}

function App() {
  const { session, hello } = useStore();
  const [page, setPage] = useState(chosen());
  useEffect(() => {
    const turn = () => {
      setPage(chosen());
      scrollTo(0, 0);
    };
    addEventListener("hashchange", turn);
    // The address may have changed since the page was drawn.
    setPage(chosen());
    return () => removeEventListener("hashchange", turn);
  }, []);
  useEffect(() => {
    if (session?.role && !hello) open();
  }, [session?.role]);
  // A login in another tab changes what this page may do, too.
  useEvery(SESSION_PERIOD_MS, () => store.session && loadSession().catch(() => undefined));
  if (!session) return html`<main><p role="status">Loading …</p></main>`;
  if (!session.role) return html`<${StopAlerts} /><${Login} />`;
  const isWhole = hasService();
  const [, title, Page] = PAGES.find(([name]) => name === page);
  return html`
    <header class=${isWhole ? "whole" : ""}>
      <h1>facewire</h1>
      <p id="state" role="status" data-state="waiting">waiting for packets</p>
      ${isWhole && html`<${Stop} /><${StopAlerts} /><${Tabs} page=${page} />`}
    </header>
    <${Banners} page=${page} />
    <main>
      <${Live} isShown=${!isWhole || page === "live"} />
      ${isWhole && page !== "live" && html`<section class="page" id=${`page-${page}`}
        aria-label=${title}><${Page} /></section>`}
    </main>
    <${DraftBar} />`;
}

async function begin() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (token) {
    // The token does not stay in the address, where somebody could read it.
    history.replaceState(null, "", location.pathname);
    await post("login", { token }).catch(() => undefined);
  }
  await loadSession();
}

render(html`<${App} />`, document.getElementById("app"));
begin().catch((error) => update({ session: { role: null, trouble: error.message } }));
