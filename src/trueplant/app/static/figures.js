// Figures that the server made: drawn with plotly in the colours of the screen, when they come into view.

import { color, onThemeChange } from "./app.js";

const touch = matchMedia("(pointer: coarse)").matches;
// The buttons are named one by one: plotly's own choice has one that sends the figure to a server.
const config = {
  displaylogo: false,
  responsive: true,
  displayModeBar: touch ? false : "hover",
  modeBarButtons: [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]],
  plotlyServerURL: "",
};
const shown = new Map(); // place on the page: its figure

const of = (role) => color(role.replaceAll("_", "-"));

function trace(given) {
  const own = of(given.meta.role);
  const drawn = { ...given };
  if (given.fillcolor) drawn.fillcolor = own;
  else if (given.line) drawn.line = { ...given.line, color: own };
  if (given.marker) drawn.marker = { ...given.marker, color: own };
  if (given.error_y) drawn.error_y = { ...given.error_y, color: own };
  return drawn;
}

function layout(given, place) {
  const drawn = structuredClone(given);
  const [ink, grid, axis, paper] = ["ink", "grid", "axis", "paper"].map(of);
  drawn.font.color = ink;
  drawn.uirevision = place.id; // a zoom survives a change of colours
  for (const [key, one] of Object.entries(drawn)) {
    if (/^[xy]axis\d*$/.test(key)) {
      one.gridcolor = grid;
      one.linecolor = one.tickcolor = axis;
    }
  }
  for (const shape of drawn.shapes ?? []) shape.fillcolor = of(shape.name);
  drawn.hoverlabel = { ...drawn.hoverlabel, bgcolor: paper, bordercolor: axis, font: { color: ink } };
  drawn.modebar = { bgcolor: "rgba(0,0,0,0)", color: axis, activecolor: ink };
  drawn.dragmode = touch ? false : "zoom"; // a finger that drags should scroll the page
  return drawn;
}

function draw(place) {
  const { data, layout: given } = shown.get(place);
  place.dataset.drawn = "yes";
  return Plotly.react(place, data.map(trace), layout(given, place), config);
}

const watcher = new IntersectionObserver(
  (seen) => seen.filter((one) => one.isIntersecting).forEach((one) => {
    watcher.unobserve(one.target);
    if (shown.has(one.target)) draw(one.target);
  }),
  { rootMargin: "400px" },
);

/** Put figures, by the id of their place, into the page. Plotly must be loaded. */
export function put(figures) {
  for (const [id, figure] of Object.entries(figures)) {
    const place = document.getElementById(id);
    if (!place) continue;
    place.style.height = `${figure.layout.height}px`;
    shown.set(place, figure);
    watcher.observe(place);
  }
}

/** Forget the figures in a part of the page that is about to go. */
export function clear(part) {
  for (const place of [...shown.keys()]) {
    if (!part.contains(place)) continue;
    watcher.unobserve(place);
    if (place.dataset.drawn) Plotly.purge(place);
    shown.delete(place);
  }
}

const redraw = () => shown.forEach((figure, place) => place.dataset.drawn && draw(place));
onThemeChange(redraw);
addEventListener("beforeprint", () => shown.forEach((figure, place) => draw(place)));
