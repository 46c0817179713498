// Tags: a row a loop. Every change goes to the project file; the page is drawn anew from what it says then.

import { api, data, say, shownVersion } from "./app.js";
import { ask, el, loopTitle, spark } from "./dom.js";

const $ = (id) => document.getElementById(id);
const given = data();
let state = given.state;
let columns = [];
let outside = [];

const WORDS = {
  sure: ["good", "✓ by its name"],
  likely: ["doubt", "? likely, look at it"],
  chosen: ["own", "● chosen by you"],
};
const byName = () => new Map(columns.map((one) => [one.name, one]));
const number = (x) => (x === null ? "" : Number(x.toPrecision(4)).toString());

async function change(path, body, said) {
  const focused = document.activeElement?.id;
  try {
    const answer = await api(path, { ...body, version: shownVersion() });
    state = answer.state;
    if (said) say(said);
  } catch {
    // it was said; what the project has is shown again
  }
  draw();
  if (focused) document.getElementById(focused)?.focus();
}

const set = (table, name, keys) => change("/api/tags/set", { table, name, keys }, "Written into the project.");

// -- one loop ---------------------------------------------------------------------------------------------------------

function options(chosen, needed) {
  const names = columns.map((one) => one.name);
  if (chosen && !names.includes(chosen)) names.unshift(chosen);
  return [
    ...(needed && chosen ? [] : [el("option", { value: "" }, needed ? "choose" : "none")]),
    ...names.map((name) => el("option", { value: name, selected: name === chosen }, name)),
  ];
}

function signal(id, label, kind, column, certainty, needed, changed) {
  const known = byName().get(column);
  const words = WORDS[certainty];
  return el("div", { class: `field ${kind}` },
    el("label", { for: id }, label),
    el("select", { id, onchange: (event) => changed(event.target.value) }, options(column, needed)),
    known?.trend.length ? spark(known.trend, `Small trend of ${column}, from ${number(known.low)} to ${number(known.high)}`) : null,
    el("div", { class: "how" },
      words ? el("span", { class: `badge ${words[0]}` }, words[1]) : el("span", { class: "quiet" }, "– none"),
      known?.trend.length ? el("span", { class: "quiet" }, `${number(known.low)} to ${number(known.high)}`) : null,
      columns.length && column && !known ? el("span", { class: "badge bad" }, "✗ not in the file") : null));
}

function text(id, label, value, hint, changed) {
  return el("p", { class: "field" }, el("label", { for: id }, label),
    el("input", { id, value: value ?? "", placeholder: hint, onchange: (event) => changed(event.target.value) }));
}

function range(id, label, value, about, changed) {
  const low = el("input", { id: `${id}-low`, value: value ? String(value[0]) : "", inputmode: "decimal", "aria-label": `${label}, low end`, placeholder: "low" });
  const high = el("input", { id: `${id}-high`, value: value ? String(value[1]) : "", inputmode: "decimal", "aria-label": `${label}, high end`, placeholder: "high" });
  const tell = () => {
    // half a range is not written yet
    if ((low.value.trim() === "") === (high.value.trim() === "")) changed([low.value, high.value]);
  };
  low.addEventListener("change", tell);
  high.addEventListener("change", tell);
  return el("div", { class: "field", role: "group", "aria-label": label, title: about }, el("span", { class: "label" }, label), el("span", { class: "pair" }, low, "to", high));
}

const same = (value, one) => {
  const number = Number(value.replace(",", "."));
  if (value.trim() !== "" && !Number.isNaN(number) && typeof one === "number") return number === one;
  return value.trim().toLowerCase() === String(one).trim().toLowerCase();
};

