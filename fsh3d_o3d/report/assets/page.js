// Draws the page's plots from its data block. The element <html> tells in data-rendered how that went:
// "true", "pictures" (no WebGL: still pictures stay in place of the 3D views) or "failed".
(() => {
  const { root, data, config } = shared;
  const ink = () => getComputedStyle(root).getPropertyValue("--ink").trim();
  const line = () => getComputedStyle(root).getPropertyValue("--line").trim();

  const trace = (view) => {
    const { palette, color, ...arrays } = data.geometries[view.geometry];
    if (!("i" in arrays)) {
      const colors = palette ? shared.painted(palette, color) : view.color;
      return shared.points(arrays, { size: view.size, color: colors });
    }
    const mesh = { ...shared.mesh(arrays, { ambient: 0.32, diffuse: 0.66 }), color: view.color, lightposition: view.light };
    if (!view.errors) return palette ? { ...mesh, vertexcolor: shared.painted(palette, color) } : mesh;
    return { ...mesh, color: undefined, intensity: data.errors.percent, colorscale: data.errors.colorscale,
      cmin: 0, cmax: data.errors.maximum, showscale: false, hoverinfo: undefined,
      hovertemplate: "%{intensity:.3g} %<extra></extra>" };
  };

  // One camera for all views: the others follow the one that was touched last, about once a frame.
  const link = (plots) => {
    let leader = null;
    let camera = null;
    const follow = () => {
      for (const plot of plots) {
        if (plot !== leader) Plotly.relayout(plot, { "scene.camera": structuredClone(camera) });
      }
      camera = null;
    };
    for (const plot of plots) {
      const lead = () => { leader = plot; };
      const moved = (event) => {
        if (plot !== leader || !event["scene.camera"]) return;  // an echo of a follower
        if (camera === null) setTimeout(follow, 16);
        camera = event["scene.camera"];
      };
      for (const touch of ["pointerdown", "mousedown", "touchstart", "wheel"]) {
        plot.addEventListener(touch, lead, { capture: true, passive: true });
      }
      plot.on("plotly_relayouting", moved);
      plot.on("plotly_relayout", moved);
    }
  };

  const energies = () => {
    const plot = document.getElementById("plot-energies");
    const grid = { gridcolor: line(), linecolor: line(), zeroline: false };
    const layout = {
      margin: { l: 64, r: 12, t: 12, b: 44 }, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: ink(), family: getComputedStyle(document.body).fontFamily, size: 13 }, showlegend: false,
      xaxis: { title: { text: "degree l" }, rangemode: "tozero", ...grid },
      yaxis: { title: { text: "energy" }, type: "log", exponentformat: "power", dtick: data.energies.dtick, ...grid },
    };
    const series = { type: "scatter", mode: data.energies.values.length > 150 ? "lines" : "lines+markers",
      y: data.energies.values, line: { color: "#c8553d", width: 1.6 }, marker: { size: 5 },
      hovertemplate: "degree %{x}: %{y:.3e}<extra></extra>" };
    return Plotly.react(plot, [series], layout, config);
  };

  const draw = async () => {
    await energies();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", energies);
    if (!shared.hasWebGL) return "pictures";
    const plots = await Promise.all(data.views.map(async (view) => {
      const plot = document.getElementById(view.id);
      await Plotly.newPlot(plot, [trace(view)], { ...shared.layout(data.reach), uirevision: "keep" }, config);
      plot.parentElement.classList.add("live");
      return plot;
    }));
    link(plots);
    return "true";
  };

  const tell = (outcome, message) => {
    root.dataset.rendered = outcome;
    if (message) shared.tell(message);
  };
  draw().then(
    (outcome) => tell(outcome, outcome === "pictures" &&
      "This browser has no WebGL, so the shapes are shown as still pictures."),
    (error) => tell("failed", `The interactive plots could not be drawn: ${error}`),
  );
})();
