// A track: begun, followed, cancelled.

import { api, data } from "./app.js";

const $ = (id) => document.getElementById(id);
const [start, cancel, progress, precision] = ["start", "cancel", "progress", "precision"].map($);
const LOOK = 700; // milliseconds
let begun = false; // here, so that the page shows it when it is done

function line(text, kind = "") {
  const found = document.createElement("p");
  found.textContent = text.replaceAll("->", "→");
  found.className = kind;
  return found;
}

function show(told) {
  const runs = told.state === "running";
  start.disabled = runs;
  cancel.hidden = !runs;
  if (runs) {
    progress.replaceChildren(line(`${told.stage.replaceAll("_", " ")} … ${Math.round(told.seconds)} s`));
    setTimeout(look, LOOK);
  } else if (told.state === "failed") progress.replaceChildren(line(told.error, "message"));
  else if (told.state === "cancelled") progress.replaceChildren(line("Cancelled; what was there stands as it was.", "quiet"));
  else if (told.state === "done" && begun) location.reload();
}

async function look() {
  try {
    show(await api("/api/track/state", undefined, "GET", { quiet: true }));
  } catch (error) {
    progress.replaceChildren(line(error.message, "message"));
    start.disabled = false;
  }
}

start.addEventListener("click", async () => {
  start.disabled = true;
  try {
    begun = true;
    show(await api("/api/track/start", { precision: Number(precision.value) }));
    cancel.focus();
  } catch {
    start.disabled = false;
  }
});
cancel.addEventListener("click", async () => {
  try {
    show(await api("/api/track/cancel", {}));
    start.focus();
  } catch {
    // the message is shown
  }
});
const { errand } = data();
if (errand) {
  begun = errand.state === "running";
  show(errand);
}
