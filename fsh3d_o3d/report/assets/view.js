// Draws the page's one view from its data block. The element <html> tells in data-rendered how that went, as on other
// pages.
(() => {
  const { root, data, config } = shared;
  const { palette, color, ...arrays } = data.geometry;
  const colors = palette ? shared.painted(palette, color) : null;
  const trace = () => {
    if (!("i" in arrays)) return shared.points(arrays, { size: data.size, color: colors ?? data.color });
    const mesh = { ...shared.mesh(arrays, { ambient: 0.34, diffuse: 0.66 }), flatshading: data.flat, lightposition: data.light };
    return colors ? { ...mesh, vertexcolor: colors } : { ...mesh, color: data.color };
  };
  const tell = (outcome, message) => {
    root.dataset.rendered = outcome;
    if (message) shared.tell(message);
  };
  if (!shared.hasWebGL) {
    tell("pictures", "This browser has no WebGL, so the shape is shown as a still picture.");
    return;
  }
  const plot = document.getElementById("plot-view");
  Plotly.newPlot(plot, [trace()], shared.layout(data.reach), config).then(
    () => { plot.parentElement.classList.add("live"); tell("true"); },
    (error) => tell("failed", `The interactive plot could not be drawn: ${error}`),
  );
})();
