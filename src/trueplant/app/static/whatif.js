// Sliders and their curves. A newer position overtakes an older one; numbers and judgement follow when it rests.

import { address, alarm, api, color, noteVersion, onThemeChange, say, shownVersion } from "./app.js";

const page = Math.random().toString(36).slice(2);
const $ = (id) => document.getElementById(id);
const desk = $("desk");
const result = new URLSearchParams(location.search).get("result");
const path = (verb) => `/api/whatif/${verb}${result ? `?result=${encodeURIComponent(result)}` : ""}`;
const narrow = matchMedia("(max-width: 900px)");
const STEPS = 200; // of a slider, from end to end
const RANGE = 10; // a slider goes from a tenth to ten times
const QUIET = 120; // milliseconds without a move after which numbers are asked for

let found; // what the page opened with
let tried; // settings by input
let shown; // input of the loop that is drawn
let wider = {}; // by input: how often its time axis was doubled
let last; // the curves that are drawn
let moves = 0; // counted, so that an answer is known to be the newest

const number = (value, digits = 3) => {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size >= 1e5 || size < 1e-3)) return value.toExponential(digits - 1);
  return String(Number(value.toPrecision(digits)));
};
const element = (name, properties = {}, ...inside) => {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...inside);
  return made;
};
const spoken = (name) => name.replaceAll("_", " ");
const loopOf = (input) => found.loops.find((one) => one.input === input);

// -- settings -------------------------------------------------------------------------------------------------------

const hints = {
  Kc: (loop) => (loop.gain_unit === "engineering" ? `gain, ${loop.input_unit || "OP"} per ${loop.output_unit || "PV"}` : "gain, per cent of span"),
  Ti: () => `integral time, ${found.time_unit}`,
  Td: () => `derivative time, ${found.time_unit}`,
  Kp: () => "proportional gain",
  Ki: () => `integral gain per ${found.time_unit}`,
  Kd: () => `derivative gain times ${found.time_unit}`,
};

/** What a slider reaches: a tenth to ten times today's, or from 0 where today's is 0. */
function scaleOf(loop, key) {
  const now = loop.today[key];
  const sign = now < 0 ? -1 : 1;
  const others = Object.values(loop.presets).map((one) => Math.abs(one.settings[key] ?? 0));
  if (now && key !== "Td" && key !== "Kd") {
    const low = Math.abs(now) / RANGE;
    return {
      value: (at) => sign * low * (RANGE * RANGE) ** (at / STEPS),
      at: (value) => (STEPS * Math.log(Math.abs(value) / low)) / Math.log(RANGE * RANGE),
    };
  }
  const top = Math.max(4 * Math.abs(now || 0), 1.5 * Math.max(0, ...others), (loop.today.Ti || 0) / 2) || 1;
  return { value: (at) => (sign * top * at) / STEPS, at: (value) => (STEPS * Math.abs(value || 0)) / top };
}

function build() {
  for (const loop of found.loops) {
    const box = element("fieldset", { className: "loop" }, element("legend", { textContent: `${spoken(loop.output)} by ${spoken(loop.input)}` }));
    box.dataset.input = loop.input;
    if (!loop.keys.length) {
      box.append(element("p", { className: "quiet", textContent: `This controller is no PID (${loop.tf}): it stays as it is.` }));
    }
    for (const key of loop.keys) box.append(setting(loop, key));
    if (loop.keys.length) {
      const back = element("button", { type: "button", textContent: "As today" });
      back.setAttribute("aria-label", `${spoken(loop.input)}: as today`);
      back.addEventListener("click", () => set(loop.input, { ...loop.today }));
      box.append(back);
    }
    box.addEventListener("focusin", () => draw(loop.input));
    box.addEventListener("pointerdown", () => draw(loop.input));
    $("loops").append(box);
  }
  const names = [...new Set(found.loops.flatMap((loop) => Object.keys(loop.presets)))];
  preset("Today", (loop) => loop.today);
  for (const name of names) {
    const first = found.loops.find((loop) => loop.presets[name]);
    const best = found.loops.some((loop) => loop.recommended === name);
    preset(first.presets[name].label + (best ? " (recommended)" : ""), (loop) => loop.presets[name]?.settings ?? loop.today);
  }
}

