// The matrix and its editor, the controllers by form and vendor, and the replay of OP.

import { api, data, say, shownVersion } from "./app.js";

const $ = (id) => document.getElementById(id);
const spoken = (name) => name.replaceAll("_", " ");
const element = (name, properties = {}, ...inside) => {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...inside);
  return made;
};
const WAIT = 250; // milliseconds without a key after which what was typed is checked
const given = data();
let { cells, laws } = given;

/** SVG that the app made: put in as a picture, not as text. */
function picture(svg) {
  const made = new DOMParser().parseFromString(svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" '), "image/svg+xml");
  return document.importNode(made.documentElement, true);
}

function later(fn, wait = WAIT) {
  let timer;
  const soon = (...all) => {
    clearTimeout(timer);
    timer = setTimeout(() => fn(...all), wait);
  };
  soon.not = () => clearTimeout(timer); // what is saved is checked at once
  return soon;
}

// -- elements -------------------------------------------------------------------------------------------------------

const editor = $("editor");
const fields = editor.elements;
let open; // the button of the cell that is edited
let asked = 0;

for (const button of document.querySelectorAll(".cell")) {
  button.setAttribute("aria-expanded", "false");
  button.addEventListener("click", () => edit(button));
}

function edit(button) {
  open?.setAttribute("aria-expanded", "false");
  open = button;
  button.setAttribute("aria-expanded", "true");
  const { output, input } = button.dataset;
  const cell = cells[output][input];
  $("editor-title").textContent = `${spoken(output)} from ${spoken(input)}`;
  for (const one of fields.kind) one.checked = one.value === cell.kind;
  const keys = cell.keys;
  fields.tf.value = keys.tf ?? cell.formula ?? "";
  for (const name of ["step", "state_space"]) choose(fields[name], typeof keys[name] === "string" ? keys[name] : "");
  fields.sample_time.value = keys.sample_time ?? "";
  fields.coefficients.value = keys.kind ?? "step";
  fields.ramp.checked = Boolean(keys.ramp);
  choose(fields.gain_unit, keys.gain_unit === "engineering" ? "" : keys.gain_unit ?? "");
  choose(fields.structure, keys.structure ?? (cell.kind === "auto" ? "auto" : ""));
  fields.estimate.checked = keys.estimate !== false;
  choose(fields.column, keys.column ?? "");
  choose(fields.time, keys.time ?? "");
  if (typeof keys.step === "string") columns(keys);
  editor.hidden = false;
  showFields();
  check();
  editor.scrollIntoView({ block: "nearest" });
  const chosen = [...fields.kind].find((one) => one.checked);
  (cell.kind === "tf" ? fields.tf : chosen).focus();
}

function choose(select, value) {
  if (value && ![...select.options].some((one) => one.value === value)) select.append(element("option", { value, textContent: value }));
  select.value = value;
}

const kindNow = () => fields.kind.value;

function showFields() {
  for (const label of editor.querySelectorAll("[data-of]")) label.hidden = !label.dataset.of.split(" ").includes(kindNow());
}

async function columns(keys = {}) {
  for (const name of ["column", "time"]) fields[name].replaceChildren(element("option", { value: "", textContent: name === "time" ? "none" : "the one with its name" }));
  if (!fields.step.value) return;
  try {
    const { columns: names } = await api("/api/model/columns?file=" + encodeURIComponent(fields.step.value), undefined, "GET", { quiet: true });
    for (const name of ["column", "time"]) fields[name].append(...names.map((one) => element("option", { value: one, textContent: one })));
  } catch (error) {
    wrong(error.message);
  }
  choose(fields.column, keys.column ?? "");
  choose(fields.time, keys.time ?? "");
}

function said() {
  const keys = { structure: fields.structure.value, gain_unit: fields.gain_unit.value };
  const kind = kindNow();
  if (kind === "tf") keys.tf = fields.tf.value.trim();
  if (kind === "state_space") keys.state_space = fields.state_space.value;
  if (kind === "step") {
    const own = cells[open.dataset.output][open.dataset.input].keys;
    keys.step = fields.step.value || (Array.isArray(own.step) ? own.step : "");
    Object.assign(keys, { column: fields.column.value, time: fields.time.value });
    if (fields.sample_time.value !== "") keys.sample_time = Number(fields.sample_time.value.replace(",", "."));
    if (fields.coefficients.value === "fir") keys.kind = "fir";
    if (fields.ramp.checked) keys.ramp = true;
  }
  if (!fields.estimate.checked) keys.estimate = false;
  return { output: open.dataset.output, input: open.dataset.input, kind, keys };
}

function wrong(message) {
  $("typed").replaceChildren(element("p", { className: "wrong", textContent: message }));
  if (kindNow() === "tf") fields.tf.setAttribute("aria-invalid", "true");
}

async function check() {
  if (!open) return false;
  const now = ++asked;
  try {
    const got = await api("/api/model/check", said(), "POST", { quiet: true });
    if (now !== asked) return got.right;
    fields.tf.removeAttribute("aria-invalid");
    if (!got.right) {
      wrong(got.why);
      return false;
    }
    const words = { none: "No response: it is zero in the model.", auto: "It is looked for in the record, without a model of it." }[kindNow()];
    $("typed").replaceChildren(...(got.svg ? [picture(got.svg)] : []), element("p", { className: "quiet", textContent: words ?? [got.told, got.words].filter(Boolean).join("; ") }));
    return true;
  } catch (error) {
    wrong(error.message);
    return false;
  }
}

const typed = later(check);
editor.addEventListener("input", (event) => {
  if (event.target.name === "kind") {
    showFields();
    if (kindNow() === "auto" && !fields.structure.value) choose(fields.structure, "auto");
  }
  if (event.target.name === "step") columns();
  typed();
});
editor.addEventListener("submit", async (event) => {
  event.preventDefault();
  typed.not();
  if (!(await check())) {
    say("Not saved: see what is wrong.");
    return;
  }
  const what = said();
  const got = await api("/api/model/element", { ...what, version: shownVersion() });
  cells = got.cells;
  for (const button of document.querySelectorAll(".cell")) face(button);
  say(`${spoken(what.output)} from ${spoken(what.input)}: saved`);
  replay();
});
$("close").addEventListener("click", close);
editor.addEventListener("keydown", (event) => event.key === "Escape" && close());

function close() {
  editor.hidden = true;
  open?.setAttribute("aria-expanded", "false");
  open?.focus();
  open = undefined;
}

function face(button) {
  const cell = cells[button.dataset.output][button.dataset.input];
  const label = given.kinds[cell.kind];
  button.replaceChildren(element("span", { className: `kind ${cell.kind}`, textContent: label }), element("span", { className: "drawn" }, ...(cell.svg ? [picture(cell.svg)] : [])), element("span", { className: "formula", textContent: cell.formula }));
  if (cell.words) button.append(element("span", { className: "quiet", textContent: cell.words }));
  button.setAttribute("aria-label", `${spoken(button.dataset.output)} from ${spoken(button.dataset.input)}: ${label} ${cell.formula}; change`);
}

// -- controllers ----------------------------------------------------------------------------------------------------

const { ways, common, more, choices, defaults, labels, texts } = given.choices;

function card(law) {
  const form = element("form", { className: "law card", noValidate: true });
  form.dataset.input = law.input;
  const name = `${spoken(law.output)} by ${spoken(law.input)}`;
  const way = element("select", { name: "way" });
  way.append(...Object.entries(ways).map(([value, one]) => element("option", { value, textContent: one.label })));
  way.value = law.way;
  const top = element("div", { className: "fields" });
  const rest = element("div", { className: "fields" });
  const told = element("p", { className: "told quiet", textContent: law.told ?? "" });
  told.setAttribute("aria-live", "polite");
  const details = element("details", {}, element("summary", { textContent: "What else this controller does" }), rest);
  const values = { ...law.keys };
  const build = () => {
    const own = [...ways[way.value].keys, ...law.also.filter((key) => way.value === law.way)];
    top.replaceChildren(element("label", {}, "As shown by ", way), ...[...own, ...common].map((key) => field(key, values)));
    rest.replaceChildren(...(way.value === "tf" ? [] : more.map((key) => field(key, values))));
    details.hidden = way.value === "tf";
  };
  build();
  details.open = more.some((key) => key in law.keys);
  const gathered = () => {
    const keys = { way: way.value };
    for (const one of form.querySelectorAll("[data-key]")) keys[one.dataset.key] = one.value.trim();
    return { input: law.input, output: law.output, keys };
  };
  let number = 0;
  const test = async () => {
    const now = ++number;
    let got;
    try {
      got = await api("/api/model/check-law", gathered(), "POST", { quiet: true });
    } catch (error) {
      got = { right: false, why: error.message };
    }
    if (now !== number) return got.right;
    told.textContent = got.right ? got.told : got.why;
    told.className = got.right ? "told quiet" : "told wrong";
    return got.right;
  };
  const soon = later(test);
  form.addEventListener("input", (event) => {
    if (event.target.dataset.key) values[event.target.dataset.key] = event.target.value;
    if (event.target === way) build();
    if (event.target === way) way.focus();
    soon();
  });
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    soon.not();
    if (!(await test())) return say("Not saved: see what is wrong.");
    await api("/api/model/controller", { ...gathered(), version: shownVersion() });
    say(`Controller of ${spoken(law.input)}: saved`);
    return replay();
  });
  const gone = element("button", { type: "button", textContent: "Take out" });
  gone.setAttribute("aria-label", `${name}: take the controller out`);
  gone.addEventListener("click", async () => {
    if (!law.fresh) await api("/api/model/controller", { input: law.input, output: law.output, gone: true, version: shownVersion() });
    form.remove();
    say(`Controller of ${spoken(law.input)}: taken out. Undo brings it back.`);
    if (!law.fresh) replay();
  });
  form.append(element("h3", { textContent: name }), top, details, told);
  if (law.extra?.length) form.append(element("p", { className: "quiet", textContent: `Kept as the file has it: ${law.extra.join(", ")}.` }));
  form.append(element("div", { className: "row" }, element("button", { type: "submit", className: "primary", textContent: "Save" }), gone));
  form.setAttribute("aria-label", name);
  return form;
}

