// Shows the rows that hold every word and are of the chosen kind; the choice stays in the address.

const $ = (id) => document.getElementById(id);
const [form, words, kind, shown] = ["filter", "words", "kind", "shown"].map($);
const rows = [...$("rows").rows].map((row) => [row, row.textContent.toLowerCase()]);

function sift() {
  const wanted = words.value.toLowerCase().split(/\s+/).filter(Boolean);
  let count = 0;
  for (const [row, text] of rows) {
    row.hidden = !((!kind.value || row.dataset.kind === kind.value) && wanted.every((word) => text.includes(word)));
    count += row.hidden ? 0 : 1;
  }
  shown.textContent = count === rows.length ? "" : `${count} of ${rows.length} loops`;
}

form.hidden = false;
form.addEventListener("submit", (event) => event.preventDefault());
words.addEventListener("input", sift);
kind.addEventListener("change", sift);
sift(); // a browser that goes back keeps what was typed
