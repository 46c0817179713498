// Elements made in one call, and a question with two answers.

/** An element with attributes (`class`, `for`, `data-...`), properties (`onclick`, `value`, `checked`) and children. */
export function el(name, given = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(given)) {
    if (value === undefined || value === null || value === false) continue;
    if (typeof value === "function") element.addEventListener(key.slice(2), value);
    else if (["value", "checked", "selected", "disabled", "hidden", "textContent"].includes(key)) element[key] = value;
    else element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return element;
}

/** What a loop is called by the names of its output and input, either of which it may lack. */
export const loopTitle = (...names) => names.filter(Boolean).map((name) => name.replaceAll("_", " ")).join(" with ");

/** Ask in a dialog; true where the first of the answers was given. */
export function ask(question, yes, no = "Cancel") {
  return new Promise((resolve) => {
    const dialog = el("dialog", { class: "ask" }, el("p", {}, question));
    const answer = (value) => () => {
      dialog.close();
      dialog.remove();
      resolve(value);
    };
    dialog.append(
      el("p", { class: "answers" },
        el("button", { type: "button", class: "primary", onclick: answer(true) }, yes),
        el("button", { type: "button", onclick: answer(false) }, no)),
    );
    dialog.addEventListener("cancel", answer(false));
    document.body.append(dialog);
    dialog.showModal();
  });
}

/** Call `fn` at most once in so many milliseconds, with the latest arguments. */
export function calmly(fn, milliseconds) {
  let waiting = null;
  return (...args) => {
    clearTimeout(waiting);
    waiting = setTimeout(() => fn(...args), milliseconds);
  };
}

/** A small trend as SVG: pairs of lowest and highest values between 0 and 1, null for a gap. */
export function spark(pairs, label) {
  const space = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(space, "svg");
  const width = Math.max(pairs.length, 2);
  svg.setAttribute("viewBox", `0 0 ${width} 24`);
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("class", "spark");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", label);
  let path = "";
  let pen = "M";
  pairs.forEach((pair, k) => {
    if (pair === null) {
      pen = "M";
      return;
    }
    const [low, high] = k % 2 ? [pair[1], pair[0]] : pair;
    path += `${pen}${k + 0.3} ${(22 - 20 * low).toFixed(2)}L${k + 0.7} ${(22 - 20 * high).toFixed(2)}`;
    pen = "L";
  });
  const line = document.createElementNS(space, "path");
  line.setAttribute("d", path || "M0 12");
  svg.append(line);
  return svg;
}
