"use strict";
// Each chart is a function from a group and a state to what plotly.js draws: traces and layout.

const CONTENT = JSON.parse(document.getElementById("content").textContent);
const COLOUR = CONTENT.colours;
const OTHERS = "#d9e0e6"; // curves of the other depths
const INK = "#1d2b38";
const NARROW = matchMedia("(max-width: 560px)");
const TYPES = { f4: Float32Array, i2: Int16Array, u2: Uint16Array, u4: Uint32Array };
const decoded = new Map();

/** Return an array of the page by its number. */
function values(number) {
  if (!decoded.has(number)) {
    const { type, scale, content } = CONTENT.arrays[number];
    const bytes = Uint8Array.from(atob(content), (letter) => letter.charCodeAt(0));
    const found = new TYPES[type](bytes.buffer);
    decoded.set(number, type === "i2" ? Float32Array.from(found, (value) => scale * value) : found);
  }
  return decoded.get(number);
}

/** Return every nth number of an array, from one on. */
function column(array, start, step) {
  const found = new array.constructor(array.length / step);
  for (let i = 0; i < found.length; i++) found[i] = array[start + step * i];
  return found;
}

/** Return one line through several curves, with gaps between them. */
function joined(curves) {
  return curves.flatMap((curve) => [...curve, null]);
}

function axis(title, more) {
  return {
    title: { text: title, standoff: 8 }, automargin: true, zeroline: false, gridcolor: "#edf0f3",
    linecolor: "#9aa6b1", ticks: "outside", ticklen: 4, tickcolor: "#9aa6b1", fixedrange: NARROW.matches,
    ...more,
  };
}

function layout(more) {
  return {
    margin: { l: 8, r: 12, t: 8, b: 8 }, paper_bgcolor: "#fff", plot_bgcolor: "#fff",
    font: { family: "system-ui, -apple-system, 'Segoe UI', Roboto, Arial, sans-serif", size: 13, color: INK },
    dragmode: NARROW.matches ? false : "zoom", hovermode: "closest", showlegend: false,
    legend: { orientation: "h", x: 0, y: 1.02, yanchor: "bottom" },
    hoverlabel: { bgcolor: "#fff" },
    ...more,
  };
}

function vertical(x, colour, dash) {
  return {
    type: "line", x0: x, x1: x, yref: "paper", y0: 0, y1: 1, line: { color: colour, width: 1.3, dash },
  };
}

function note(text, x, more) {
  return {
    text, x, yref: "paper", y: 1, xanchor: "left", yanchor: "top", showarrow: false,
    bgcolor: "rgba(255,255,255,0.85)", font: { size: 12 }, ...more,
  };
}

function mesh(points, faces, colour, shift) {
  return {
    type: "mesh3d", x: column(points, 2, 3), y: column(points, 0, 3),
    z: column(points, 1, 3).map((y) => y + shift),
    i: column(faces, 0, 3), j: column(faces, 1, 3), k: column(faces, 2, 3),
    color: colour, hoverinfo: "skip",
    lighting: {
      ambient: 0.6, diffuse: 0.7, specular: 0.08, roughness: 0.7, fresnel: 0.05,
      facenormalsepsilon: 0, vertexnormalsepsilon: 0, // small triangles are not degenerate
    },
    lightposition: { x: -2000, y: -30000, z: 30000 },
  };
}

const VIEWS = {
  corner: { eye: { x: -0.7, y: -1.5, z: 0.5 }, center: { x: -0.1, y: 0, z: -0.17 } },
  side: { eye: { x: 0, y: -1.7, z: 0.09 }, center: { x: 0, y: 0, z: -0.1 } },
  end: { eye: { x: -1.9, y: -0.7, z: 0.5 }, center: { x: 0.2, y: 0, z: -0.14 } },
};
const WIDE = 2.05; // width over height of a picture from which on the tube fits in at that distance

/** Look from a side, from further away where the picture is narrow. */
function camera(view, picture) {
  const away = Math.max(1, WIDE * picture.clientHeight / picture.clientWidth) ** 0.7;
  const { eye, center } = VIEWS[view];
  return { eye: Object.fromEntries(Object.entries(eye).map(([name, at]) => [name, away * at])), center };
}

