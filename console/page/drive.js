// A session that moves servos by hand. The console ends it when nothing comes for 400 ms, so that a page that is closed,
// hidden or cut off lets go by itself.

import { post } from "./store.js";

const HEARTBEAT_MS = 150;
// Least time between two posts while a slider or a play moves.
const LEAST_MS = 40;

export class Drive {
  // Calls `changed` when the session begins, and when it ends with the reason if it was not asked for.
  constructor(changed) {
    this.changed = changed;
    this.hide = () => document.visibilityState === "hidden" && this.disarm();
    this.close = () => this.disarm();
  }

  get isArmed() {
    return this.id !== undefined;
  }

  // Servo boards that the page does not move stay still meanwhile, or follow the face.
  async arm(othersFollow) {
    ({ drive: this.id } = await post("servos/arm", { others_follow: othersFollow }));
    document.addEventListener("visibilitychange", this.hide);
    addEventListener("pagehide", this.close);
    this.changed();
    this.beat(this.id);
  }

  // Moves to what the line says: { link, channel, position } or { coefficients, head_deg }.
  move(line) {
    if (!this.isArmed) return;
    this.line = line;
    this.wake?.();
  }

  disarm(trouble) {
    if (!this.isArmed) return;
    const drive = this.id;
    this.id = undefined;
    this.line = undefined;
    document.removeEventListener("visibilitychange", this.hide);
    removeEventListener("pagehide", this.close);
    // A page that is being closed still sends this.
    post("servos/disarm", { drive }, { keepalive: true }).catch(() => undefined);
    this.changed(trouble);
  }

  async beat(drive) {
    while (this.id === drive) {
      const [line, sent] = [this.line, performance.now()];
      this.line = undefined;
      try {
        await post("servos/drive", { drive, ...line });
      } catch (error) {
        if (this.id === drive) this.disarm(error.message);
        return;
      }
      // The time until the answer counts, so that a slow network does not make the heartbeat late.
      const left = (period) => Math.max(0, period - (performance.now() - sent));
      await wait(left(LEAST_MS));
      if (!this.line)
        await new Promise((done) => {
          const timer = setTimeout(done, left(HEARTBEAT_MS));
          this.wake = () => {
            clearTimeout(timer);
            done();
          };
        });
    }
  }
}

export const wait = (ms) => new Promise((done) => setTimeout(done, ms));