function modes(input, k) {
  const known = byName().get(input.mode)?.modes;
  if (!input.mode || !columns.length) return null;
  if (!known) return el("p", { class: "message" }, `${input.mode} holds too many different values for modes: choose another column.`);
  const declared = input.automatic_values ?? [];
  const ticked = (value, means) => (declared.length ? declared.some((one) => same(value, one)) : means === true);
  const unknown = declared.length ? [] : known.filter(([, , means]) => means === null).map(([value]) => value);
  const boxes = known.map(([value, count, means], m) => {
    const id = `mode-${k}-${m}`;
    const box = el("input", { type: "checkbox", id, checked: ticked(value, means) });
    box.addEventListener("change", () => {
      const chosen = known.filter((_, n) => document.getElementById(`mode-${k}-${n}`).checked).map(([one]) => one);
      if (!chosen.length) {
        box.checked = true;
        say("At least one value means that the controller acts: take the mode out if none does.");
        return;
      }
      const usual = known.filter(([, , meaning]) => meaning === true).map(([one]) => one);
      const asUsual = chosen.length === usual.length && chosen.every((one) => usual.includes(one));
      set("input", input.name, { automatic_values: asUsual ? [] : chosen });
    });
    const doubt = means === null && !declared.length ? el("span", { class: "badge doubt" }, "? not known") : null;
    return el("label", { for: id }, box, ` ${value} `, el("span", { class: "quiet" }, `${count.toLocaleString("en")} rows `), doubt);
  });
  return el("fieldset", { class: "modes" }, el("legend", {}, "In which modes does the controller act?"), ...boxes,
    unknown.length ? el("p", { class: "quiet" }, `What ${unknown.join(", ")} means is not known, and counts as not automatic: tick it if the controller acts.`) : null);
}

function slave(input, k) {
  const sp = el("select", { id: `slave-sp-${k}` }, options(input.slave_sp));
  const pv = el("select", { id: `slave-pv-${k}` }, options(input.slave_pv));
  const tell = () => {
    if (!sp.value === !pv.value) set("input", input.name, { slave_sp: sp.value, slave_pv: pv.value });
    else say("A slave has a set-point and a PV: choose both columns, or none.");
  };
  sp.addEventListener("change", tell);
  pv.addEventListener("change", tell);
  return el("details", { open: Boolean(input.slave_sp) }, el("summary", {}, "OP goes to a slave controller (cascade)"),
    el("div", { class: "signals" },
      el("p", { class: "field" }, el("label", { for: `slave-sp-${k}` }, "SP of the slave"), sp),
      el("p", { class: "field" }, el("label", { for: `slave-pv-${k}` }, "PV of the slave"), pv)));
}

function card(loop, k) {
  const { output, input, certainty } = loop;
  const parts = [];
  const rest = [];
  if (output) {
    const change = (keys) => set("output", output.name, keys);
    parts.push(
      signal(`pv-${k}`, "PV, what is measured", "pv", output.pv, certainty.pv, true, (pv) => change({ pv })),
      signal(`sp-${k}`, "SP, the set-point", "sp", output.sp, certainty.sp, false, (sp) => change({ sp })));
    rest.push(
      text(`unit-${k}`, "Unit of PV", output.unit, "degC", (unit) => change({ unit })),
      el("p", { class: "field" }, el("label", { for: `kind-${k}` }, "Kind of loop"),
        el("select", { id: `kind-${k}`, onchange: (event) => change({ kind: event.target.value }) },
          el("option", { value: "" }, "not said"), given.kinds.map((one) => el("option", { value: one, selected: one === output.kind }, one)))),
      range(`limits-${k}`, "Limits of PV", output.limits, "The instrument's range: samples at its ends or beyond are left out", (limits) => change({ limits })),
      range(`span-${k}`, "Span of PV", output.span, "What 100 % are, for gains in per cent of span and proportional bands", (span) => change({ span })));
  }
  if (input) {
    const change = (keys) => set("input", input.name, keys);
    parts.push(
      signal(`op-${k}`, "OP, the controller's output", "op", input.op, certainty.op, true, (op) => change({ op })),
      signal(`mode-${k}`, "Mode", "mode", input.mode, certainty.mode, false, (mode) => change(mode ? { mode } : { mode, automatic_values: [] })));
    rest.push(
      text(`op-unit-${k}`, "Unit of OP", input.unit, "%", (unit) => change({ unit })),
      range(`op-limits-${k}`, "Limits of OP", input.limits, "Where OP saturates", (limits) => change({ limits })),
      range(`op-span-${k}`, "Span of OP", input.span, "What 100 % are", (span) => change({ span })));
  }
  const status = [];
  if (output) status.push(signal(`status-${k}`, "Status of PV", "status", output.status, certainty.status_output, false, (one) => set("output", output.name, { status: one })));
  if (input) status.push(signal(`op-status-${k}`, "Status of OP", "status", input.status, certainty.status_input, false, (one) => set("input", input.name, { status: one })));
  const title = loopTitle(output?.name, input?.name);
  return el("section", { class: "loop card", "aria-label": `Loop ${title}` },
    el("header", {}, el("h2", {}, title), el("button", { type: "button", id: `remove-${k}`, onclick: () => remove(loop, title) }, "Remove")),
    el("div", { class: "signals" }, parts),
    input ? modes(input, k) : null,
    el("div", { class: "rest" }, rest),
    el("details", { open: Boolean(output?.status || input?.status) }, el("summary", {}, "Status (quality) of the values"), el("div", { class: "signals" }, status)),
    input ? slave(input, k) : null);
}

