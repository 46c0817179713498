// What every page has: requests with the session's token, messages, undo, and news of a change of light and dark.

const meta = (name) => document.querySelector(`meta[name="${name}"]`)?.content ?? "";

export const project = meta("project");
let version = meta("project-version");

/** The version of the project that this page shows; a change sends it, so that no other change is overwritten. */
export const shownVersion = () => version;

/** The address with the project, unless it names one. */
export function address(path, query = {}) {
  const place = new URL(path, location.origin);
  if (project && !place.searchParams.has("project")) place.searchParams.set("project", project);
  for (const [key, value] of Object.entries(query)) place.searchParams.set(key, value);
  return place;
}

/** An announcement at the foot of the page, which goes by itself. */
export function say(text) {
  show("said", text, 6000);
}

/** A message of something that went wrong, which stays until it is closed. */
export function alarm(text) {
  show("alarm", text, 0);
}

function show(id, text, milliseconds) {
  const place = document.getElementById(id);
  place.replaceChildren();
  if (!text) return;
  const line = document.createElement("p");
  line.textContent = text;
  const close = document.createElement("button");
  close.type = "button";
  close.textContent = "Close";
  close.addEventListener("click", () => place.replaceChildren());
  place.append(line, close);
  if (milliseconds) setTimeout(() => line.isConnected && place.replaceChildren(), milliseconds);
}

/**
 * Ask the app. With a body it is a POST, unless `method` says otherwise. What is wrong is shown and thrown.
 * A body of type FormData, Blob or ArrayBuffer is sent as it is, anything else as JSON. `quiet`: do not show it.
 */
export async function api(path, body, method, { quiet = false, signal } = {}) {
  const given = body !== undefined;
  const raw = body instanceof FormData || body instanceof Blob || body instanceof ArrayBuffer;
  const headers = { "x-csrf-token": meta("csrf"), accept: "application/json" };
  if (given && !raw) headers["content-type"] = "application/json";
  let answer;
  try {
    answer = await fetch(address(path), {
      method: method ?? (given ? "POST" : "GET"),
      headers,
      signal,
      body: given ? (raw ? body : JSON.stringify(body)) : undefined,
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw failed("The app does not answer: does trueplant app still run in its terminal?", quiet);
  }
  const data = await answer.json().catch(() => ({}));
  if (answer.status === 401) {
    location.reload(); // the page that says how to get in again
    throw new Error(data.error);
  }
  if (!answer.ok) throw failed(data.error ?? `The app answered with ${answer.status}.`, quiet);
  if (data.version) noteVersion(data);
  return data;
}

function failed(message, quiet) {
  if (!quiet) alarm(message);
  return new Error(message);
}

const [undo, redo] = ["undo", "redo"].map((id) => document.getElementById(id));
let stepping = false; // back or forth: the page is about to be loaded again

/** After a change of the project: its version, and what can be undone. */
export function noteVersion({ version: now, can_undo: back, can_redo: forth }) {
  version = now;
  if (stepping) return;
  if (back !== undefined) undo.disabled = !back;
  if (forth !== undefined) redo.disabled = !forth;
}

/** Call `fn` with each event of a stream (parsed), until the returned function is called or `fn` returns false. */
export function stream(path, fn) {
  const source = new EventSource(address(path));
  const close = () => source.close();
  source.onmessage = (event) => {
    if (fn(JSON.parse(event.data)) === false) close();
  };
  source.onerror = () => {
    if (source.readyState === EventSource.CLOSED) fn({ closed: true });
  };
  addEventListener("pagehide", close, { once: true });
  return close;
}

/** Call `fn` whenever the screen turns light or dark, and once now; it is given a function that reads a colour. */
export function onThemeChange(fn) {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const tell = () => fn(color, dark.matches);
  dark.addEventListener("change", tell);
  tell();
}

/** A colour of the palette, such as "measured", "setpoint", "plant-band", "ink", "grid". */
export const color = (role) => getComputedStyle(document.documentElement).getPropertyValue(`--${role}`).trim();

/** What the template left for the script. */
export const data = (id = "data") => JSON.parse(document.getElementById(id)?.textContent || "null");

async function step(button) {
  if (!project || button.disabled) return;
  const before = [undo.disabled, redo.disabled];
  stepping = undo.disabled = redo.disabled = true;
  try {
    await api(`/api/project/${button.id}`, {});
    location.reload();
  } catch {
    stepping = false; // the message is shown
    [undo.disabled, redo.disabled] = before;
  }
}

const ofText = (element) => element?.closest?.("input, textarea, select, [contenteditable]");

for (const button of [undo, redo]) {
  button.addEventListener("click", () => step(button));
  button.disabled = !("can" in button.dataset); // from here on it is listened to
}
document.addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || event.altKey || ofText(event.target)) return;
  const key = event.key.toLowerCase();
  if (key === "z" || key === "y") {
    event.preventDefault();
    step(key === "y" || event.shiftKey ? redo : undo);
  }
});