/** The tube in space: plotly's x is along the tube, y across, z up. */
function tubeChart(group, state, view, picture) {
  const points = values(state.shape.points), faces = state.shape.faces;
  const size = group.diameter, reach = 2.3 * size;
  const low = (group.floor ?? -size / 2) - 0.04 * size, high = 1.46 * size;
  const traces = [
    mesh(points, values(faces.outer), COLOUR.wall, 0),
    mesh(points, values(faces.inner), COLOUR.lumen, 0),
    mesh(points, values(faces.cut), COLOUR.cut, 0),
  ];
  if (state.tool !== null) {
    const solid = group.solid;
    traces.push(mesh(values(solid.points), values(solid.faces), COLOUR.tool, state.tool));
  }
  if (group.floor !== null) {
    traces.push({
      type: "mesh3d", x: [-reach, reach, reach, -reach], y: [-0.35 * size, -0.35 * size, size, size],
      z: Array(4).fill(group.floor), i: [0, 0], j: [1, 2], k: [2, 3], color: COLOUR.floor, hoverinfo: "skip",
    });
  }
  const ranges = { x: [-reach, reach], y: [-0.35 * size, size], z: [low, high] };
  const quiet = { showbackground: false, gridcolor: "#eef1f4", zeroline: false, showspikes: false };
  const scene = { aspectmode: "manual", aspectratio: {}, camera: camera(view, picture), uirevision: view, dragmode: "orbit" };
  for (const [name, range] of Object.entries(ranges)) {
    scene.aspectratio[name] = (range[1] - range[0]) / (2 * reach) * 2;
    scene[`${name}axis`] = { ...quiet, range, nticks: 6, tickfont: { size: 11 } };
  }
  scene.xaxis.title = { text: "along the tube (mm)", font: { size: 12 } };
  scene.yaxis.title = { text: "across (mm)", font: { size: 12 } };
  scene.zaxis.title = { text: "up (mm)", font: { size: 12 } };
  scene.yaxis.nticks = scene.zaxis.nticks = 4;
  return [traces, layout({ scene, margin: { l: 0, r: 0, t: 0, b: 0 }, uirevision: view })];
}

function sectionChart(group, state) {
  const size = group.diameter, wide = 0.86 * size, low = -0.62 * size, high = 0.85 * size;
  const region = (outline, fill, name, line) => ({
    x: column(outline, 0, 2), y: column(outline, 1, 2), mode: "lines", fill: "toself", fillcolor: fill,
    line: { color: line, width: 1.5 }, name, hoverinfo: "name",
  });
  const traces = [
    region(values(state.shape.outer), COLOUR.wall, "wall", "#8f7a5e"),
    region(values(state.shape.inner), "#dbe9f5", "lumen", COLOUR.lumen),
  ];
  if (state.tool !== null) {
    const edge = values(group.solid.outline);
    const x = [...column(edge, 0, 2)], y = [...column(edge, 1, 2)].map((value) => value + state.tool);
    traces.push({
      x: [x[0], ...x, x[x.length - 1]], y: [high + size, ...y, high + size], mode: "lines", fill: "toself",
      fillcolor: COLOUR.tool, line: { color: "#6c7680", width: 1.5 }, name: "indenter", hoverinfo: "name",
    });
  }
  const shapes = group.floor === null ? [] : [{
    type: "rect", x0: -2 * size, x1: 2 * size, y0: group.floor - size, y1: group.floor,
    fillcolor: COLOUR.floor, line: { width: 0 }, layer: "below",
  }];
  return [traces, layout({
    shapes, xaxis: axis("across (mm)", { range: [-wide, wide], constrain: "domain" }),
    yaxis: axis("up (mm)", { range: [low, high], scaleanchor: "x", constrain: "domain" }),
  })];
}

function areaChart(group, state) {
  const placed = group.position !== null;
  const at = (one) => [...values(one.along.z)].map((z) => placed ? group.position + z / 10 : z);
  const others = group.states.filter((one) => one.along && one !== state);
  const reach = placed ? 0.5 * group.diameter : 5 * group.diameter, middle = placed ? group.position : 0;
  const traces = [
    {
      x: joined(others.map(at)), y: joined(others.map((one) => values(one.along.area))), mode: "lines",
      line: { color: OTHERS, width: 1 }, hoverinfo: "skip", name: "other depths",
    },
    {
      x: at(state), y: values(state.along.area), mode: "lines", fill: "tozeroy", fillcolor: "rgba(79,143,192,0.3)",
      line: { color: COLOUR.area, width: 2.5 }, name: "this depth",
      hovertemplate: `%{x:.2f} ${placed ? "cm" : "mm"}: %{y:.1f} mm²<extra></extra>`,
    },
  ];
  const title = placed ? "distance from the source end (cm)" : "distance from the press (mm)";
  return [traces, layout({
    shapes: [vertical(middle, COLOUR.press, "dot")],
    annotations: [note("press", middle, { y: 0, yanchor: "bottom", xshift: 4, font: { size: 12, color: COLOUR.press } })],
    xaxis: axis(title, { range: [middle - reach, middle + reach] }),
    yaxis: axis("lumen area (mm²)", { range: [0, 1.15 * group.bore] }),
  })];
}

