// The controls, and what they change.

const element = (name) => document.getElementById(name);
const slider = element("depth");
const CHOICES = ["tool", "place", "other"];
const SETTINGS = {
  displaylogo: false, responsive: true,
  showSendToCloud: false, plotlyServerURL: "", // nothing leaves the page
  modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d", "resetCameraLastSave3d", "tableRotation"],
};
let group = CONTENT.groups[0];
let view = "corner";
let timer = null;
let asked = false;

function fixed(value, digits) {
  return value === null ? "–" : value.toFixed(digits).replace("-", "−");
}

function depthOf(state) {
  return `${Number(state.depth.toPrecision(4))} mm`;
}

/** Offer what there is to choose; a choice of one is none. */
function fillChoices() {
  for (const name of CHOICES) {
    const select = element(name), options = [...new Set(CONTENT.groups.map((one) => one[name]))];
    select.replaceChildren(...options.map((text) => new Option(text, text)));
    select.closest("label").hidden = options.length < 2;
    select.addEventListener("change", () => choose(name));
  }
}

/** Take the group that fits the choices; where none does, the first that fits the last choice. */
function choose(changed) {
  const fits = (one, names) => names.every((name) => one[name] === element(name).value);
  const depth = group.states[slider.value].depth;
  group = CONTENT.groups.find((one) => fits(one, CHOICES)) ?? CONTENT.groups.find((one) => fits(one, [changed]));
  begin(depth);
}

/** Set the controls to the group, at its depth nearest to the given one. */
function begin(depth) {
  for (const name of CHOICES) element(name).value = group[name];
  const off = group.states.map((state) => Math.abs(state.depth - depth));
  slider.max = group.states.length - 1;
  slider.disabled = group.states.length < 2;
  element("play").disabled = slider.disabled;
  slider.value = off.indexOf(Math.min(...off));
  ask();
}

/** Draw once per frame, however fast the slider moves. */
function ask() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    draw(group.states[slider.value]);
  });
}

function draw(state) {
  element("shown").textContent = depthOf(state);
  slider.setAttribute("aria-valuetext", `${depthOf(state)} deep`);
  numbers(state);
  // Before the charts, which are drawn as wide as their figures are.
  for (const name of ["area", "spectrum"]) {
    element(`${name}-figure`).classList.toggle("whole", !group.states.some((one) => one.spectrum));
  }
  show("tube", state.shape, "shape", () => tubeChart(group, state, view, element("tube")));
  show("section", state.shape, "shape", () => sectionChart(group, state));
  show("area", true, "along", () => (state.along ? areaChart : areaByDepth)(group, state));
  show("spectrum", state.spectrum, "spectrum", () => spectrumChart(group, state));
  show("signal", state.signal, "signal", () => signalChart(group, state, element("same").checked));
  document.querySelector(".scale").hidden = !state.signal;
  captions(state);
  document.body.dataset.drawn = `${CONTENT.groups.indexOf(group)} ${slider.value}`;
}

/** Draw a chart, or say why there is none. */
function show(name, there, reason, chart) {
  const picture = element(name);
  let missing = picture.nextElementSibling;
  if (!missing.classList.contains("missing")) {
    missing = document.createElement("p");
    missing.className = "missing";
    picture.after(missing);
  }
  missing.textContent = CONTENT.missing[reason] ?? "";
  missing.hidden = Boolean(there);
  picture.hidden = !there;
  if (there) Plotly.react(picture, ...chart(), SETTINGS);
}

function numbers(state) {
  const open = 100 * state.area / group.bore, signal = state.signal;
  const rows = [
    ["force", `${fixed(state.force, 2)} N`, ""],
    ["lumen height", `${fixed(state.height, 2)} mm`, ""],
    ["lumen area", `${fixed(state.area, 1)} mm²`, `${fixed(open, 0)} % open`],
  ];
  if (signal) {
    const error = signal.estimate === null ? "" : signal.estimate - group.position;
    rows.push(
      signal.estimate === null ? ["echo", "none detected", ""]
        : ["estimated distance", `${fixed(signal.estimate, 2)} cm`, `error ${error < 0 ? "" : "+"}${fixed(error, 2)} cm`],
      ["echo height", signal.amplitude === null ? "–" : `${Number(signal.amplitude.toPrecision(3))} %`, "of the send pulse"],
    );
  }
  element("numbers").replaceChildren(...rows.map(([name, value, more]) => {
    const box = document.createElement("div"), small = document.createElement("small");
    const dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = name;
    small.textContent = more;
    dd.append(value, " ", small);
    box.append(dt, dd);
    return box;
  }));
}