function preset(label, settings) {
  const button = element("button", { type: "button", textContent: label });
  button.addEventListener("click", () => {
    for (const loop of found.loops) tried[loop.input] = { ...settings(loop) };
    refresh();
    say(`${label}: set in all loops`);
  });
  $("presets").append(button);
}

function setting(loop, key) {
  const scale = scaleOf(loop, key);
  const name = `${spoken(loop.input)} ${key}`;
  const slider = element("input", { type: "range", min: 0, max: STEPS, step: 1 });
  const field = element("input", { type: "number", step: "any", inputMode: "decimal" });
  const id = `${loop.input}-${key}`;
  field.id = id;
  slider.setAttribute("aria-label", name);
  slider.dataset.key = field.dataset.key = key;
  const none = key === "Ti" && !loop.today.Ti;
  slider.disabled = none && !Object.values(loop.presets).some((one) => one.settings.Ti);
  const show = () => {
    const value = tried[loop.input][key];
    const known = value !== null && value !== undefined;
    if (document.activeElement !== field) field.value = known ? Number(Number(value).toPrecision(5)) : "";
    slider.value = known ? Math.round(scale.at(value)) : STEPS;
    slider.setAttribute("aria-valuetext", known ? `${number(value, 4)}` : "none");
  };
  slider.addEventListener("input", () => {
    tried[loop.input][key] = Number(scale.value(Number(slider.value)).toPrecision(4));
    show();
    draw(loop.input, true);
  });
  field.addEventListener("input", () => {
    const value = field.value === "" ? null : Number(field.value);
    const wrong = value === null ? key !== "Ti" : !Number.isFinite(value) || (key[0] !== "K" && value < 0) || (key === "Kc" && value === 0);
    field.setAttribute("aria-invalid", wrong);
    if (wrong) return;
    tried[loop.input][key] = value === 0 && key === "Ti" ? null : value;
    show();
    draw(loop.input, true);
  });
  field.addEventListener("blur", show);
  const row = element("div", { className: "setting" }, element("label", { htmlFor: id, textContent: key }), slider, field);
  row.append(element("small", { textContent: `${hints[key]?.(loop) ?? ""}; today ${number(loop.today[key], 4)}` }));
  row.show = show;
  return row;
}

function set(input, settings) {
  tried[input] = settings;
  refresh(input);
}

function refresh(input = shown) {
  for (const row of document.querySelectorAll(".setting")) row.show();
  draw(input, true);
}

const isSame = (loop) => loop.keys.every((key) => (tried[loop.input][key] ?? null) === (loop.today[key] ?? null));

// -- curves ---------------------------------------------------------------------------------------------------------

function draw(input, moved = false) {
  if (input !== shown) {
    shown = input;
    for (const box of document.querySelectorAll(".loop")) box.classList.toggle("shown", box.dataset.input === input);
    const loop = loopOf(input);
    $("step").value = loop.step;
    $("load").value = loop.load;
    $("step-unit").textContent = loop.output_unit;
    $("load-unit").textContent = loop.input_unit;
    place();
    if (answers) table(answers);
    moved = moved || found.loops.every((one) => isSame(one)) || !last || last.loop !== input;
  }
  if (moved) ask();
}

/** On a narrow screen the curves stand below the sliders that move them. */
function place() {
  const figure = $("figure");
  const box = narrow.matches ? document.querySelector(`.loop[data-input="${CSS.escape(shown)}"]`) : $("key");
  if (box && figure.previousElementSibling !== box) box.after(figure);
}

let waiting = false;
let again = false;
let timer;

async function ask() {
  moves += 1;
  desk.classList.add("old");
  clearTimeout(timer);
  if (waiting) {
    again = true; // the newest position is asked for as soon as there is room
    return;
  }
  waiting = true;
  const asked = moves;
  const began = performance.now();
  try {
    const loop = loopOf(shown);
    const got = await api(path("curves"), { page, settings: tried, loop: shown, step: loop.step, load: loop.load, wider: wider[shown] ?? 0 }, "POST", { quiet: true });
    if (!got.overtaken) {
      last = got;
      plot(got);
      desk.dataset.milliseconds = Math.round(performance.now() - began);
      desk.dataset.drawn = asked;
    }
  } catch (error) {
    judge({ state: "no", sentence: error.message, loops: {} });
  }
  waiting = false;
  if (again) {
    again = false;
    ask();
  } else {
    timer = setTimeout(numbers, QUIET);
  }
}

