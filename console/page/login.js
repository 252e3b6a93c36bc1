// The log-in, and the first password.

import { html, useState } from "./vendor/preact.js";
import { loadSession, post, store } from "./store.js";

const LEAST_LENGTH = 8;

export function Login() {
  const { needs_password: isFirst, secure: isSecure, trouble: early } = store.session;
  const [trouble, setTrouble] = useState(early);
  const [isBusy, setBusy] = useState(false);
  const enter = async (event) => {
    event.preventDefault();
    const password = new FormData(event.target).get("password");
    setBusy(true);
    try {
      await post(...(isFirst ? ["password", { new: password }] : ["login", { password }]));
      await loadSession();
    } catch (error) {
      setTrouble(error.message);
    }
    setBusy(false);
  };
  return html`<main class="login"><form onSubmit=${enter}>
    <h1>facewire</h1>
    ${isFirst && html`<p>Nobody has set a password yet. Whoever knows it can move the servos and change the settings.</p>`}
    <label>${isFirst ? "New password" : "Password"}
      <input type="password" name="password" required minlength=${isFirst ? LEAST_LENGTH : 1}
        autocomplete=${isFirst ? "new-password" : "current-password"} />
    </label>
    ${isFirst && html`<p class="dim">At least ${LEAST_LENGTH} characters.</p>`}
    <button class="primary" disabled=${isBusy}>${isFirst ? "Set the password" : "Log in"}</button>
    ${trouble && html`<p role="alert" class="notice bad">${trouble}</p>`}
    ${isSecure === false && html`<p
      class="dim">This connection is not encrypted: others in this network could read the password.</p>`}
    ${!isFirst && html`<p class="dim">Or scan the QR code that facewire-console shows where it runs.</p>`}
  </form></main>`;
}