/** Where no shape is stored: the area at the press, over all depths. */
function areaByDepth(group, state) {
  return [[
    {
      x: group.states.map((one) => one.depth), y: group.states.map((one) => one.area), mode: "lines+markers",
      line: { color: COLOUR.area }, hovertemplate: "%{x:g} mm deep: %{y:.1f} mm²<extra></extra>",
    },
    { x: [state.depth], y: [state.area], mode: "markers", marker: { size: 13, color: COLOUR.echo }, hoverinfo: "skip" },
  ], layout({
    xaxis: axis("depth (mm)", { rangemode: "tozero" }),
    yaxis: axis("lumen area at the press (mm²)", { range: [0, 1.15 * group.bore] }),
  })];
}

function spectrumChart(group, state) {
  const { frequency, reflection, settled, cutOns, carrier } = state.spectrum;
  const x = values(frequency), y = values(reflection), sure = values(settled);
  const others = group.states.filter((one) => one.spectrum && one !== state).map((one) => one.spectrum);
  const unsure = [...x.keys()].filter((i) => !sure[i]);
  const traces = [
    {
      x: joined(others.map((one) => values(one.frequency))), y: joined(others.map((one) => values(one.reflection))),
      mode: "lines", line: { color: OTHERS, width: 1 }, hoverinfo: "skip",
    },
    {
      x, y, mode: "lines", line: { color: COLOUR.envelope, width: 2.2 },
      hovertemplate: "%{x:.1f} kHz: |R00| = %{y:.3f}<extra></extra>",
    },
    {
      x: unsure.map((i) => x[i]), y: unsure.map((i) => y[i]), mode: "markers", hoverinfo: "skip",
      marker: { color: "#fff", size: 5, line: { color: COLOUR.envelope, width: 1.2 } },
    },
  ];
  const inside = cutOns.filter(([, at]) => at > x[0] && at < x[x.length - 1]);
  const called = (name) => `(${name[0]},${name[1]})`;
  const crowded = inside.map(([, at], i) => i > 0 && at - inside[i - 1][1] < 0.08 * (x[x.length - 1] - x[0]));
  return [traces, layout({
    shapes: [vertical(carrier, COLOUR.send), ...inside.map(([, at]) => vertical(at, COLOUR.echo, "dash"))],
    annotations: [
      note("carrier", carrier, { xanchor: "right", xshift: -3, font: { size: 12, color: COLOUR.send } }),
      ...inside.map(([name, at], i) => note(called(name), at, {
        xshift: 3, y: crowded[i] ? 0.9 : 1, font: { size: 12, color: COLOUR.echo },
      })),
    ],
    xaxis: axis("frequency (kHz)", { range: [x[0], x[x.length - 1]] }),
    yaxis: axis("reflected amplitude |R00|", { range: [0, Math.max(0.05, ...group.states.map(highest))] }),
  })];
}

function highest(state) {
  return state.spectrum ? 1.15 * values(state.spectrum.reflection).reduce((a, b) => Math.max(a, b)) : 0;
}

function signalChart(group, state, sameScale) {
  const signal = state.signal, at = values(signal.peakAt), peak = values(signal.peak);
  const heights = (sameScale ? group.states : [state]).map((one) => one.signal?.height ?? 0);
  const limit = Math.min(110, Math.max(0.05, 1.5 * Math.max(...heights)));
  const lesser = [...at.keys()].filter((i) => Math.abs(at[i] - (signal.estimate ?? -1)) > 0.01);
  const percent = "%{x:.2f} cm: %{y:.3g} %<extra></extra>";
  const traces = [
    {
      x: values(signal.distance), y: values(signal.pressure), mode: "lines", name: "pressure",
      line: { color: COLOUR.signal, width: 1 }, hoverinfo: "skip",
    },
    {
      x: values(signal.smooth), y: values(signal.envelope), mode: "lines", name: "envelope",
      line: { color: COLOUR.envelope, width: 2 }, hovertemplate: percent,
    },
    {
      x: lesser.map((i) => at[i]), y: lesser.map((i) => peak[i]), mode: "markers", name: "other peaks",
      marker: { color: "#fff", size: 8, line: { color: COLOUR.echo, width: 1.5 } }, hovertemplate: percent,
    },
    {
      x: [signal.estimate], y: [signal.amplitude], mode: "markers", name: "highest echo",
      marker: { color: COLOUR.echo, size: 10 }, hovertemplate: percent,
    },
  ];
  return [traces, layout({
    showlegend: true,
    shapes: [vertical(signal.probe, COLOUR.send), vertical(group.position, COLOUR.press, "dot")],
    annotations: [
      note(limit < 100 ? "send pulse, cut off" : "send pulse", signal.probe, { xshift: 4, font: { size: 12, color: COLOUR.send } }),
      note("true place", group.position, { y: 0, yanchor: "bottom", xshift: 4, font: { size: 12, color: COLOUR.press } }),
    ],
    xaxis: axis(NARROW.matches ? "distance (cm)" : "distance from the delay (cm)", { range: [0, group.length] }),
    yaxis: axis("% of the send pulse", { range: [-limit, limit] }),
  })];
}
