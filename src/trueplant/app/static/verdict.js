// The matrix by mouse and keyboard; an element that is opened is asked for, and its figures are drawn.

import { api, data } from "./app.js";
import { clear, put } from "./figures.js";

const { result } = data() ?? {};
const matrix = document.getElementById("matrix");
const panel = document.getElementById("element");
const cells = matrix ? [...matrix.querySelectorAll("tbody tr")].map((row) => [...row.querySelectorAll("td")]) : [];
const buttons = matrix ? [...matrix.querySelectorAll("button")] : [];
let opened = null; // the button whose element is shown
let asked = 0;

const keyOf = (button) => `${button.dataset.input}→${button.dataset.output}`;

function focusable(button) {
  for (const one of buttons) one.tabIndex = one === button ? 0 : -1;
}

function close() {
  if (!opened) return;
  opened.setAttribute("aria-expanded", "false");
  clear(panel);
  panel.replaceChildren();
  panel.hidden = true;
  history.replaceState(null, "", location.pathname + location.search);
  const back = opened;
  opened = null;
  back.focus();
}

async function open(button, move = true) {
  const turn = ++asked;
  const query = new URLSearchParams({ output: button.dataset.output, input: button.dataset.input });
  if (result) query.set("result", result);
  panel.setAttribute("aria-busy", "true");
  let found;
  try {
    found = await api(`/api/verdict/element?${query}`);
  } catch {
    return; // the message is shown
  } finally {
    panel.removeAttribute("aria-busy");
  }
  if (turn !== asked) return;
  opened?.setAttribute("aria-expanded", "false");
  opened = button;
  button.setAttribute("aria-expanded", "true");
  focusable(button);
  clear(panel);
  panel.innerHTML = found.html;
  panel.hidden = false;
  put(found.figures);
  panel.querySelector(".back").addEventListener("click", close);
  history.replaceState(null, "", `#${encodeURIComponent(keyOf(button))}`);
  if (move) {
    panel.querySelector("h2").focus({ preventScroll: true });
    panel.scrollIntoView({ block: "start" });
  }
}

/** The next cell with an element from row i, column j in a direction. */
function next(i, j, down, right) {
  for (let y = i + down, x = j + right; cells[y]?.[x]; y += down, x += right) {
    const button = cells[y][x].querySelector("button");
    if (button) return button;
  }
  return null;
}

function moved(button, key) {
  const i = cells.findIndex((row) => row.includes(button.closest("td")));
  const j = cells[i].indexOf(button.closest("td"));
  const steps = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };
  if (steps[key]) return next(i, j, ...steps[key]);
  if (key === "Home") return next(i, -1, 0, 1);
  if (key === "End") return next(i, cells[i].length, 0, -1);
  return null;
}

if (buttons.length) {
  focusable(buttons[0]);
  matrix.addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (!button) return;
    if (button === opened) close();
    else open(button);
  });
  matrix.addEventListener("keydown", (event) => {
    const button = event.target.closest("button");
    if (!button || event.altKey || event.ctrlKey || event.metaKey) return;
    const to = moved(button, event.key);
    if (to || /^(Arrow|Home|End)/.test(event.key)) event.preventDefault();
    if (to) {
      focusable(to);
      to.focus();
    }
  });
  addEventListener("keydown", (event) => event.key === "Escape" && !event.defaultPrevented && close());
  const wanted = decodeURIComponent(location.hash.slice(1));
  const first = buttons.find((button) => keyOf(button) === wanted);
  if (first) open(first, false);
}
