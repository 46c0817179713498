// Start: a file is copied into the folder and looked at; what was understood is shown and can be corrected.

import { address, alarm, api, data, say } from "./app.js";
import { ask, el } from "./dom.js";

const $ = (id) => document.getElementById(id);
const form = $("hints");
let shown = "";

const on = (project) => {
  location.href = address("/tags", { project });
};

// -- files ------------------------------------------------------------------------------------------------------------

async function upload(file) {
  const progress = $("progress");
  for (let overwrite = 0; overwrite < 2; overwrite++) {
    progress.hidden = false;
    let answer;
    try {
      answer = await put(file, overwrite, (share) => (progress.value = share));
    } catch (error) {
      alarm(error.message);
      return;
    } finally {
      progress.hidden = true;
    }
    if (answer.data) {
      say(`${answer.data} was copied into the folder.`);
      await look(answer.data, true);
      return;
    }
    if (overwrite || !(await ask(`${answer.exists} is in the folder already. Replace it?`, "Replace it", "Keep it"))) {
      if (answer.exists) await look(answer.exists, true);
      return;
    }
  }
}

/** A request that tells how much was sent, as fetch cannot. */
function put(file, overwrite, tell) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("PUT", address("/api/start/upload", { name: file.name, overwrite }));
    request.setRequestHeader("x-csrf-token", document.querySelector('meta[name="csrf"]').content);
    request.setRequestHeader("content-type", "application/octet-stream");
    request.upload.addEventListener("progress", (event) => tell(event.loaded / Math.max(event.total, 1)));
    request.addEventListener("load", () => {
      let answer = {};
      try {
        answer = JSON.parse(request.responseText);
      } catch {
        answer = { error: `The app answered with ${request.status}.` };
      }
      if (request.status < 300) resolve(answer);
      else reject(new Error(answer.error));
    });
    request.addEventListener("error", () => reject(new Error("The file was not taken: does trueplant app still run?")));
    request.send(file);
  });
}

const drop = $("drop");
for (const name of ["dragenter", "dragover"]) {
  drop.addEventListener(name, (event) => {
    event.preventDefault();
    drop.classList.add("over");
  });
}
drop.addEventListener("dragleave", () => drop.classList.remove("over"));
drop.addEventListener("drop", (event) => {
  event.preventDefault();
  drop.classList.remove("over");
  if (event.dataTransfer.files.length) upload(event.dataTransfer.files[0]);
});
$("file").addEventListener("change", (event) => event.target.files.length && upload(event.target.files[0]));
for (const button of document.querySelectorAll("[data-file]")) {
  button.addEventListener("click", () => look(button.dataset.file, true));
}

// -- the first look ---------------------------------------------------------------------------------------------------

const hints = () => Object.fromEntries([...new FormData(form)].filter(([, value]) => value));
let asked = 0;

async function look(name, anew = false) {
  if (anew) form.reset();
  shown = name;
  const mine = ++asked;
  $("seen").hidden = false;
  $("seen-title").textContent = `What was understood of ${name}`;
  $("busy").textContent = "Reading …";
  if (anew) $("seen-title").focus();
  let seen;
  try {
    seen = await api("/api/start/look", { data: name, ...hints() }, undefined, { quiet: true });
  } catch (error) {
    if (mine !== asked) return;
    $("busy").textContent = "";
    problem(error.message);
    $("facts").replaceChildren();
    $("rows").replaceChildren();
    $("loops").replaceChildren();
    $("make").hidden = true;
    $("correct").open = true;
    return;
  }
  if (mine !== asked) return;
  $("busy").textContent = "";
  show(seen);
}

function problem(text) {
  $("problem").textContent = text;
  $("problem").hidden = !text;
}

