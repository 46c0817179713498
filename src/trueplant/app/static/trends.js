// Trends: SP and PV above OP for each loop, one zoom over all. The app sends what the screen can show, as doubles.

import { address, alarm, api, color, data, onThemeChange, say, shownVersion } from "./app.js";
import { checkedParts, lit, windowsTable } from "./checked.js";
import { LABELS, clockOf } from "./clock.js";
import { ask, calmly, el, loopTitle } from "./dom.js";

const $ = (id) => document.getElementById(id);
const given = data();
const uPlot = window.uPlot;
const POINTS = 1500;

let record = null; // what the app says of the record
let time = null; // and of its times
let view = null; // what is shown, in the record's time
let picked = null; // [from, to] in the record's time
let answer = null; // of the check
let plots = [];
let labels = 0; // width of the widest label of a vertical axis

const number = () => $("record")?.value ?? "0";
const busy = (text) => ($("about").textContent = text);

// -- plots ------------------------------------------------------------------------------------------------------------

const short = (v) => (v === null || v === undefined ? "–" : Number(v.toPrecision(5)).toString());

/** The axis of values is as wide as the widest of its labels, on all plots. */
function axisSize(u, values) {
  if (!values) return Math.max(labels, 50);
  u.ctx.font = "12px system-ui, sans-serif";
  const widest = Math.max(...values.map((text) => u.ctx.measureText(text ?? "").width / devicePixelRatio * 1));
  const wanted = Math.ceil(widest) + 22;
  if (wanted > labels) {
    labels = wanted;
    queueMicrotask(() => plots.forEach(({ u: other }) => other.redraw(false, true)));
  }
  return Math.max(labels, 50);
}

function bands(u, own) {
  const { ctx, bbox } = u;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  const fill = (from, to, paint, height = bbox.height) => {
    const a = u.valToPos(time.toX(from), "x", true);
    const b = Math.max(u.valToPos(time.toX(to), "x", true), a + devicePixelRatio);
    if (b < bbox.left || a > bbox.left + bbox.width) return;
    ctx.fillStyle = paint;
    ctx.fillRect(a, bbox.top, b - a, height);
  };
  for (const one of record.exclusions) fill(one.from, one.to, color("excluded"));
  for (const row of answer?.struck ?? []) {
    if (own.includes(row.signal)) for (const [from, to] of row.spans) fill(from, to, color("points"), 5 * devicePixelRatio);
  }
  if (picked) {
    const paint = color("plant");
    ctx.globalAlpha = 0.25;
    fill(picked[0], picked[1], paint);
    ctx.globalAlpha = 1;
  }
  ctx.restore();
}

function plot(place, loop, lines, height, own, last) {
  const grid = () => color("grid");
  const ink = () => color("ink");
  const font = "12px system-ui, sans-serif";
  const options = {
    width: place.clientWidth || 600,
    height,
    padding: [8, 12, 0, 0],
    tzDate: (x) => uPlot.tzDate(new Date((x + time.offset(x)) * 1000), "Etc/UTC"),
    cursor: { sync: { key: "trends", setSeries: false }, drag: { x: true, y: false, setScale: false, dist: 4 }, y: false, points: { size: 6 } },
    scales: { x: { time: time.stamped }, y: { range: (u, low, high) => room(low, high) } },
    axes: [
      { stroke: ink, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1 }, font,
        ...(time.stamped ? { values: LABELS, space: 70 } : { size: 30, values: (u, splits) => splits.map((x) => x.toLocaleString("en", { maximumSignificantDigits: 9 })) }) },
      { stroke: ink, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1 }, font, size: axisSize, space: 28,
        values: (u, splits) => splits.map((v) => Number(v.toPrecision(6)).toString()) },
    ],
    series: [
      { label: "Time", value: (u, x) => (x === null ? "–" : time.stamped ? time.clock(x) : `${short(x)} ${record.unit}`) },
      ...lines.map(({ label, role, unit }) => ({
        label: unit ? `${label} (${unit})` : label, scale: "y", stroke: () => color(role), width: role === "setpoint" ? 1.8 : 1.3,
        dash: role === "setpoint" ? [7, 4] : undefined, points: { show: false },
        value: (u, v) => short(v),
      })),
    ],
    hooks: { drawClear: [(u) => bands(u, own)], setSelect: [(u) => dragged(u)] },
  };
  const u = new uPlot(options, [[], ...lines.map(() => [])], place);
  plots.push({ u, place, keys: lines.map((line) => line.key) });
  place.addEventListener("keydown", keyed);
  place.addEventListener("dblclick", () => show(record.first, record.last));
}

