// What the check and the search for windows say, as parts of the page.

import { el } from "./dom.js";

const scroll = (label, ...children) => el("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": label }, ...children);
const heads = (names, right) => el("thead", {}, el("tr", {}, names.map((name) => el("th", { scope: "col", class: name === right ? "n" : null }, name))));

/** The light of a loop: a symbol and words, and below them what it rests on. */
export function lit(place, below, light) {
  if (!light) return;
  place.className = `light badge ${light.look}`;
  place.replaceChildren(el("span", { class: "symbol", "aria-hidden": "true" }, light.symbol), light.words);
  below.textContent = light.told;
}

/** What is said of a record, and what was struck; `go` makes a button that shows a stretch, `overrule` uses a row again. */
export function checkedParts(answer, go, overrule) {
  const shares = Object.entries(answer.shares).map(([name, share]) => `${name} ${(100 * share).toFixed(0)} %`);
  return [
    el("p", { class: answer.refused ? "message" : "" }, answer.headline),
    shares.length ? el("p", {}, `Of PV can be used: ${shares.join(", ")}.`) : null,
    answer.reasons.length ? el("ul", {}, answer.reasons.map((text) => el("li", {}, text))) : null,
    el("h3", {}, "Struck out"),
    answer.struck.length ? struck(answer.struck, go, overrule) : el("p", { class: "quiet" }, "Nothing but what you left out."),
    answer.noticed.length
      ? el("details", {}, el("summary", {}, `What else was noticed (${answer.noticed.length})`), el("ul", {}, answer.noticed.map((text) => el("li", {}, text))))
      : null,
  ].filter(Boolean);
}

function struck(rows, go, overrule) {
  const row = (one) =>
    el("tr", { class: "struck-row" }, el("th", { scope: "row" }, one.signal), el("td", {}, one.words),
      el("td", { class: "n" }, one.samples.toLocaleString("en")), el("td", {}, one.message, one.spans.length ? places(one, go) : null),
      el("td", {}, one.overrule
        ? el("button", { type: "button", onclick: () => overrule(one) }, one.overrule)
        : el("span", { class: "quiet" }, one.never)));
  return scroll("Struck out", el("table", {}, heads(["Signal", "Reason", "Samples", "Where", "Overrule"], "Samples"), el("tbody", {}, rows.map(row))));
}

function places(row, go) {
  const list = el("ul", { class: "places" }, row.spans.map(([from, to, text]) => el("li", {}, go(from, to, text))));
  if (row.spans.length < 3) return list;
  const more = row.count > row.spans.length ? `, the first ${row.spans.length}` : "";
  return el("details", {}, el("summary", {}, `${row.count.toLocaleString("en")} stretches${more}`), list);
}

/** The windows, the most worth first. */
export function windowsTable(usable, go) {
  const gains = (one) => {
    const told = one.gains.filter((gain) => gain.percent !== null).map((gain) => `${gain.element} ±${Number(gain.percent.toPrecision(2))} %`);
    const left = one.gains.length - told.length;
    return [...told, ...(left ? [`${left} other${left > 1 ? "s" : ""} hardly`] : [])].join(", ");
  };
  const row = (one, k) =>
    el("tr", {}, el("td", {}, String(k + 1)), el("td", {}, go(one.from, one.to, one.text)), el("td", { class: "n" }, String(one.moves)),
      el("td", {}, one.moved.join(", ")), el("td", {}, gains(one)));
  return scroll("Windows", el("table", {}, el("caption", {}, "Ranked by what each adds to those above it; standard errors are foretold."),
    heads(["", "Stretch", "Moves", "Of", "Gains known alone to"], "Moves"), el("tbody", {}, usable.map(row))));
}
