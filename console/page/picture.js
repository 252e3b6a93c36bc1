// The camera's picture with the landmarks, or the landmarks on black. The next picture is asked for when the last one is
// drawn, so that none queue, and none while nobody sees the page.

import { Action } from "./common.js";
import { change, isChanged, keep } from "./draft.js";
import { ask, get, useStore } from "./store.js";
import { html, useEffect, useRef, useState } from "./vendor/preact.js";

const RETRY_MS = 1000;

export function Picture({ hidesControls }) {
  const canvas = useRef();
  const isAllowed = useStore().status?.picture === true;
  const [trouble, setTrouble] = useState();
  const [wantsBlack, setBlack] = useState(false);
  const isBlack = wantsBlack || !isAllowed;
  const black = useRef(isBlack);
  black.current = isBlack;
  useEffect(() => {
    const show = { canvas: canvas.current, isBlack: () => black.current, setTrouble, isOver: false };
    watch(show);
    return () => (show.isOver = true);
  }, []);
  return html`<div class="camera">
    <canvas ref=${canvas} width="640" height="480" role="img" hidden=${trouble !== undefined}
      aria-label=${isBlack ? "Landmarks of the face on black" : "The camera's picture with the landmarks of the face"}></canvas>
    ${trouble && html`<p class="notice warn" role="status">${trouble.message}</p>`}
    ${
      !hidesControls &&
      (isAllowed
        ? html`<label class="check"><input type="checkbox" checked=${wantsBlack}
        onInput=${(event) => setBlack(event.target.checked)} />Landmarks on black</label>`
        : html`<div class="row spread"><span class="dim">Landmarks do for everything but aiming. The settings keep the picture itself in the service.</span>
      <${Action} run=${allow}>Allow the picture<//></div>`)
    }
  </div>`;
}

// Allowing the picture is kept at once unless other changes wait, which are kept together with it.
async function allow() {
  const others = isChanged();
  await change({ "console.picture": true });
  return others ? { done: "This is kept together with your other changes." } : keep();
}

async function watch(show) {
  while (!show.isOver) {
    if (document.visibilityState === "hidden")
      await new Promise((done) => document.addEventListener("visibilitychange", done, { once: true }));
    try {
      const picture = await load(show.isBlack());
      if (show.isOver) return;
      draw(show.canvas, picture);
      show.setTrouble(undefined);
      await new Promise(requestAnimationFrame);
    } catch (error) {
      if (show.isOver) return;
      // A request that STOP has ended is no fault: it is sent again.
      if (error.name !== "AbortError") show.setTrouble(error);
      await new Promise((done) => setTimeout(done, RETRY_MS));
    }
  }
}

// The answer is a line of JSON, and then the bytes of a JPEG.
async function load(isBlack) {
  if (isBlack) return get("landmarks");
  const bytes = new Uint8Array(await (await ask("picture")).arrayBuffer());
  const end = bytes.indexOf(10);
  const head = JSON.parse(new TextDecoder().decode(bytes.subarray(0, end)));
  const image = await createImageBitmap(new Blob([bytes.subarray(end + 1)], { type: "image/jpeg" }));
  return { ...head, image };
}

function draw(canvas, { width, height, landmarks, image }) {
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const context = canvas.getContext("2d");
  context.fillStyle = "#000";
  context.fillRect(0, 0, width, height);
  if (image) context.drawImage(image, 0, 0, width, height);
  image?.close();
  context.fillStyle = "#3df5c8";
  const size = Math.max(1.5, width / 320);
  for (const [x, y] of landmarks ?? []) context.fillRect(x - size / 2, y - size / 2, size, size);
}
