// Shows the rows that hold every word and are of the chosen kind.
(() => {
  "use strict";
  const words = document.getElementById("words");
  const kind = document.getElementById("kind");
  const shown = document.getElementById("shown");
  const rows = Array.from(document.getElementById("rows").rows, (row) => [row, row.textContent.toLowerCase()]);
  function sift() {
    const wanted = words.value.toLowerCase().split(/\s+/).filter(Boolean);
    let count = 0;
    for (const [row, text] of rows) {
      row.hidden = !((!kind.value || row.dataset.kind === kind.value) && wanted.every((word) => text.includes(word)));
      count += row.hidden ? 0 : 1;
    }
    shown.textContent = count === rows.length ? "" : `${count} of ${rows.length}`;
  }
  document.getElementById("filter").hidden = false;
  document.getElementById("filter").addEventListener("submit", (event) => event.preventDefault());
  words.addEventListener("input", sift);
  kind.addEventListener("change", sift);
  sift(); // a browser that goes back keeps what was typed
})();
