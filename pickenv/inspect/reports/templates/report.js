// Brings the page's interactive figures to life: unpacks plotly, draws each in the page's colours, and lets all 3-D
// scenes of a figure turn together. Where anything is missing (no WebGL, an old browser), the still figure stays.
(async () => {
  "use strict";
  const places = [...document.querySelectorAll(".interactive")];
  if (!places.length || !window.DecompressionStream) return;
  const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const library = document.createElement("script");
  library.textContent = await new Response(stream).text();
  document.head.append(library);

  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const webgl = Boolean(document.createElement("canvas").getContext("webgl"));
  const scenes = (layout) => Object.keys(layout).filter((key) => key.startsWith("scene"));

  // Scenes side by side where there is room, else one below the other; a title above each.
  function arranged(layout, width) {
    const names = scenes(layout);
    const stacked = width < 220 * names.length;
    names.forEach((name, i) => {
      const low = i / names.length, high = (i + 1) / names.length;
      const domain = stacked ? { x: [0, 1], y: [1 - high, 1 - low - 0.03] } : { x: [low, high], y: [0, 0.93] };
      layout[name].domain = domain;
      Object.assign(layout.annotations[i], {
        x: (domain.x[0] + domain.x[1]) / 2, y: domain.y[1], xref: "paper", yref: "paper",
        xanchor: "center", yanchor: "bottom", showarrow: false,
      });
    });
    if (names.length) layout.height = stacked ? 330 * names.length + 90 : 430;
    return layout;
  }

  function themed(layout, width) {
    const axis = { gridcolor: css("--rule"), linecolor: css("--soft"), zerolinecolor: css("--rule"), color: css("--ink") };
    const kept = arranged(layout, width);
    Object.assign(kept, {
      width, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { color: css("--ink"), family: getComputedStyle(document.body).fontFamily, size: 13 },
      hoverlabel: { bgcolor: css("--card"), bordercolor: css("--soft"), font: { color: css("--ink") } },
    });
    for (const key of ["xaxis", "yaxis"]) if (kept[key]) Object.assign(kept[key], axis);
    for (const name of scenes(kept))
      for (const key of ["xaxis", "yaxis", "zaxis"]) Object.assign(kept[name][key], axis, { showbackground: false });
    return kept;
  }

  // What one scene's eye does, all do; `keep` is told where it stands.
  function together(place, names, keep) {
    let busy = false;
    const follow = (change) => {
      const moved = names.find((name) => change[`${name}.camera`]);
      if (busy || !moved) return;
      busy = true;
      const camera = change[`${moved}.camera`];
      keep(camera);
      const others = names.filter((name) => name !== moved).map((name) => [`${name}.camera`, camera]);
      Plotly.relayout(place, Object.fromEntries(others)).finally(() => { busy = false; });
    };
    place.on("plotly_relayouting", follow);
    place.on("plotly_relayout", follow);
  }

  // Arrow keys turn all scenes of a figure, Home puts them back.
  function keyboard(figure, place, spec, names) {
    const first = structuredClone(spec.layout[names[0]].camera.eye);
    const turns = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    figure.addEventListener("keydown", (event) => {
      if (event.key !== "Home" && !turns[event.key]) return;
      event.preventDefault();
      let { x, y, z } = spec.layout[names[0]].camera.eye;
      if (event.key === "Home") ({ x, y, z } = first);
      else {
        const [around, down] = turns[event.key].map((sign) => sign * Math.PI / 24);
        const far = Math.hypot(x, y, z), turn = Math.atan2(y, x) + around;
        const tilt = Math.min(Math.max(Math.acos(z / far) + down, 0.05), Math.PI - 0.05);
        [x, y, z] = [Math.sin(tilt) * Math.cos(turn), Math.sin(tilt) * Math.sin(turn), Math.cos(tilt)].map((v) => far * v);
      }
      names.forEach((name) => { spec.layout[name].camera = { ...spec.layout[name].camera, eye: { x, y, z } }; });
      Plotly.relayout(place, Object.fromEntries(names.map((name) => [`${name}.camera`, spec.layout[name].camera])));
    });
  }

  for (const place of places) {
    const spec = JSON.parse(document.getElementById(place.dataset.spec).textContent);
    const names = scenes(spec.layout);
    if (names.length && !webgl) continue;
    const figure = place.closest("figure");
    figure.classList.add("live");
    const layout = () => {
      const made = themed(structuredClone(spec.layout), place.clientWidth);
      place.style.height = `${made.height}px`;
      return made;
    };
    const config = { displayModeBar: false };
    try {
      await Plotly.newPlot(place, spec.data, layout(), config);
    } catch (error) {
      figure.classList.remove("live");
      console.error(error);
      continue;
    }
    together(place, names, (camera) => names.forEach((name) => { spec.layout[name].camera = camera; }));
    if (names.length) keyboard(figure, place, spec, names);
    const again = () => Plotly.react(place, spec.data, layout(), config);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
    let width = place.clientWidth;
    addEventListener("resize", () => {
      if (place.clientWidth && place.clientWidth !== width) again();
      width = place.clientWidth || width;
    });
  }
  document.documentElement.dataset.interactive = "ready";
})();
