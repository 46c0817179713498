// Unpacks plotly and the figures of this file, and draws them in the colours of the screen or of paper.
(async () => {
  "use strict";
  if (!("DecompressionStream" in window)) {
    document.getElementById("old-browser").hidden = false;
    return;
  }
  // Base 85: five letters for four bytes, none that HTML would read.
  const letters = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%/()*+-;,=.?@^_:{|}~";
  function bytesOf(text) {
    const digit = new Uint8Array(128);
    for (let k = 0; k < letters.length; k++) digit[letters.charCodeAt(k)] = k;
    const missing = (5 - (text.length % 5)) % 5;
    const whole = text + "~".repeat(missing);
    const found = new DataView(new ArrayBuffer((whole.length / 5) * 4));
    for (let k = 0; k < whole.length; k += 5) {
      let word = 0;
      for (let m = k; m < k + 5; m++) word = word * 85 + digit[whole.charCodeAt(m)];
      found.setUint32((k / 5) * 4, word);
    }
    return new Uint8Array(found.buffer, 0, found.byteLength - missing);
  }
  async function unpacked(id) {
    const bytes = bytesOf(document.getElementById(id).textContent);
    return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  }
  // The page's policy knows plotly by its hash.
  const library = document.createElement("script");
  library.textContent = await unpacked("plotly");
  document.head.append(library);
  const book = JSON.parse(await unpacked("book"));
  const plots = Array.from(document.querySelectorAll(".plot"));
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const touch = window.matchMedia("(pointer: coarse)").matches;
  // The buttons are named one by one: plotly's own choice has one that sends the figure to a server.
  const config = {
    displaylogo: false,
    responsive: true,
    displayModeBar: touch ? false : "hover",
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]],
    plotlyServerURL: "",
  };
  let printing = false;

  const palette = () => book.palettes[dark.matches && !printing ? "dark" : "light"];

  function trace(given, colors) {
    const color = colors[given.meta.role];
    const drawn = { ...given };
    if (given.fillcolor) {
      drawn.fillcolor = color;
    } else if (given.line) {
      drawn.line = { ...given.line, color };
    }
    if (given.marker) drawn.marker = { ...given.marker, color };
    if (given.error_y) drawn.error_y = { ...given.error_y, color };
    return drawn;
  }

  function layout(given, colors, box) {
    const drawn = structuredClone(given);
    drawn.font.color = colors.ink;
    drawn.uirevision = box.id; // a zoom survives a change of colours
    for (const [key, axis] of Object.entries(drawn)) {
      if (/^[xy]axis\d*$/.test(key)) {
        axis.gridcolor = colors.grid;
        axis.linecolor = axis.tickcolor = colors.axis;
      }
    }
    for (const shape of drawn.shapes || []) shape.fillcolor = colors[shape.name];
    drawn.hoverlabel = { ...drawn.hoverlabel, bgcolor: colors.paper, bordercolor: colors.axis, font: { color: colors.ink } };
    drawn.modebar = { bgcolor: "rgba(0,0,0,0)", color: colors.axis, activecolor: colors.ink };
    // A finger that drags should scroll the page.
    drawn.dragmode = touch ? false : "zoom";
    if (printing) Object.assign(drawn, { autosize: false, width: box.clientWidth, height: box.clientHeight });
    return drawn;
  }

  function draw(box) {
    const { data, layout: given } = book.figures[box.id];
    const colors = palette();
    box.dataset.drawn = "yes";
    return Plotly.react(box, data.map((one) => trace(one, colors)), layout(given, colors, box), config);
  }

  const redraw = () => plots.filter((box) => box.dataset.drawn).forEach(draw);
  dark.addEventListener("change", redraw);

  // What is in view is drawn first, the rest when the browser has time.
  const watcher = new IntersectionObserver(
    (seen) => seen.filter((one) => one.isIntersecting).forEach((one) => {
      watcher.unobserve(one.target);
      if (!one.target.dataset.drawn) draw(one.target);
    }),
    { rootMargin: "400px" },
  );
  plots.forEach((box) => watcher.observe(box));
  const later = window.requestIdleCallback || ((work) => window.setTimeout(work, 50));
  const waiting = plots.slice();
  function next() {
    const box = waiting.shift();
    if (!box) return;
    if (!box.dataset.drawn) draw(box);
    later(next);
  }
  later(next);

  let opened = [];
  window.addEventListener("beforeprint", () => {
    printing = true;
    document.documentElement.classList.add("printing");
    // a long list stays closed on paper: it would be pages, and its summary says how long it is
    opened = Array.from(document.querySelectorAll("details:not([open], .long)"));
    opened.forEach((one) => { one.open = true; });
    plots.forEach(draw);
  });
  window.addEventListener("afterprint", () => {
    printing = false;
    document.documentElement.classList.remove("printing");
    opened.forEach((one) => { one.open = false; });
    plots.forEach(draw);
  });
})();