async function remove(loop, title) {
  const also = loop.named ? ` ${loop.named} of it go, too.` : "";
  if (await ask(`Take the loop ${title} out of the project?${also} That can be undone.`, "Take it out")) {
    change("/api/tags/remove", { output: loop.output?.name, input: loop.input?.name }, "The loop was taken out.");
  }
}

// -- other columns ----------------------------------------------------------------------------------------------------

function others() {
  const used = new Map();
  for (const { output, input } of state.loops) {
    for (const key of ["pv", "sp", "status"]) if (output?.[key]) used.set(output[key], true);
    for (const key of ["op", "mode", "status"]) if (input?.[key]) used.set(input[key], true);
    for (const key of ["slave_sp", "slave_pv"]) if (input?.[key]) used.set(input[key], `slave of ${input.name}`);
  }
  const acting = new Map(state.disturbances.map((one) => [one.column, one]));
  const rows = columns.filter((one) => used.get(one.name) !== true).map((one, k) => {
    const id = `use-${k}`;
    const slave = used.get(one.name);
    const use = slave ? slave : el("select", { id, "aria-label": `Use of ${one.name}`,
      onchange: (event) => change("/api/tags/use", { column: one.name, use: event.target.value, unit: one.unit }, "Written into the project.") },
      el("option", { value: "ignore" }, "ignore"), el("option", { value: "disturbance", selected: acting.has(one.name) }, "measured disturbance"));
    const likely = !slave && !acting.has(one.name) && outside.includes(one.name);
    return el("tr", {}, el("th", { scope: "row" }, one.name, one.unit ? el("span", { class: "quiet" }, ` ${one.unit}`) : null),
      el("td", {}, one.trend.length ? spark(one.trend, `Small trend of ${one.name}`) : el("span", { class: "quiet" }, "no numbers")),
      el("td", {}, use),
      el("td", {}, likely ? el("span", { class: "badge doubt" }, "? may act from outside") : acting.has(one.name) ? el("span", { class: "badge own" }, "● chosen by you") : null));
  });
  $("others").replaceChildren(
    el("thead", {}, el("tr", {}, ["Column", "Trend", "Use", ""].map((name) => (name ? el("th", { scope: "col" }, name) : el("td", {}))))),
    el("tbody", {}, rows.length ? rows : el("tr", {}, el("td", { colspan: "4" }, columns.length ? "Every column belongs to a loop." : "…"))));
}

$("new").addEventListener("submit", (event) => {
  event.preventDefault();
  change("/api/tags/add", Object.fromEntries(new FormData(event.target)), "The loop was added.").then(() => ($("add").open = false));
});

function draw() {
  $("loops").replaceChildren(...state.loops.map(card));
  for (const key of ["pv", "sp", "op", "mode"]) $(`new-${key}`).replaceChildren(...options("", ["pv", "op"].includes(key)));
  others();
}

draw();
api("/api/tags/columns", undefined, undefined, { quiet: true })
  .then((answer) => {
    columns = answer.columns;
    outside = answer.outside ?? [];
    $("busy").textContent = "";
    if (answer.told) told(answer.told);
    draw();
  })
  .catch((error) => {
    $("busy").textContent = "";
    told(error.message);
  });

function told(message) {
  $("told").textContent = message;
  $("told").hidden = false;
}
