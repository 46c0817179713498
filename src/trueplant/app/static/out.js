// Settings in other systems' words, the plant accepted as the model, a bundle made.

import { address, api, data, say } from "./app.js";

const { result } = data() ?? {};
const $ = (id) => document.getElementById(id);
const asked = (path, query = {}) => {
  const place = new URLSearchParams(query);
  if (result) place.set("result", result);
  return `${path}?${place}`;
};

function line(text, kind = "") {
  const found = document.createElement("p");
  found.textContent = text.replaceAll("->", "→");
  if (kind) found.className = kind;
  return found;
}

const vendor = $("vendor");

/** The settings in the form that is chosen; where they cannot be had, none: never those of another form. */
async function showSettings() {
  const [place, chosen] = [$("settings"), vendor.value];
  place.setAttribute("aria-busy", "true");
  let html = "";
  try {
    ({ html } = await api(asked("/api/out/faceplate", { vendor: chosen })));
  } catch {
    // the message is shown
  }
  if (vendor.value !== chosen) return; // the answer to a later choice comes
  place.innerHTML = html;
  place.removeAttribute("aria-busy");
}

vendor?.addEventListener("change", showSettings);
if (vendor?.value) showSettings(); // chosen before the script was there, or kept by the browser over a reload

$("tuning")?.addEventListener("click", async (event) => {
  event.target.disabled = true;
  try {
    await api("/api/out/tuning", {});
    const run = document.createElement("a");
    run.href = address("/run");
    run.textContent = "Run it again.";
    $("tuning-said").replaceChildren("The project asks for new settings now. ", run);
  } catch {
    event.target.disabled = false;
  }
});

// -- accept -----------------------------------------------------------------------------------------------------------

function showAcceptable(found) {
  const place = $("accept-state");
  const ways = $("accept-ways");
  ways.hidden = found.state === "refused";
  $("accept-all").hidden = found.state !== "changed";
  $("accept-force").checked = false;
  $("accept").disabled = found.state === "changed";
  const lines = found.message ? [line(found.message, found.state === "ready" ? "" : "message")] : [];
  if (found.state !== "refused") {
    lines.push(line(`The plant takes the place of the model in ${found.changes.join(", ")}.`));
    if (found.kept.length) lines.push(line(`Kept as they are: ${found.kept.join(", ")}.`));
    for (const doubt of found.doubts) lines.push(line(`${doubt}.`, "message"));
  }
  place.replaceChildren(...lines);
}

async function lookAcceptable() {
  try {
    showAcceptable(await api(asked("/api/out/acceptable"), undefined, "GET", { quiet: true }));
  } catch (error) {
    showAcceptable({ state: "refused", message: error.message });
  }
}

$("accept-force")?.addEventListener("change", (event) => { $("accept").disabled = !event.target.checked; });
$("accept")?.addEventListener("click", async () => {
  const button = $("accept");
  button.disabled = true;
  try {
    const found = await api(asked("/api/out/accept"), { force: $("accept-force").checked }, "POST", { quiet: true });
    $("accept-state").replaceChildren(...found.said.map((text) => line(`${text}.`)), line("Undo takes it back."));
    $("accept-ways").hidden = true;
    say("The plant is the model now.");
  } catch (error) {
    $("accept-state").replaceChildren(line(error.message, "message"));
    button.disabled = false;
  }
});
if ($("accept-state")) lookAcceptable();

// -- bundle -----------------------------------------------------------------------------------------------------------

function showBundle(told) {
  const place = $("bundle-said");
  $("bundle").disabled = told.state === "running";
  if (told.state === "running") place.replaceChildren(line(`${told.stage} … ${Math.round(told.seconds)} s`, "quiet"));
  else if (told.state === "failed") place.replaceChildren(line(told.error, "message"));
  else if (told.state === "done") {
    $("bundle-get").hidden = false;
    const names = line(`${told.names} has the original names and dates: keep it, and do not give it away with the bundle.`);
    place.replaceChildren(line(`Done: ${told.files.join(", ")}.`), ...told.said.map((text) => line(`${text}.`, "quiet")), names);
  }
  if (told.state === "running") setTimeout(lookBundle, 700);
}

async function lookBundle() {
  try {
    showBundle(await api("/api/out/bundle-state", undefined, "GET", { quiet: true }));
  } catch (error) {
    $("bundle-said").replaceChildren(line(error.message, "message"));
  }
}

$("bundle")?.addEventListener("click", async () => {
  $("bundle").disabled = true;
  try {
    showBundle(await api("/api/out/bundle", { replace: Boolean($("bundle-replace")?.checked) }));
  } catch {
    $("bundle").disabled = false;
  }
});
if ($("bundle")) lookBundle();
