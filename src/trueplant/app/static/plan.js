// Each plan's moves and what they will do, drawn; limits saved, and held against what the moves reach as they are typed.

import { api, color, data, onThemeChange, say, shownVersion } from "./app.js";

const { time_unit: unit } = data();
const page = Math.random().toString(36).slice(2);
const result = new URLSearchParams(location.search).get("result");
const path = (verb) => `/api/plan/${verb}${result ? `?result=${encodeURIComponent(result)}` : ""}`;
const HIGH = 170; // pixels of a signal
const found = new Map(); // number of a plan: what came back
const form = document.getElementById("limits");

const number = (value) => String(Number(value.toPrecision(4)));
const spoken = (name) => name.replaceAll("_", " ");
const element = (name, properties = {}, ...inside) => {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...inside);
  return made;
};

/** The limits as they stand in the form: by "PV" or "OP" and name. */
function typed() {
  const limits = new Map();
  for (const row of form.querySelectorAll("tr[data-name]")) {
    const [low, high] = ["low", "high"].map((name) => row.querySelector(`[name=${name}]`).value);
    limits.set(`${row.dataset.is} ${row.dataset.name}`, [low, high].map((one) => (one === "" ? null : Number(one))));
  }
  return limits;
}

function draw(k) {
  const got = found.get(k);
  const place = document.getElementById(`figure-${k}`);
  const [ink, grid, axis] = ["ink", "grid", "axis"].map(color);
  const count = got.signals.length;
  const height = count * HIGH + 40;
  const layout = { height, margin: { l: 62, r: 12, t: 22, b: 40 }, showlegend: false, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink, size: 12, family: "system-ui, sans-serif" }, annotations: [], shapes: [], dragmode: false, hovermode: "x", xaxis: { gridcolor: grid, linecolor: axis, zeroline: false, anchor: count > 1 ? `y${count}` : "y", title: { text: `time from the first move (${unit})`, standoff: 6 } } };
  const traces = [];
  const limits = typed();
  got.signals.forEach((signal, n) => {
    const name = n ? String(n + 1) : "";
    const top = 1 - n / count - 0.035;
    const bottom = 1 - (n + 1) / count + 0.035;
    const common = { x: got.t, xaxis: "x", yaxis: `y${name}`, mode: "lines" };
    traces.push({ ...common, y: signal.band.low, line: { width: 0 }, hoverinfo: "skip" });
    traces.push({ ...common, y: signal.band.high, line: { width: 0 }, fill: "tonexty", fillcolor: color("after-band"), hoverinfo: "skip" });
    traces.push({ ...common, y: signal.band.middle, name: signal.is, line: { color: color("after"), width: 2 } });
    if (signal.moved) traces.push({ ...common, y: signal.moved, name: signal.is === "PV" ? "SP" : "OP", line: { color: color("setpoint"), width: 1.8, dash: "dash", shape: "hv" } });
    const [low, high] = [Math.min(signal.far[0], ...(signal.moved ?? [])), Math.max(signal.far[1], ...(signal.moved ?? []))];
    const room = high - low || 1;
    const shown = limits.get(`${signal.is} ${signal.name}`) ?? [null, null];
    const near = shown.filter((limit) => limit !== null && limit > low - room && limit < high + room);
    const range = [Math.min(low, ...near) - 0.08 * room, Math.max(high, ...near) + 0.08 * room];
    for (const limit of near) layout.shapes.push({ type: "line", xref: "x domain", yref: `y${name}`, x0: 0, x1: 1, y0: limit, y1: limit, line: { color: color("limit"), dash: "dot", width: 1.4 } });
    layout[`yaxis${name}`] = { domain: [bottom, top], anchor: "x", gridcolor: grid, linecolor: axis, zeroline: false, range };
    layout.annotations.push({ text: `${signal.is} of ${spoken(signal.name)}${signal.unit ? ` (${signal.unit})` : ""}`, xref: "paper", yref: "paper", x: 0, y: top, xanchor: "left", yanchor: "bottom", showarrow: false, font: { size: 12, color: ink } });
  });
  place.style.height = `${height}px`;
  Plotly.react(place, traces, layout, { displayModeBar: false, responsive: true });
}

function reach(k) {
  const limits = typed();
  document.getElementById(`reach-${k}`).tBodies[0].replaceChildren(
    ...found.get(k).signals.map((signal) => {
      const [low, high] = signal.far;
      const [least, most] = limits.get(`${signal.is} ${signal.name}`) ?? [null, null];
      const beyond = (least !== null && low < least) || (most !== null && high > most);
      const words = least === null && most === null ? "no limits" : beyond ? `beyond its limits (${least ?? "none"} to ${most ?? "none"})` : `within ${least ?? "none"} to ${most ?? "none"}`;
      return element("tr", {}, element("th", { scope: "row", textContent: `${signal.is} of ${spoken(signal.name)}` }), element("td", { className: "n", textContent: `${number(low)} ${signal.unit}` }), element("td", { className: "n", textContent: `${number(high)} ${signal.unit}` }), element("td", { className: beyond ? "over" : "", textContent: words }));
    }),
  );
}

for (const part of document.querySelectorAll(".plan[data-drawn]")) {
  const k = Number(part.dataset.plan);
  api(path("excursion"), { plan: k, page }, "POST", { quiet: true })
    .then((got) => {
      found.set(k, got);
      draw(k);
      reach(k);
      part.dataset.drawn = "yes";
    })
    .catch((error) => {
      document.getElementById(`reach-${k}`).tBodies[0].replaceChildren(element("tr", {}, element("td", { colSpan: 4, textContent: `It cannot be tried out: ${error.message}` })));
      part.dataset.drawn = "no";
    });
}
onThemeChange(() => [...found.keys()].forEach(draw));

form.addEventListener("input", (event) => {
  const row = event.target.closest("tr[data-name]");
  if (row) {
    const [low, high] = ["low", "high"].map((name) => row.querySelector(`[name=${name}]`));
    const wrong = (low.value === "") !== (high.value === "") || (low.value !== "" && Number(low.value) >= Number(high.value));
    for (const one of [low, high]) one.setAttribute("aria-invalid", wrong);
  }
  for (const k of found.keys()) {
    reach(k);
    draw(k);
  }
});
form.addEventListener("submit", async (event) => {
  event.preventDefault();
  const limits = [...form.querySelectorAll("tr[data-name]")].map((row) => {
    const [low, high] = ["low", "high"].map((name) => row.querySelector(`[name=${name}]`).value);
    return { table: row.dataset.table, name: row.dataset.name, low: low === "" ? null : Number(low), high: high === "" ? null : Number(high) };
  });
  const longest = document.getElementById("longest").value;
  await api("/api/plan/limits", { limits, longest: longest === "" ? null : Number(longest), version: shownVersion() });
  say("Limits saved. Run again to plan within them.");
});