function plot(got) {
  const loop = loopOf(got.loop);
  const titles = [
    ["set-point", "pv", `PV after a set-point step${loop.output_unit ? ` (${loop.output_unit})` : ""}`],
    ["load", "pv", `PV after a load step${loop.output_unit ? ` (${loop.output_unit})` : ""}`],
    ["set-point", "op", `OP after a set-point step${loop.input_unit ? ` (${loop.input_unit})` : ""}`],
    ["load", "op", `OP after a load step${loop.input_unit ? ` (${loop.input_unit})` : ""}`],
  ];
  const [ink, grid, axis] = ["ink", "grid", "axis"].map(color);
  const traces = [];
  const layout = {
    margin: { l: 56, r: 12, t: 26, b: 40 },
    showlegend: false,
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    font: { color: ink, size: 12, family: "system-ui, sans-serif" },
    annotations: [],
    shapes: [],
    dragmode: false,
    hovermode: "x",
    uirevision: got.loop,
  };
  const columns = innerWidth < 600 ? 1 : 2;
  const rows = 4 / columns;
  titles.forEach(([kind, signal, title], k) => {
    const name = k ? String(k + 1) : "";
    const [column, row] = [k % columns, Math.floor(k / columns)];
    const width = 1 / columns;
    const height = 1 / rows;
    const left = column * width + (column ? 0.045 : 0);
    const right = (column + 1) * width - (column < columns - 1 ? 0.03 : 0);
    const top = 1 - row * height - (row ? 0.07 / (rows / 2) : 0);
    const bottom = 1 - (row + 1) * height + (row < rows - 1 ? 0.06 / (rows / 2) : 0);
    const both = got.curves[kind][signal];
    const unit = row === rows - 1 ? `time (${found.time_unit})` : "";
    layout[`xaxis${name}`] = { domain: [left, right], anchor: `y${name}`, gridcolor: grid, linecolor: axis, zeroline: false, title: { text: unit, standoff: 6 }, range: [0, got.span] };
    layout[`yaxis${name}`] = { domain: [bottom, top], anchor: `x${name}`, gridcolor: grid, linecolor: axis, zeroline: false, range: rangeOf(both) };
    layout.annotations.push({ text: title, xref: "paper", yref: "paper", x: left, y: top, xanchor: "left", yanchor: "bottom", showarrow: false, font: { size: 12, color: ink } });
    for (const [who, role] of [["today", "before"], ["tried", "after"]]) {
      const one = both[who];
      const common = { x: one.t, xaxis: `x${name}`, yaxis: `y${name}`, mode: "lines" };
      traces.push({ ...common, y: one.low, line: { width: 0 }, hoverinfo: "skip" });
      traces.push({ ...common, y: one.high, line: { width: 0 }, fill: "tonexty", fillcolor: color(`${role}-band`), hoverinfo: "skip" });
      traces.push({ ...common, y: one.middle, name: who, line: { color: color(role), width: 2, dash: who === "today" ? "dash" : "solid" } });
    }
    const range = layout[`yaxis${name}`].range;
    for (const limit of signal === "op" ? loop.op_limits : []) {
      if (limit === null || limit < range[0] || limit > range[1]) continue;
      layout.shapes.push({ type: "line", xref: `x${name} domain`, yref: `y${name}`, x0: 0, x1: 1, y0: limit, y1: limit, line: { color: color("limit"), dash: "dot", width: 1.4 } });
      layout.annotations.push({ text: "OP limit", xref: `x${name} domain`, yref: `y${name}`, x: 1, y: limit, xanchor: "right", yanchor: limit === loop.op_limits[0] ? "bottom" : "top", showarrow: false, font: { size: 11 } });
    }
  });
  $("drawn").textContent = `${spoken(loop.output)} by ${spoken(loop.input)}`;
  const ends = got.curves["set-point"].pv;
  const reach = (one) => number(Math.max(...one.middle), 4);
  const at = got.at_limit.tried > 0 ? ` OP comes to rest on its limit on ${Math.round(100 * got.at_limit.tried)} % of the plants.` : "";
  $("curve-words").textContent = `From PV ${number(loop.pv, 4)} and OP ${number(loop.op, 4)}, where the record worked. After the set-point step PV goes up to ${reach(ends.tried)} at most with what is tried, today ${reach(ends.today)}.${at}`;
  $("curve-words").classList.toggle("over", Boolean(at));
  Plotly.react($("curves"), traces, layout, { displayModeBar: false, responsive: true });
}