function captions(state) {
  const where = group.place ? ` at ${group.place}` : "", open = fixed(100 * state.area / group.bore, 0);
  const others = group.states.length > 1 ? " Pale: the other depths." : "";
  const said = {
    tube: `The silicone tube (beige), its lumen (blue) and the indenter (grey), in true proportions; the half towards you is cut away. ${cap(group.tool)}, ${depthOf(state)} deep${where}.`,
    section: `The tube across its axis, in the middle of the press: the lumen is ${fixed(state.height, 2)} mm high and ${fixed(state.width, 2)} mm wide.`,
    area: state.along
      ? `Cross-section of the lumen along the tube; at the press ${open} % of ${fixed(group.bore, 1)} mm² is open.${others}`
      : `Cross-section of the lumen at the press for all depths; ${open} % of ${fixed(group.bore, 1)} mm² is open.`,
    spectrum: state.spectrum
      ? `Reflected fraction of the plane wave's amplitude, by frequency. Dashed: cut-on frequencies of higher duct modes (nodal diameters, nodal circles). Open circles: the computation was still ringing.${others}`
      : "",
    signal: state.signal
      ? `Sound pressure ${fixed(state.signal.probe, 1)} cm from the source end, its envelope and the peaks found in it, each drawn where an echo of that delay would come from. Source end: ${state.signal.sourceEnd}.`
      : "",
  };
  for (const [name, text] of Object.entries(said)) {
    element(`${name}-caption`).textContent = text;
    element(name).setAttribute("aria-describedby", `${name}-caption`);
  }
}

function cap(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

function fillOrigin() {
  const table = (title, rows) => {
    const part = document.createElement("section"), head = document.createElement("h3");
    const body = document.createElement("table");
    head.textContent = title;
    for (const [name, value] of rows) {
      const row = body.insertRow(), th = document.createElement("th");
      th.scope = "row";
      th.textContent = name;
      row.append(th);
      row.insertCell().textContent = value;
    }
    part.append(head, body);
    return part;
  };
  const parts = [table("Origin", Object.entries(CONTENT.origin))];
  for (const [section, rows] of Object.entries(CONTENT.settings)) parts.push(table(`[${section}]`, rows));
  if (CONTENT.notes.length) {
    const notes = document.createElement("ul");
    notes.className = "notes";
    for (const text of CONTENT.notes) notes.appendChild(document.createElement("li")).textContent = text;
    parts.push(notes);
  }
  element("origin").replaceChildren(...parts);
}

function play(on) {
  clearInterval(timer);
  timer = on ? setInterval(() => {
    slider.value = Number(slider.value) < Number(slider.max) ? Number(slider.value) + 1 : 0;
    ask();
  }, 700) : null;
  element("play").setAttribute("aria-pressed", on);
  element("play").firstElementChild.textContent = on ? "❚❚" : "▶";
}

function look(chosen) {
  view = chosen;
  for (const button of document.querySelectorAll("[data-view]")) {
    button.setAttribute("aria-pressed", button.dataset.view === view);
  }
  ask();
}

/** Move the depth by the arrow keys from anywhere but a control that has its own use for them. */
function step(event) {
  const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  const modified = event.altKey || event.ctrlKey || event.metaKey || event.shiftKey;
  if (!by || modified || slider.disabled || event.target.closest("select, input:not([type=checkbox])")) return;
  event.preventDefault();
  play(false);
  slider.value = Number(slider.value) + by;
  ask();
}

fillChoices();
fillOrigin();
document.addEventListener("keydown", step);
slider.addEventListener("input", () => { play(false); ask(); });
element("same").addEventListener("change", ask);
element("play").addEventListener("click", () => play(timer === null));
element("controls").addEventListener("submit", (event) => event.preventDefault());
for (const button of document.querySelectorAll("[data-view]")) {
  button.addEventListener("click", () => look(button.dataset.view));
}
NARROW.addEventListener("change", ask);
const recorded = group.states.filter((state) => state.signal);
begin(recorded.length === group.states.length ? recorded[Math.floor(0.6 * recorded.length)].depth
  : (recorded.at(-1) ?? group.states[Math.floor(0.6 * group.states.length)]).depth);
