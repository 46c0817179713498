// The analysis: started, followed, cancelled; and before it what the data are good for.

import { address, api, data, stream } from "./app.js";

const given = data();
const $ = (id) => document.getElementById(id);
const [start, cancel, progress, bar, stages, clock, outcome, force] = [
  "start", "cancel", "progress", "bar", "stages", "clock", "outcome", "force",
].map($);
let job = given.job;
let close = null; // the stream of what runs
let heard = 0; // when the last word of it came
const FINISHED = 1;

function make(tag, content = "", kind = "") {
  const element = document.createElement(tag);
  element.textContent = content;
  if (kind) element.className = kind;
  return element;
}

function link(screen, words) {
  const found = make("a", words);
  found.href = address(`/${screen}`);
  return found;
}

function spoken(seconds) {
  if (seconds < 60) return `${Math.round(seconds)} s`;
  const minutes = Math.floor(seconds / 60);
  return minutes < 60 ? `${minutes} min ${Math.round(seconds % 60)} s` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

const took = (seconds) => (seconds < 9.95 ? `${seconds.toFixed(1)} s` : spoken(seconds));

function line(name, time, now) {
  const row = make("li", "", now ? "now" : "");
  row.append(make("span", now ? "●" : "✓", "mark"), make("span", name.replaceAll("_", " "), "name"), make("span", time, "took"));
  row.firstChild.setAttribute("aria-hidden", "true");
  if (now) row.setAttribute("aria-current", "step");
  return row;
}

/** What a stage says of how far it is makes no new line: "reading march.csv, 40 %" is "reading march.csv". */
function folded(told) {
  const rows = [];
  for (const one of told) {
    const last = rows.at(-1);
    if (last && one.name.startsWith(`${last.name}, `)) last.seconds += one.seconds;
    else rows.push({ ...one });
  }
  return rows;
}

function show(told) {
  job = told;
  heard = performance.now();
  const runs = !told.finished;
  const left = !runs && document.activeElement === cancel; // which is about to go
  start.disabled = runs;
  start.textContent = runs ? "Running …" : "Run again";
  if (left) start.focus();
  cancel.hidden = !runs;
  progress.hidden = !runs && !told.stages.length;
  bar.hidden = !runs;
  const rows = folded(told.stages).map((one) => line(one.name, took(one.seconds), false));
  if (runs) rows.push(line(told.stage + (told.compiling ? " (compiling, the first time only)" : ""), "", true));
  stages.replaceChildren(...rows);
  tick();
  if (runs) outcome.replaceChildren();
  else finished(told);
}

function tick() {
  if (!job) return;
  if (job.finished) {
    clock.textContent = `${job.state === "cancelled" ? "cancelled" : "took"} ${job.state === "cancelled" ? "after " : ""}${spoken(job.seconds)}`;
    return;
  }
  const since = (performance.now() - heard) / 1000;
  const gone = job.seconds + since;
  const left = job.left === null ? null : Math.max(job.left - since, 0);
  clock.textContent = left === null
    ? `${spoken(gone)} so far; how long it takes is known after the first time`
    : `${spoken(gone)} so far, about ${spoken(left)} left`;
  if (left === null) bar.removeAttribute("value");
  else bar.value = Math.min(gone / (gone + left || FINISHED), FINISHED);
}

const SAID = {
  done: ["There is an answer", "verdict", "See the verdict"],
  refused: ["The answer is that these data cannot tell", "verdict", "See why, and the trend that it rests on"],
  failed: ["It did not work", "tags", "Look at the project"],
  cancelled: ["Cancelled", "verdict", ""],
};

function finished(told) {
  const [title, screen, words] = SAID[told.state];
  const card = make("div", "", `card ${told.state}`);
  card.append(make("h3", title));
  const text = told.error || told.headline || (told.state === "cancelled" ? "Nothing was written; an earlier result stands as it was." : "");
  if (text) card.append(make("p", text.replaceAll("->", "→")));
  if (words && given.screens.includes(screen)) {
    const way = make("p");
    way.append(link(screen, words));
    way.firstChild.className = told.state === "failed" ? "" : "button primary";
    card.append(way);
  }
  outcome.replaceChildren(card);
  $("earlier")?.remove();
}

function follow(told) {
  show(told);
  close?.();
  close = null;
  if (told.finished) return;
  close = stream(`/api/run/events?id=${told.id}`, (news) => {
    if (news.closed) {
      clock.textContent = "The app does not answer any more: does trueplant app still run in its terminal?";
      return false;
    }
    show(news);
    return !news.finished;
  });
}

start.addEventListener("click", async () => {
  start.disabled = true;
  outcome.replaceChildren(); // of the last run: its link leads to what is about to be replaced
  try {
    follow(await api("/api/run/start", { force: Boolean(force?.checked) }));
    $("blocked")?.closest("section").querySelectorAll("#blocked, label").forEach((one) => { one.hidden = true; });
    cancel.focus();
  } catch {
    // the message is shown; another tab may have begun it
    if (job) show(job);
    else start.disabled = false;
  }
});

cancel.addEventListener("click", async () => {
  try {
    const told = await api("/api/run/cancel", { id: job.id });
    if (told.id === job.id) follow(told); // the stream may have said it before, and another may run by now
  } catch {
    // the message is shown
  }
});

/** A reason with its link; one that the headline says already is the link alone. */
function mended(reason) {
  const said = reason.message && `${reason.where ? `${reason.where}: ` : ""}${reason.message}. `.replaceAll("->", "→");
  const item = make("li", said);
  if (given.screens.includes(reason.screen)) item.append(link(reason.screen, `Mend it on ${NAMES[reason.screen]}`));
  return item;
}

const NAMES = { start: "Start", tags: "Tags", trends: "Trends", model: "Model" };

function listed(items) {
  const list = make("ul");
  list.append(...items);
  return list;
}

function showCheck(found) {
  const place = $("check");
  place.removeAttribute("aria-busy");
  if (found.error_said) {
    const line = make("p", found.error_said, "message");
    const way = make("p");
    for (const screen of ["tags", "trends", "model"]) {
      if (given.screens.includes(screen)) way.append(link(screen, NAMES[screen]), " ");
    }
    place.replaceChildren(line, way);
    return;
  }
  const parts = [make("p", found.headline.replaceAll("->", "→"), found.usable ? "note good" : "message")];
  if (found.reasons.length) parts.push(listed(found.reasons.map(mended).filter((item) => item.hasChildNodes())));
  for (const record of found.records) {
    const part = make("div", "", "record");
    part.append(make("h3", record.name), make("p", record.said, "quiet"));
    if (record.refused) part.append(make("p", `It cannot be used: ${record.refused}`, "message"));
    const lines = [record.usable, ...record.moves, ...record.findings].filter(Boolean).map((text) => make("li", text));
    if (record.more) lines.push(make("li", `and ${record.more} more`));
    if (lines.length) part.append(listed(lines));
    parts.push(part);
  }
  if (given.screens.includes("trends")) {
    const way = make("p");
    way.append(link("trends", "See the record, and what is left out of it"));
    parts.push(way);
  }
  place.replaceChildren(...parts);
}

start.disabled = false; // from here on it is listened to
if (job) follow(job);
setInterval(tick, 1000);
api("/api/run/check", undefined, "GET", { quiet: true })
  .then(showCheck)
  .catch((error) => showCheck({ error_said: error.message }));