/** What both medians need, and of the bands as much again at most. */
function rangeOf(both) {
  const middle = [...both.today.middle, ...both.tried.middle].filter((y) => Math.abs(y) < 1e11);
  let [low, high] = [Math.min(...middle), Math.max(...middle)];
  const room = high - low || Math.abs(high) / 100 || 1;
  const wide = [...both.today.low, ...both.tried.low, ...both.today.high, ...both.tried.high];
  low = Math.max(Math.min(...wide), low - room);
  high = Math.min(Math.max(...wide), high + room);
  return [low - 0.06 * (high - low || room), high + 0.06 * (high - low || room)];
}

// -- numbers --------------------------------------------------------------------------------------------------------

let answers;

async function numbers() {
  const asked = moves;
  const changed = found.loops.filter((loop) => !isSame(loop)).map((loop) => loop.input);
  const units = Object.fromEntries(found.loops.map((loop) => [loop.input, loop.gain_unit]));
  try {
    const got = await api(path("numbers"), { page, settings: tried, gain_units: units, changed }, "POST", { quiet: true });
    if (got.overtaken || asked !== moves) return;
    answers = got;
    judge(got);
    table(got);
    $("text").textContent = got.text || "# settings are today's";
    $("save").disabled = changed.length === 0;
    desk.classList.remove("old");
    desk.dataset.judged = asked;
    widen(got);
  } catch (error) {
    judge({ state: "no", sentence: error.message, loops: {} });
  }
}

/** A longer time axis where what is tried has not settled on it. */
function widen(got) {
  const one = got.loops[shown]?.tried;
  const settled = Math.max(one?.settling ?? 0, one?.load_settling ?? 0);
  const own = loopOf(shown);
  const wanted = Math.min(4, Math.max(0, Math.ceil(Math.log2(settled / own.span || 1))));
  if (wanted !== (wider[shown] ?? 0)) {
    wider[shown] = wanted;
    ask();
  }
}

const HEADS = {
  same: "These are today's settings",
  recommended: "Recommended",
  keep: "Not worth a change",
  no: "Not recommended",
};

function judge(got) {
  const box = $("verdict");
  box.className = `card ${got.state}`;
  box.replaceChildren(element("p", { className: "headline", textContent: HEADS[got.state] }));
  if (got.state === "same") {
    const loop = loopOf(shown);
    const reason = loop.reason || "Move a slider, or choose where to start from.";
    box.append(element("p", { textContent: loop.reason ? `The analysis: ${plain(reason)}` : reason }));
  } else {
    box.append(element("p", { textContent: capital(plain(got.sentence)) }));
  }
}

/** A sentence of the analysis as it is read on a page: no line ends between a number and its per cent. */
const plain = (text) => found.loops.reduce((said, { input }) => said.replaceAll(input, spoken(input)), text)
  .replaceAll("->", "→").replaceAll(" %", "\u00a0%");

const capital = (text) => (text ? `${text[0].toUpperCase()}${text.slice(1)}.` : "");

const ROWS = [
  ["Ms", "Peak of sensitivity (Ms)", (v) => number(v)],
  ["Ms95", "Ms on 95 % of the plants at most", (v) => number(v)],
  ["Mt", "Peak of T (Mt)", (v) => number(v)],
  ["share", "Plants on which Ms and Mt hold", (v) => (v === null ? "–" : `${number(100 * v)} %`)],
  ["overshoot", "Overshoot of a set-point step", (v) => (v === null ? "–" : `${number(100 * v, 2)} %`)],
  ["settling", "Settling of a set-point step", (v) => (v === null ? "–" : `${number(v)} ${found.time_unit}`)],
  ["load_error", "Error of a unit load step, integrated", (v) => number(v)],
  ["op_moves", "OP movement, unit set-point step", (v) => number(v)],
  ["op_noise", `OP movement by noise`, (v) => number(v)],
  ["mu", "mu of robust performance", (v) => number(v)],
];