function show(seen) {
  const said = [];
  if (seen.doubt) said.push(seen.doubt);
  if (!seen.loops.length) {
    said.push(
      "No pair of PV and OP was recognised by the names of the columns: name them like FIC101.PV and FIC101.OP, or " +
        "write the project file by hand.",
    );
  }
  problem(said.join(" "));
  $("make").hidden = !seen.loops.length;
  if (said.length) $("correct").open = true;
  const fact = (name, value, doubtful) =>
    value === null || value === "" ? null : el("div", {}, el("dt", {}, name), el("dd", doubtful ? { class: "doubtful" } : {}, value));
  const kind = seen.stamped === null ? "not understood" : seen.stamped ? "time stamps" : "numbers that count";
  $("facts").replaceChildren(
    ...[
      fact("Shape", seen.long ? `long, ${seen.names.length} columns, ${seen.tags.length} tags` : `wide, ${seen.names.length} columns`),
      fact("Rows", seen.height.toLocaleString("en")),
      fact("Between columns", seen.separator),
      fact("Encoding", seen.encoding),
      fact("Decimal mark", seen.decimal),
      fact("Column of the time", seen.time),
      fact("Time is", kind, seen.stamped === null),
      fact("Zone", seen.stamped ? (seen.zone ?? "none said: as the clock showed it") : null, !seen.zone),
      fact("From, to", seen.span),
      fact("Interval", seen.interval ?? "unit not known", seen.interval === null),
    ].filter(Boolean),
  );
  fill("time", seen.names);
  fill("tag", seen.names);
  fill("value", seen.names);
  $("rows").replaceChildren(
    el("caption", {}, `The first ${seen.rows.length} of ${seen.height.toLocaleString("en")} rows${seen.more_columns ? `, without ${seen.more_columns} columns` : ""}.`),
    el("thead", {}, el("tr", {}, seen.columns.map((name) =>
      el("th", { scope: "col", class: name === seen.time ? "time" : null }, name, seen.units[name] ? el("span", { class: "quiet" }, ` ${seen.units[name]}`) : null)))),
    el("tbody", {}, seen.rows.map((row) => el("tr", {}, row.map((cell) => el("td", {}, cell))))),
  );
  const notes = [...seen.notes, ...seen.modes];
  $("loops").replaceChildren(
    ...[
      notes.length ? el("ul", {}, notes.map((note) => el("li", {}, note))) : null,
      seen.loops.length
        ? el("p", {}, `${seen.loops.length} ${seen.loops.length === 1 ? "loop was" : "loops were"} recognised: `,
            seen.loops.map((loop) => [loop.pv, loop.op].join(" with ")).join("; "), ".")
        : null,
    ].filter(Boolean),
  );
  for (const one of document.querySelectorAll(".of-long")) one.hidden = !seen.long && $("shape").value !== "long";
  for (const one of document.querySelectorAll("#hints .unit")) one.textContent = seen.grid_unit;
  document.querySelector(".of-book").hidden = !/\.xls[xm]?$/i.test(shown);
  $("name").value = seen.project;
  $("command").textContent = seen.command;
}

function fill(id, names) {
  const select = $(id);
  const before = select.value;
  const given = [...select.options].slice(1).map((option) => option.value);
  if (given.length === names.length && given.every((name, k) => name === names[k])) return;
  select.replaceChildren(select.options[0], ...names.map((name) => el("option", { value: name }, name)));
  if (names.includes(before)) select.value = before;
}

form.addEventListener("change", () => look(shown));
form.addEventListener("submit", (event) => event.preventDefault());
$("forget").addEventListener("click", () => look(shown, true));
$("make").addEventListener("submit", (event) => {
  event.preventDefault();
  make("/api/start/make", { data: shown, project: $("name").value, ...hints() });
});

async function make(path, given) {
  try {
    let answer = await api(path, given);
    if (answer.exists) {
      if (!(await ask(`${answer.exists} is there already. Write it anew? That can be undone.`, "Write it anew"))) return;
      answer = await api(path, { ...given, overwrite: true });
    }
    on(answer.made);
  } catch {
    // it was said
  }
}

// -- demos and historians ---------------------------------------------------------------------------------------------

for (const button of document.querySelectorAll("[data-demo]")) {
  button.addEventListener("click", async () => {
    button.disabled = true;
    say("Simulating the record …");
    try {
      on((await api("/api/start/demo", { name: button.dataset.demo })).made);
    } catch {
      button.disabled = false;
    }
  });
}

function ofKind() {
  const kind = $("kind").value;
  for (const field of document.querySelectorAll("[data-kinds]")) {
    field.hidden = !field.dataset.kinds.split(" ").includes(kind);
    const entry = field.querySelector("input, select");
    entry.required = field.dataset.needed.split(" ").includes(kind);
    entry.disabled = field.hidden;
  }
}

function loop() {
  const k = document.querySelectorAll("#tags .loop").length + 1;
  const field = (name, label, hint) =>
    el("p", { class: "field" }, el("label", { for: `tag-${name}-${k}` }, `${label}, loop ${k}`),
      el("input", { id: `tag-${name}-${k}`, "data-signal": name, placeholder: hint, required: k === 1 && ["pv", "op"].includes(name) }));
  $("tags").append(
    el("div", { class: "loop" }, field("name", "Name", "fic101"), field("pv", "PV", "FIC101.PV"), field("sp", "SP", "FIC101.SP"),
      field("op", "OP", "FIC101.OP"), field("mode", "Mode", "FIC101.MODE"), field("unit", "Unit of PV", "t/h")),
  );
}

$("kind").addEventListener("change", ofKind);
$("more").addEventListener("click", loop);
$("source").addEventListener("submit", (event) => {
  event.preventDefault();
  const loops = [...document.querySelectorAll("#tags .loop")].map((one) =>
    Object.fromEntries([...one.querySelectorAll("[data-signal]")].map((entry) => [entry.dataset.signal, entry.value])));
  make("/api/start/historian", { ...Object.fromEntries(new FormData($("source"))), loops });
});
ofKind();
loop();
const chosen = data().chosen;
if (chosen) look(chosen, true);