function field(key, values) {
  const unit = ["Ti", "Td", "Tf", "sample_time"].includes(key) ? `, ${given.time_unit}` : "";
  const label = element("label", {}, `${labels[key]}${unit}`);
  const value = values[key] ?? defaults[key] ?? "";
  let made;
  if (choices[key]) {
    made = element("select", {}, ...choices[key].map((one) => element("option", { value: one, textContent: one || "signs as given" })));
    made.value = value;
  } else {
    made = element("input", { value, autocomplete: "off", spellcheck: false, className: texts.includes(key) ? "long" : "" });
    if (!texts.includes(key)) made.inputMode = "decimal";
  }
  made.dataset.key = key;
  label.append(made);
  return label;
}

for (const law of laws) $("laws").append(card(law));
$("add").addEventListener("click", () => {
  const [input, output] = [$("new-input").value, $("new-output").value];
  const law = { input, output, way: "ideal", keys: {}, also: [], extra: [], told: "Type its settings.", fresh: true };
  if (laws.some((one) => one.input === input && one.output === output)) {
    say("That controller is there already.");
    return;
  }
  const made = card(law);
  $("laws").append(made);
  made.querySelector("input").focus();
});

// -- replay ---------------------------------------------------------------------------------------------------------

let replays = 0;

async function replay() {
  const place = $("replay");
  if (!place.dataset.ready) return;
  const now = ++replays;
  place.dataset.state = "waiting";
  let got;
  try {
    got = await api("/api/model/replay", undefined, "GET", { quiet: true });
  } catch (error) {
    got = { error: error.message };
  }
  if (now !== replays) return;
  place.dataset.state = "done";
  if (got.error) {
    place.replaceChildren(element("p", { className: "message", textContent: `It cannot be told: ${got.error}` }));
    return;
  }
  if (!got.replays.length) {
    place.replaceChildren(element("p", { className: "note", textContent: "No controller is declared, so there is nothing to replay. The plant can be found without one; margins and settings cannot." }));
    return;
  }
  const several = new Set(got.replays.map((one) => one.experiment)).size > 1;
  place.replaceChildren(
    ...got.replays.map((one) => {
      const [kind, word] = one.confirmed === true ? ["yes", "Yes"] : one.confirmed === false ? ["no", one.since ? `Not from ${one.since} on` : "No"] : ["open", "Cannot be told"];
      const box = element("div", { className: `replayed ${kind}` }, element("p", {}, element("strong", { textContent: `${spoken(one.input)}${several ? ` (${one.experiment})` : ""}: ${word}. ` }), `${one.message[0].toUpperCase()}${one.message.slice(1)}.`));
      if (one.svg) {
        box.append(picture(one.svg), element("p", { className: "quiet" }, element("span", { className: "line" }), " OP as recorded ", element("span", { className: "line law" }), " as the declared controller writes it"));
      }
      return box;
    }),
  );
}

replay();
