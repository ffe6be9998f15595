// Lays a hit over its query when it is clicked. The element <html> tells in data-rendered whether that can be done:
// "true" or "pictures" (no WebGL), and in data-shown which overlay is on view.
(() => {
  const { root, data, tell, hasWebGL } = shared;
  const viewer = document.getElementById("viewer");
  const plot = document.getElementById("viewer-plot");

  const trace = (geometry, color, opacity) => {
    if (!("i" in geometry)) return { ...shared.points(geometry, { size: 2, color }), opacity };
    return { ...shared.mesh(geometry, { ambient: 0.4, diffuse: 0.6 }), color, opacity };
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
    await Plotly.react(plot, traces, shared.layout(shape.reach), shared.config);
    root.dataset.shown = `${result}-${hit}`;
  };

  for (const button of document.querySelectorAll("button[data-hit]:enabled")) {
    button.disabled = !hasWebGL;
    button.addEventListener("click", () => show(button).catch((error) => tell(`The overlay could not be drawn: ${error}`)));
  }
  viewer.addEventListener("close", () => { Plotly.purge(plot); delete root.dataset.shown; });
  if (!hasWebGL) tell("This browser has no WebGL, so shapes cannot be laid over each other; the pictures remain.");
  root.dataset.rendered = hasWebGL ? "true" : "pictures";
})();
