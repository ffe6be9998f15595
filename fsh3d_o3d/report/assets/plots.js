"use strict";
// What every page's plots share. The script of a page follows in the same element.
const shared = (() => {
  const canvas = document.createElement("canvas");
  const axis = (reach) => ({ visible: false, range: [-reach, reach], autorange: false });
  return {
    root: document.documentElement,
    data: JSON.parse(document.getElementById("report-data").textContent),
    config: { displaylogo: false, responsive: true, displayModeBar: false },
    hasWebGL: Boolean(canvas.getContext("webgl2") || canvas.getContext("webgl")),

    mesh: (geometry, { ambient, diffuse }) => ({
      type: "mesh3d", ...geometry, flatshading: false, hoverinfo: "skip",
      lighting: { ambient, diffuse, specular: 0.03, roughness: 0.8, fresnel: 0.05,
        vertexnormalsepsilon: 0, facenormalsepsilon: 0 },
    }),
    points: (geometry, marker) => ({ type: "scatter3d", mode: "markers", hoverinfo: "skip", ...geometry, marker }),

    // A colour for each point from a palette and packed indices into it.
    painted: (palette, packed) => {
      const bytes = Uint8Array.from(atob(packed.bdata), (c) => c.charCodeAt(0));
      return Array.from(new Uint16Array(bytes.buffer), (k) => palette[k]);
    },

    // The cube about the origin with sides of twice the reach.
    layout: (reach) => ({
      margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", showlegend: false,
      scene: { aspectmode: "cube", dragmode: "orbit", xaxis: axis(reach), yaxis: axis(reach), zaxis: axis(reach),
        camera: { eye: { ...shared.data.eye }, up: { x: 0, y: 0, z: 1 }, center: { x: 0, y: 0, z: 0 } } },
    }),

    tell: (message) => {
      const trouble = document.getElementById("trouble");
      trouble.textContent = message;
      trouble.hidden = false;
    },
  };
})();
