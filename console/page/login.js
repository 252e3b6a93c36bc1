// The log-in, and the first password.

import { html, useState } from "./vendor/preact.js";
import { loadSession, post, store } from "./store.js";

const LEAST_LENGTH = 8;

// A field for a password, which a button shows.
export function PasswordField({ label, ...attributes }) {
  const [isShown, setShown] = useState(false);
  return html`<div class="secret"><label>${label}<input type=${isShown ? "text" : "password"} required
      autocapitalize="none" spellcheck=${false} ...${attributes} /></label>
    <button type="button" aria-pressed=${String(isShown)} aria-label=${`Show: ${label}`}
      onClick=${() => setShown(!isShown)}>Show</button></div>`;
}

export const DIFFER = "The two passwords differ: type the same one twice.";

export function Login() {
  const { needs_password: isFirst, secure: isSecure, trouble: early } = store.session;
  const [trouble, setTrouble] = useState(early);
  const [isBusy, setBusy] = useState(false);
  const enter = async (event) => {
    event.preventDefault();
    const form = new FormData(event.target);
    const password = form.get("password");
    if (isFirst && form.get("again") !== password) return setTrouble(DIFFER);
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
    <${PasswordField} label=${isFirst ? "New password" : "Password"} name="password" minlength=${isFirst ? LEAST_LENGTH : 1}
      autocomplete=${isFirst ? "new-password" : "current-password"} />
    ${isFirst && html`<${PasswordField} label="The same again" name="again" autocomplete="new-password" />
      <p class="dim">At least ${LEAST_LENGTH} characters.</p>`}
    <button class="primary" disabled=${isBusy}>${isFirst ? "Set the password" : "Log in"}</button>
    ${trouble && html`<p role="alert" class="notice bad">${trouble}</p>`}
    ${isSecure === false && html`<p
      class="dim">This connection is not encrypted: others in this network could read the password.</p>`}
    ${!isFirst && html`<p class="dim">Or scan the QR code that facewire-console shows where it runs. On the board itself, nobody needs the
      password, and Settings replaces one that is forgotten.</p>`}
  </form></main>`;
}