function table(got) {
  const own = got.loops[shown];
  if (!own) return;
  const rows = ROWS.filter(([key]) => key !== "mu" || own.tried.mu !== null).map(([key, label, words]) => {
    const word = own.beyond[key] ?? "";
    const cell = element("td", { className: word ? "n over" : "n", textContent: words(own.tried[key]) });
    const side = element("td", { className: word ? "over" : "quiet", textContent: word ? word : change(own.today[key], own.tried[key]) });
    return element("tr", {}, element("th", { scope: "row", textContent: label }), element("td", { className: "n", textContent: words(own.today[key]) }), cell, side);
  });
  if (own.beyond.crossover) rows.unshift(element("tr", {}, element("th", { scope: "row", textContent: "Speed" }), element("td"), element("td", { className: "n over", textContent: "too fast" }), element("td", { className: "over", textContent: "faster than the record vouches for" })));
  $("numbers").tBodies[0].replaceChildren(...rows);
  $("numbers").caption.textContent = `${spoken(loopOf(shown).output)} by ${spoken(shown)}, on the plant as estimated`;
  const others = got.state === "same" ? [] : found.loops.filter((loop) => loop.input !== shown);
  $("others").replaceChildren(
    ...others.map((loop) => {
      const one = got.loops[loop.input];
      const words = Object.values(one.beyond).length ? ` Beyond limits: ${Object.entries(one.beyond).map(([key, word]) => (key === "crossover" ? word : `${key} ${word}`)).join(", ")}.` : "";
      const line = element("p", {}, element("strong", { textContent: `${spoken(loop.input)}: ` }), `${plain(one.price)}.`);
      if (words) line.append(element("span", { className: "over", textContent: words }));
      return line;
    }),
  );
}

function change(before, after) {
  if (!before || after === null || after === undefined) return "";
  const ratio = after / before;
  if (Math.abs(ratio - 1) < 0.005) return "as today";
  return ratio > 3 || ratio < 1 / 3 ? `${number(ratio, 2)} times today's` : `${ratio > 1 ? "+" : "−"}${number(100 * Math.abs(ratio - 1), 2)} %`;
}

// -- the rest -------------------------------------------------------------------------------------------------------

for (const key of ["step", "load"]) {
  $(key)?.addEventListener("input", () => {
    const value = Number($(key).value);
    const wrong = $(key).value === "" || !Number.isFinite(value) || value === 0;
    $(key).setAttribute("aria-invalid", wrong);
    if (wrong) return;
    loopOf(shown)[key] = value;
    ask();
  });
}
$("save")?.addEventListener("click", async () => {
  const changed = found.loops.filter((loop) => !isSame(loop)).map((loop) => loop.input);
  const units = Object.fromEntries(found.loops.map((loop) => [loop.input, loop.gain_unit]));
  await api(path("save"), { settings: tried, changed, gain_units: units, version: shownVersion() });
  say("Saved as [[candidate]] in the project file; the next run judges it.");
});
$("tuning")?.addEventListener("click", async () => {
  noteVersion(await api(path("tuning"), { version: shownVersion() }));
  $("ask").hidden = true;
  location.href = address("/run");
});

try {
  found = await api(path("open"), { page }, "POST", { quiet: true });
  tried = Object.fromEntries(found.loops.map((loop) => [loop.input, { ...loop.today }]));
  build();
  for (const doubt of found.doubts) $("desk").before(element("p", { className: "note", textContent: `Not checked: ${doubt}` }));
  $("ask").hidden = found.proposed;
  desk.hidden = false;
  for (const row of document.querySelectorAll(".setting")) row.show();
  draw((found.loops.find((loop) => loop.keys.length) ?? found.loops[0]).input);
  onThemeChange(() => last && plot(last));
  narrow.addEventListener("change", () => {
    place();
    if (last) plot(last);
  });
} catch (error) {
  if (found) alarm(error.message);
  $("blocked").textContent = `Nothing can be tried: ${error.message}`;
  $("blocked").hidden = false;
}
$("waiting").hidden = true;
