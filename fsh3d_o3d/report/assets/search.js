"use strict";
// Lays a hit over its query when it is clicked. The element <html> tells in data-rendered whether that can be done:
// "true" or "pictures" (no WebGL), and in data-shown which overlay is on view.
(() => {
  const root = document.documentElement;
  const data = JSON.parse(document.getElementById("report-data").textContent);
  const viewer = document.getElementById("viewer");
  const plot = document.getElementById("viewer-plot");

  const trace = (geometry, color, opacity) => {
    if (!("i" in geometry)) {
      return { type: "scatter3d", mode: "markers", hoverinfo: "skip", ...geometry, opacity, marker: { size: 2, color } };
    }
    return {
      type: "mesh3d", ...geometry, color, opacity, hoverinfo: "skip", flatshading: false,
      lighting: { ambient: 0.4, diffuse: 0.6, specular: 0.03, roughness: 0.8, fresnel: 0.05,
        vertexnormalsepsilon: 0, facenormalsepsilon: 0 },
    };
  };

  const layout = (reach) => {
    const axis = () => ({ visible: false, range: [-reach, reach], autorange: false });
    return {
      margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", showlegend: false,
      scene: { aspectmode: "cube", dragmode: "orbit", xaxis: axis(), yaxis: axis(), zaxis: axis(),
        camera: { eye: { ...data.eye }, up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: 0 } } },
    };
  };

  const show = async (button) => {
    const { result, hit } = button.dataset;
    const found = data.results[Number(result)];
    const shape = found.hits[Number(hit)];
    // Text, never HTML: it is the name of a file.
    document.getElementById("viewer-title").textContent = button.closest("li").querySelector(".name").textContent;
    viewer.showModal();
    const [own, other] = data.colors;
    const traces = [trace(found.query, own, 0.5), trace(shape.geometry, other, 1)];
    await Plotly.react(plot, traces, layout(shape.reach), { displaylogo: false, responsive: true, displayModeBar: false });
    root.dataset.shown = `${result}-${hit}`;
  };

  const tell = (message) => {
    const trouble = document.getElementById("trouble");
    trouble.textContent = message;
    trouble.hidden = false;
  };

  const canvas = document.createElement("canvas");
  const drawable = Boolean(canvas.getContext("webgl2") || canvas.getContext("webgl"));
  for (const button of document.querySelectorAll("button[data-hit]:enabled")) {
    button.disabled = !drawable;
    button.addEventListener("click", () => show(button).catch((error) => tell(`The overlay could not be drawn: ${error}`)));
  }
  viewer.addEventListener("close", () => { Plotly.purge(plot); delete root.dataset.shown; });
  if (!drawable) tell("This browser has no WebGL, so shapes cannot be laid over each other; the pictures remain.");
  root.dataset.rendered = drawable ? "true" : "pictures";
})();
