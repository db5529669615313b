// Turns the error fields of explorer-fields.js in place of the still picture of docs/explorer.md. Needs no library.
"use strict";
(() => {
  const { arms, plants, colours, seed, poses } = window.explorerFields;
  const host = document.getElementById("explorer");
  const option = ({ plant }) => `<option${plant === "qiao2026" ? " selected" : ""}>${plant}</option>`;
  const button = ({ label }) => `<button type="button">${label}</button>`;
  host.className = "explorer";
  host.innerHTML = `
    <div class="row">
      <label>Plant <select>${plants.map(option).join("")}</select></label>
      <span class="row" role="group" aria-label="Calibration">${plants[0].stages.map(button).join("")}</span>
      <label><input type="checkbox"> Enlarge what is left</label>
    </div>
    <canvas tabindex="0" role="application" aria-label="Error field. Arrow keys turn it, Home turns it back."></canvas>
    <div class="row scale"><span>0</span><i></i><span></span></div>
    <p role="status"></p>
    <label class="row">Place <input type="range" min="1"></label>
    <p role="status"></p>
    <p><small>Drag, or use the arrow keys; Home turns back. Point at a dot, tap it, or move the slider.</small></p>`;
  const find = (what) => host.querySelector(what);
  const [select, canvas, enlarge, slider] = ["select", "canvas", "[type=checkbox]", "[type=range]"].map(find);
  const buttons = [...host.querySelectorAll("button")], [said, saidOfPlace] = host.querySelectorAll("[role=status]");
  const pen = canvas.getContext("2d"), still = matchMedia("(prefers-reduced-motion: reduce)");

  const START = { turn: 0.7, tilt: 0.35 }, STEP = Math.PI / 24, FAR = 4, MORPH_MS = 400, NEAR_PX = 16;
  const view = { ...START };
  let plant, stage, lines, middle, radius, errors, scale, project;

  const norm = (vector) => Math.hypot(...vector);
  const minus = (a, b) => a.map((value, i) => value - b[i]);
  const mix = (a, b, t) => a.map((value, i) => value + t * (b[i] - value));

  // What is shown now: a stage of a plant, its errors in mm, and how they are coloured and enlarged.
  function choose(newStage) {
    const from = errors;
    stage = newStage;
    const { label, mean_mm, largest_mm, errors_um } = plant.stages[stage];
    const part = enlarge.checked ? largest_mm / plant.scale_mm : 1;
    const to = { field: errors_um.map((e) => e.map((v) => v / 1000)), top: plant.scale_mm * part, gain: plant.gain / part };
    scale = to;
    buttons.forEach((each, i) => each.setAttribute("aria-pressed", i === stage));
    find(".scale span:last-child").textContent = `${to.top.toFixed(2)} mm`;
    said.innerHTML = `<b>${plant.plant}, ${label}</b>: mean <b>${mean_mm.toFixed(2)} mm</b>, largest
      <b>${largest_mm.toFixed(2)} mm</b> at ${errors_um.length} places. Arrows are ${Number(to.gain.toPrecision(2))} times
      too long. Simulated; ${made(label)}; seed ${seed}.`;
    place(slider.value - 1);
    morph(from && from.length === to.field.length ? from : to.field, to.field);
  }

  function made(label) {
    if (label === "raw") return "not calibrated";
    return `calibrated from ${poses[0]} poses${label.includes("+") ? `, the rest learnt from ${poses[1]}` : ""}`;
  }

  // Arrows shrink and grow from one stage to the next, unless the reader wants no motion.
  function morph(from, to) {
    const begin = performance.now();
    (function step(now) {
      const t = still.matches ? 1 : Math.min(Math.max((now - begin) / MORPH_MS, 0), 1);
      if (scale.field !== to) return;
      errors = t < 1 ? from.map((vector, i) => mix(vector, to[i], t)) : to;
      draw();
      if (t < 1) requestAnimationFrame(step);
    })(begin);
  }

  function show() {
    plant = plants[select.selectedIndex];
    lines = arms[plant.arm];
    const all = lines.flat(), ends = (pick) => [0, 1, 2].map((axis) => pick(...all.map((point) => point[axis])));
    middle = mix(ends(Math.min), ends(Math.max), 0.5);
    radius = Math.max(...all.map((point) => norm(minus(point, middle))));
    slider.max = lines.length;
    const raw = plant.stages[0].errors_um.map(norm);
    slider.value = 1 + raw.indexOf(Math.max(...raw));
    choose(stage ?? 0);
  }

  function place(number) {
    slider.value = number + 1;
    const at = lines[number].at(-1).map((mm) => (mm / 1000).toFixed(2).replace("-", "−"));
    saidOfPlace.innerHTML = `Place ${number + 1} of ${lines.length}, at x ${at[0]}, y ${at[1]}, z ${at[2]} m:
      <b>${norm(scale.field[number]).toFixed(2)} mm</b>`;
  }

  // Screen positions and nearness of points in mm, seen from where the reader turned to.
  function look() {
    const [turn, tilt] = [view.turn, view.tilt].flatMap((angle) => [[Math.cos(angle), Math.sin(angle)]]);
    const { clientWidth: width, clientHeight: height } = canvas, size = 0.56 * Math.min(width, height) / radius;
    project = (point) => {
      const [x, y, z] = minus(point, middle);
      const right = x * turn[0] - y * turn[1], back = x * turn[1] + y * turn[0];
      const depth = back * tilt[0] - z * tilt[1], up = z * tilt[0] + back * tilt[1];
      const near = size * FAR * radius / (FAR * radius + depth);
      return [width / 2 + near * right, height / 2 - near * up, near / size];
    };
  }

  const colourOf = (mm) => {
    const at = Math.min(mm / scale.top, 1) * (colours.length - 1), low = Math.min(Math.floor(at), colours.length - 2);
    return `rgb(${mix(colours[low], colours[low + 1], at - low).map(Math.round).join()})`;
  };

  function stroke(points, width) {
    pen.lineWidth = width;
    pen.beginPath();
    points.forEach((point, i) => pen[i ? "lineTo" : "moveTo"](point[0], point[1]));
    pen.stroke();
  }

  function arrow(from, to, width) {
    stroke([from, to], width);
    const along = minus(to, from).slice(0, 2), length = norm(along);
    if (length < 5) return;
    const [x, y] = along.map((value) => value * Math.min(5, 0.4 * length) / length);
    stroke([[to[0] - x - y / 2, to[1] - y + x / 2], to, [to[0] - x + y / 2, to[1] - y - x / 2]], width);
  }

  function draw() {
    const sharp = devicePixelRatio, ink = getComputedStyle(host).color, chosen = slider.value - 1;
    canvas.width = canvas.clientWidth * sharp;
    canvas.height = canvas.clientHeight * sharp;
    pen.scale(sharp, sharp);
    pen.lineJoin = pen.lineCap = "round";
    look();
    axes(ink);
    pen.strokeStyle = pen.fillStyle = ink;
    pen.globalAlpha = 0.45;
    stroke(lines[chosen].map(project), 5);
    lines[chosen].slice(0, -1).forEach((corner) => ring(project(corner), 5, "fill"));
    pen.globalAlpha = 1;
    const seen = lines.map((line, i) => ({ i, from: project(line.at(-1)), mm: norm(errors[i]) }));
    for (const { i, from, mm } of seen.sort((a, b) => a.from[2] - b.from[2])) {
      const wanted = lines[i].at(-1);
      pen.strokeStyle = pen.fillStyle = colourOf(mm);
      arrow(from, project(wanted.map((value, axis) => value + scale.gain * errors[i][axis])), 1.6 * from[2]);
      ring(from, 2.2 * from[2], "fill");
      if (i !== chosen) continue;
      pen.strokeStyle = ink;
      ring(from, 8, "stroke");
    }
  }

  function ring(at, size, how) {
    pen.beginPath();
    pen.arc(at[0], at[1], size, 0, 2 * Math.PI);
    pen[how]();
  }

  // x, y and z at the arm's base, a quarter as long as what is drawn is wide.
  function axes(ink) {
    const base = lines[0][0];
    pen.strokeStyle = pen.fillStyle = ink;
    pen.font = "12px sans-serif";
    ["x", "y", "z"].forEach((name, axis) => {
      const end = project(base.map((value, i) => value + (i === axis ? radius / 4 : 0)));
      arrow(project(base), end, 1);
      pen.fillText(name, end[0] + 4, end[1] - 4);
    });
  }

  function turnBy(turn, tilt) {
    view.turn += turn;
    view.tilt = Math.min(Math.max(view.tilt + tilt, -Math.PI / 2), Math.PI / 2);
    draw();
  }

  function pointAt(event) {
    const box = canvas.getBoundingClientRect(), pointer = [event.clientX - box.left, event.clientY - box.top];
    const gaps = lines.map((line) => norm(minus(pointer, project(line.at(-1)))));
    const nearest = gaps.indexOf(Math.min(...gaps));
    if (gaps[nearest] > NEAR_PX || nearest === slider.value - 1) return;
    place(nearest);
    draw();
  }

  const KEYS = { ArrowLeft: [STEP, 0], ArrowRight: [-STEP, 0], ArrowUp: [0, STEP], ArrowDown: [0, -STEP] };
  canvas.addEventListener("keydown", (event) => {
    if (event.key !== "Home" && !KEYS[event.key]) return;
    event.preventDefault();
    if (event.key === "Home") Object.assign(view, START);
    turnBy(...(KEYS[event.key] ?? [0, 0]));
  });
  canvas.addEventListener("pointermove", (event) => (
    event.buttons ? turnBy(-event.movementX / 150, event.movementY / 150) : pointAt(event)));
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("click", pointAt);
  select.addEventListener("change", show);
  enlarge.addEventListener("change", () => choose(stage));
  slider.addEventListener("input", () => { place(slider.value - 1); draw(); });
  buttons.forEach((each, i) => each.addEventListener("click", () => choose(i)));
  find("i").style.background = `linear-gradient(to right, ${colours.map((rgb) => `rgb(${rgb})`).join()})`;
  new ResizeObserver(draw).observe(canvas);
  new MutationObserver(draw).observe(document.body, { attributes: true, attributeFilter: ["data-theme"] });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  show();
})();