/** The values and a little more on both sides; of a constant a little on both sides, too. */
function room(low, high) {
  if (low === null || low === undefined || !Number.isFinite(low)) return [0, 1];
  const width = high - low || Math.abs(low) * 0.05 || 1;
  return [low - 0.06 * width, high + 0.06 * width];
}

function dragged(u) {
  const { left, width } = u.select;
  if (width < 3) return;
  const from = Math.max(time.toT(u.posToVal(left, "x")), record.first);
  const to = Math.min(time.toT(u.posToVal(left + width, "x")), record.last);
  for (const { u: one } of plots) one.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
  if (to <= from) return;
  if (document.querySelector('input[name="drag"]:checked').value === "zoom") show(from, to);
  else {
    pick([time.near(from), time.near(to)]);
    document.querySelector("#stretch button[type=submit]").focus({ preventScroll: true });
  }
}

function keyed(event) {
  const width = view[1] - view[0];
  const step = {
    ArrowLeft: () => show(view[0] - width / 5, view[1] - width / 5),
    ArrowRight: () => show(view[0] + width / 5, view[1] + width / 5),
    "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), 0: () => show(record.first, record.last), Home: () => show(record.first, record.last),
  }[event.key];
  if (!step || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  step();
}

function zoom(times) {
  const middle = (view[0] + view[1]) / 2;
  const half = ((view[1] - view[0]) * times) / 2;
  show(middle - half, middle + half);
}

let latest = 0;

/** Ask for a stretch and draw it on all plots. */
async function show(from, to) {
  const whole = record.last - record.first;
  const width = Math.min(Math.max(to - from, 4 * record.step), whole);
  const start = Math.min(Math.max(from, record.first), record.last - width);
  view = [start, start + width];
  const mine = ++latest;
  const wide = Math.max(...plots.map(({ place }) => place.clientWidth), 300);
  const query = { record: number(), from: view[0], to: view[1], points: Math.min(POINTS, Math.ceil(wide)) };
  let buffer;
  try {
    const reply = await fetch(address("/api/trends/view", query));
    if (!reply.ok) throw new Error((await reply.json()).error);
    buffer = await reply.arrayBuffer();
  } catch (error) {
    if (mine === latest) alarm(error.message);
    return;
  }
  if (mine !== latest) return;
  const every = new Float64Array(buffer);
  const n = every.length / (record.signals.length + 1);
  const x = Array.from(every.subarray(0, n), time.toX);
  const of = new Map(record.signals.map((name, k) => [name, gaps(every.subarray((k + 1) * n, (k + 2) * n))]));
  const range = { min: time.toX(view[0]), max: time.toX(view[1]) };
  for (const { u, keys } of plots) {
    u.batch(() => {
      u.setData([x, ...keys.map((key) => of.get(key) ?? x.map(() => null))], false);
      u.setScale("x", range);
    });
  }
  numbers(of);
  document.body.dataset.shown = String(mine);
}

const gaps = (values) => Array.from(values, (v) => (Number.isNaN(v) ? null : v));

/** What is drawn as a table: the lowest and the highest value of each signal. */
function numbers(of) {
  for (const loop of document.querySelectorAll(".loop")) {
    const rows = JSON.parse(loop.dataset.signals).map(([key, label, unit]) => {
      const known = (of.get(key) ?? []).filter((v) => v !== null);
      const cells = known.length ? [known.reduce((a, b) => Math.min(a, b)), known.reduce((a, b) => Math.max(a, b))] : [null, null];
      return el("tr", {}, el("th", { scope: "row" }, `${label}${unit ? ` (${unit})` : ""}`), cells.map((v) => el("td", { class: "n" }, short(v))));
    });
    loop.querySelector(".numbers tbody").replaceChildren(...rows);
    loop.querySelector(".numbers caption").textContent = `From ${time.written(time.near(view[0]))} to ${time.written(time.near(view[1]))}`;
  }
}

function build() {
  for (const { u } of plots) u.destroy();
  plots = [];
  labels = 0;
  const there = [];
  given.loops.forEach((loop, k) => {
    const upper = [];
    if (loop.output) upper.push({ key: `pv ${loop.output}`, label: "PV", role: "measured", unit: loop.unit });
    if (loop.sp) upper.push({ key: `sp ${loop.output}`, label: "SP", role: "setpoint", unit: loop.unit });
    const lower = loop.input ? [{ key: `op ${loop.input}`, label: "OP", role: "plant", unit: loop.input_unit }] : [];
    const title = loopTitle(loop.output, loop.input);
    const place = (name) => el("div", { class: "plot", tabindex: "0", role: "group", "aria-label": `${name} of ${title} over time; arrow keys move, plus and minus zoom` });
    const [above, below] = [upper.length ? place("PV and set-point") : null, lower.length ? place("OP") : null];
    const signals = [...upper, ...lower].map(({ key, label, unit }) => [key, label, unit]);
    there.push(
      el("section", { class: "loop", "aria-label": `Loop ${title}`, "data-signals": JSON.stringify(signals), "data-output": loop.output },
        el("header", {}, el("h2", {}, title), el("span", { class: "light", id: `light-${k}` })),
        el("p", { class: "told", id: `told-${k}` }), above, below,
        el("details", {}, el("summary", {}, "Numbers of what is shown"),
          el("div", { class: "scroll" }, el("table", { class: "numbers" }, el("caption"),
            el("thead", {}, el("tr", {}, el("td"), ["lowest", "highest"].map((name) => el("th", { scope: "col", class: "n" }, name)))), el("tbody"))))));
    queueMicrotask(() => {
      const own = [loop.output, "all"];
      if (above) plot(above, loop, upper, 230, own);
      if (below) plot(below, loop, lower, 150, [loop.input, "all"]);
    });
  });
  $("loops").replaceChildren(...there);
}

// -- a stretch --------------------------------------------------------------------------------------------------------

const redraw = () => plots.forEach(({ u }) => u.redraw(false, false));

function pick(stretch) {
  picked = stretch;
  $("from").value = stretch ? time.written(stretch[0]) : "";
  $("to").value = stretch ? time.written(stretch[1]) : "";
  redraw();
}

async function typed() {
  const [from, to] = [$("from").value.trim(), $("to").value.trim()];
  if (!from || !to) return null;
  if (picked && from === time.written(picked[0]) && to === time.written(picked[1])) return picked;
  const ends = [];
  for (const [id, text] of [["from", from], ["to", to]]) {
    try {
      ends.push((await api(address("/api/trends/time", { record: number(), text }).href)).time);
      $(id).removeAttribute("aria-invalid");
    } catch {
      $(id).setAttribute("aria-invalid", "true");
      return null;
    }
  }
  picked = ends;
  redraw();
  return ends;
}

for (const [id, place] of [["from", 0], ["to", 1]]) {
  $(id).addEventListener("change", typed);
  $(id).addEventListener("keydown", async (event) => {
    const steps = { ArrowUp: 1, ArrowDown: -1, PageUp: 0, PageDown: 0 };
    if (!(event.key in steps)) return;
    event.preventDefault();
    if (!picked) {
      const [from, to] = view;
      pick([time.near(from + 0.4 * (to - from)), time.near(from + 0.6 * (to - from))]);
      return;
    }
    const page = Math.max(Math.round((view[1] - view[0]) / 50 / record.step), 1) * record.step;
    const by = event.key.startsWith("Page") ? (event.key === "PageUp" ? page : -page) : steps[event.key] * record.step;
    const ends = [...picked];
    ends[place] = Math.min(Math.max(ends[place] + by, record.first), record.last);
    if (ends[0] <= ends[1]) pick(ends);
  });
}

$("stretch").addEventListener("submit", async (event) => {
  event.preventDefault();
  const ends = await typed();
  if (!ends) {
    say("Say from when and to when, or pick a stretch by dragging.");
    return;
  }
  try {
    const done = await api("/api/trends/exclude", { record: number(), from: ends[0], to: ends[1], version: shownVersion() });
    pick(null);
    say(`${done.excluded} is left out.`);
    await anew();
  } catch {
    // it was said
  }
});
$("none").addEventListener("click", () => pick(null));
$("look").addEventListener("click", async () => {
  const ends = await typed();
  if (ends) around(ends[0], ends[1]);
});

function around(from, to) {
  const margin = Math.max((to - from) * 0.5, 40 * record.step);
  show(from - margin, to + margin);
}

$("in").addEventListener("click", () => zoom(0.5));
$("outward").addEventListener("click", () => zoom(2));
$("left").addEventListener("click", () => keyed(new KeyboardEvent("keydown", { key: "ArrowLeft" })));
$("right").addEventListener("click", () => keyed(new KeyboardEvent("keydown", { key: "ArrowRight" })));
$("all").addEventListener("click", () => show(record.first, record.last));
$("record")?.addEventListener("change", begin);

// -- what is left out, and why ----------------------------------------------------------------------------------------

const go = (from, to, text) => el("button", { type: "button", class: "go", onclick: () => around(from, to) }, text);

function excluded() {
  $("excluded").replaceChildren(
    ...(record.exclusions.length
      ? record.exclusions.map((one) =>
          el("li", {}, el("span", { class: "when" }, go(one.from, one.to, one.text)),
            el("button", { type: "button", "aria-label": `Use ${one.text} again`, onclick: () => changed("/api/trends/include", { place: one.place }, "It is used again.") }, "Use it again")))
      : [el("li", { class: "quiet" }, "Nothing. Pick a stretch above to leave it out.")]));
}

async function changed(path, body, said) {
  try {
    await api(path, { ...body, version: shownVersion() });
    say(said);
    await anew();
  } catch {
    // it was said
  }
}

/** After a change of the project: the record as it is used now, and the check once more. */
async function anew() {
  const shown = view;
  await load();
  await show(...shown);
  await check();
}

// -- the check, and windows -------------------------------------------------------------------------------------------

let asking = 0;

/** Ask, and tell how far it is until there is an answer; null where it was given up. */
async function question(kind, place, still) {
  await api(address("/api/trends/ask", { record: number() }).href, { kind });
  for (;;) {
    const found = await api(address("/api/trends/answer", { record: number(), kind }).href, undefined, undefined, { quiet: true });
    if (!still()) return null;
    if (found.state === "running") {
      place.textContent = `${found.stage} … ${found.seconds.toFixed(0)} s`;
      await new Promise((resolve) => setTimeout(resolve, 150));
      continue;
    }
    place.textContent = "";
    return found;
  }
}

async function check() {
  const mine = ++asking;
  let found;
  try {
    found = await question("check", $("checking"), () => mine === asking);
  } catch (error) {
    if (mine === asking) $("checking").textContent = error.message;
    return;
  }
  if (!found || mine !== asking) return;
  if (found.state !== "done") {
    const why = found.error ? `The data cannot be used as they are: ${found.error}` : "The check was given up for another question.";
    $("checking").replaceChildren(why, " ", el("button", { type: "button", onclick: check }, "Check again"));
    return;
  }
  answer = found;
  tell();
  await show(...view); // what was struck is a gap now
  document.body.dataset.checked = String(mine);
}

function tell() {
  given.loops.forEach((loop, k) => lit($(`light-${k}`), $(`told-${k}`), answer.lights[loop.output]));
  const overrule = ({ signal, reason }) => changed("/api/trends/overrule", { signal, reason }, "They are used again.");
  $("checked").replaceChildren(...checkedParts(answer, go, overrule));
  redraw();
}

let finding = 0;
$("find").addEventListener("click", async () => {
  const mine = ++finding;
  $("find").disabled = true;
  $("stop").hidden = false;
  try {
    const found = await question("find", $("finding"), () => mine === finding);
    if (found) windows(found);
  } catch {
    // it was said
  } finally {
    if (mine === finding) {
      $("find").disabled = false;
      $("stop").hidden = true;
      if (!answer) check(); // which was given up for this
    }
  }
});
$("stop").addEventListener("click", () => api("/api/trends/cancel", {}).catch(() => {}));

function windows(found) {
  if (found.state !== "done") {
    $("finding").textContent = found.state === "cancelled" ? "Given up." : (found.error ?? "");
    return;
  }
  if (!found.usable.length) {
    $("found").replaceChildren(el("p", { class: "message" }, found.usable_elsewhere ? "None in this record; see the others." : found.reasons[0] ?? found.headline));
    return;
  }
  $("found").replaceChildren(windowsTable(found.usable, go),
    el("p", {}, el("button", { type: "button", id: "write", onclick: write }, "Leave out all else"), el("span", { class: "quiet" }, " written into the project; can be undone")));
}

async function write() {
  if (!(await ask("Leave out everything but these windows? It is written into the project, and can be undone.", "Leave it out"))) return;
  await changed("/api/trends/write", {}, "All but the windows is left out.");
}

// -- from the beginning -----------------------------------------------------------------------------------------------

async function load() {
  record = await api(address("/api/trends/record", { record: number() }).href, undefined, undefined, { quiet: true });
  time = clockOf(record);
  busy(`${record.samples.toLocaleString("en")} samples, ${record.span}`);
  excluded();
}

async function begin() {
  answer = null;
  busy("Reading the record …");
  try {
    await load();
  } catch (error) {
    busy("");
    $("problem").textContent = error.message;
    $("problem").hidden = false;
    return;
  }
  $("tools").hidden = false;
  build();
  await new Promise((resolve) => setTimeout(resolve));
  await show(record.first, record.last);
  await check();
}

onThemeChange(() => redraw());
new ResizeObserver(calmly(() => {
  for (const { u, place } of plots) u.setSize({ width: place.clientWidth, height: u.height });
}, 100)).observe($("loops"));
begin();
