"use strict";
// Puts the scene into meshcat's tree and works the panel. `Scene` data: aridcal/pages/drawing/scene.py, scene_content().
(() => {
  const byId = (id) => document.getElementById(id);
  const THREE = MeshCat.THREE;
  const PANEL = `
    <details id="panel" open>
    <summary><b id="title"></b> <span id="count"></span> <span id="live"></span></summary>
    <p id="missing"></p>
    <section><h2>Position error <small>RMS of <span id="scored"></span></small></h2>
    <div id="stages"></div>
    <div id="effects"></div><p id="alone"></p></section>
    <section><h2><label for="field">Colour</label></h2><select id="field"></select>
    <div id="bar"></div><div id="ticks"></div></section>
    <section><h2><label for="factor">Magnified <output id="times"></output></label></h2>
    <input id="factor" type="range" min="0" step="1">
    <p>Needles point from the measured target to the predicted one, magnified. The ghost is the nominal robot; its
    deviation from the calibrated robot is magnified <output id="ghost"></output>.</p></section>
    <section><h2><label for="row">Robot at row <output id="line"></output></label>
    <button id="back" title="arrow left">&lt;</button><button id="on" title="arrow right">&gt;</button>
    <button id="worst">worst</button></h2>
    <input id="row" type="range" min="0" step="1" title="arrow keys step through the rows">
    <p id="here"></p><p id="limbs"></p><p id="readings"></p></section>
    <section><h2>Show</h2><div id="show"></div><p id="grid"></p></section>
    </details>
    <button id="flip" title="before or after calibration: key b"><span id="was"></span> → <span id="is"></span></button>`;

  let viewer;
  try {
    viewer = new MeshCat.Viewer(byId("meshcat-pane"));
  } catch (error) {
    byId("meshcat-pane").insertAdjacentHTML("afterend", PANEL);
    const box = document.createElement("div");
    box.className = "problem";
    box.textContent = "This browser cannot draw in 3D: WebGL is missing or switched off.";
    document.body.append(box);
    return;
  }

  // ---- light: set once, since meshcat cannot replace a lamp ---------------------------------------------------------
  viewer.set_property(["Background"], "visible", false); // the page's own background shows
  for (const name of ["PointLightNegativeX", "PointLightPositiveX"]) {
    viewer.set_property(["Lights", name], "visible", false); // they reach 10 m at most
  }
  viewer.scene_tree.find(["Lights", "FillLight", "<object>"]).object.intensity = 0.25;
  viewer.scene_tree.find(["Lights", "AmbientLight", "<object>"]).object.intensity = 0.5;
  const sun = new THREE.DirectionalLight(0xffffff, 0.55);
  sun.position.set(0.5, -0.7, 1);
  viewer.set_object(["Lights", "Sun"], sun);
  viewer.set_property(["Axes"], "visible", false);

  // What the user has chosen stays when another scene is shown.
  const shown = { calibrated: true, nominal: true, targets: true, vectors: true, train: true, test: true };
  let chosen = { row: 0, field: "none", own: false }; // own: a magnification of the user's
  let framed = null; // name and size of the scene that the camera was set to
  let ending = new AbortController(); // of the scene that is shown: takes its listeners away

  function show(data) {
    ending.abort();
    ending = new AbortController();
    const { signal } = ending;
    byId("panel")?.remove();
    viewer.delete_path(["robot"]);
    byId("meshcat-pane").insertAdjacentHTML("afterend", PANEL);
    byId("missing").textContent = data.notices.join("; ");
    const unpack = (text, Type) => new Type(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
    const floats = (text) => unpack(text, Float32Array);
    const measured = floats(data.measured);
    const flags = unpack(data.flags, Uint8Array);
    const count = flags.length;
    const stages = data.stages.map((stage) => ({ ...stage, error: floats(stage.error) }));
    const effects = data.effects.map((effect) => ({ ...effect, moved: unpack(effect.moved, Int16Array), on: true }));
    const places = floats(data.places);
    const sigma = floats(data.sigma);
    const length = (vectors, i) => Math.hypot(vectors[3 * i], vectors[3 * i + 1], vectors[3 * i + 2]);
    function rms(vectors, unit) {
      let square = 0;
      let used = 0;
      for (let i = 0; i < count; i++) {
        if (!(flags[i] & 4)) continue;
        square += length(vectors, i) ** 2;
        used += 1;
      }
      return unit * Math.sqrt(square / used);
    }
    const text = (value) => (value >= 100 ? value.toFixed(0) : value >= 1e-3 ? value.toPrecision(3) : value.toExponential(1));

    // ---- what is shown now -------------------------------------------------------------------------------------------
    const last = stages.length - 1;
    const ladder = data.factors.filter((f) => f <= 20 * data.factor);
    const { own, field } = chosen;
    const factor = own && ladder.includes(chosen.factor) ? chosen.factor : data.factor;
    const state = { stage: last, factor, own, row: Math.min(chosen.row, data.rows.length - 1), field };
    if (field === "sigma" && !sigma.length) state.field = "none";
    chosen = state;
    let current = stages[last].error; // of every row: what the stage shown leaves, less the effects switched off
    const millimetres = (i) => 1e3 * length(current, i);

    // ---- colours -----------------------------------------------------------------------------------------------------
    const stops = data.colours.map((c) => new THREE.Color(c));
    const sorted = Array.from(sigma).sort((a, b) => a - b);
    const known = [sorted[Math.floor(0.02 * sorted.length)], sorted[Math.floor(0.98 * sorted.length)]];
    const ranges = { none: data.range, error: data.range, sigma: [known[0], Math.max(known[1], 1.05 * known[0])] };
    function colour(mm) {
      const [low, high] = ranges[state.field];
      const t = Math.min(Math.max(Math.log(mm / low) / Math.log(high / low), 0), 1) * (stops.length - 1);
      const k = Math.min(Math.floor(t), stops.length - 2);
      return stops[k].clone().lerp(stops[k + 1], t - k);
    }

    // ---- the room: grid, camera --------------------------------------------------------------------------------------
    const triples = (flat) => Array.from({ length: flat.length / 3 }, (_, k) => new THREE.Vector3().fromArray(flat, 3 * k));
    const seen = triples(floats(data.seen));
    const box = new THREE.Box3().setFromPoints(seen);
    const centre = box.getCenter(new THREE.Vector3());
    const size = box.getSize(new THREE.Vector3());
    const extent = Math.max(size.length(), 1e-3);
    const decade = 10 ** Math.floor(Math.log10(extent / 4));
    const step = decade * [5, 2, 1].find((m) => m * decade <= extent / 4);
    const cells = 2 * Math.ceil(extent / step);
    const grid = new THREE.GridHelper(cells * step, cells, 0x77828f, 0x4a5561);
    grid.rotateX(Math.PI / 2);
    grid.position.set(centre.x, centre.y, box.min.z);
    viewer.set_object(["Grid"], grid);
    byId("grid").textContent = `Grid ${Number(step.toPrecision(1))} m. ` + "Axes at the robot's base: x red, y green, z blue. "
      + "White ring: target of the row; dashed ring: flagged as outlier.";

    const fov = 38;
    const tangent = Math.tan((fov * Math.PI) / 360);

    // The long side of the scene lies across the screen, seen from a little above; z is up, the camera's own up is y.
    function frameCamera() {
      const upright = viewer.dom_element.offsetWidth < viewer.dom_element.offsetHeight; // a phone: what is long is seen from its end
      const [alongX, alongY] = upright ? [-20, 70] : [-68, 22];
      const azimuth = ((size.x > 1.3 * size.y ? alongX : size.y > 1.3 * size.x ? alongY : -40) * Math.PI) / 180;
      const back = new THREE.Vector3(Math.cos(azimuth) * 0.93, Math.sin(azimuth) * 0.93, 0.37).normalize();
      const right = new THREE.Vector3(-back.y, back.x, 0).normalize();
      const up = back.clone().cross(right);
      const wide = viewer.dom_element.offsetWidth / viewer.dom_element.offsetHeight;
      const target = centre.clone();
      let distance = 2 * extent;
      for (let k = 0; k < 20; k++) {
        // Where things are on the screen (-1 to 1): move to their middle, then near enough that they fill it.
        const screen = seen.map((point) => {
          const from = point.clone().sub(target);
          const depth = Math.max(distance - from.dot(back), 0.05 * distance) * tangent;
          return [from.dot(right) / depth / wide, from.dot(up) / depth];
        });
        const [x, y] = [0, 1].map((n) => screen.map((s) => s[n]));
        const middle = (v) => (Math.max(...v) + Math.min(...v)) / 2;
        target.addScaledVector(right, middle(x) * distance * tangent * wide * 0.7);
        target.addScaledVector(up, middle(y) * distance * tangent * 0.7);
        distance *= (Math.max(Math.max(...x) - Math.min(...x), Math.max(...y) - Math.min(...y)) / 1.75) ** 0.7;
      }
      const inCamera = (v) => new THREE.Vector3(v.x, v.z, -v.y);
      Object.assign(viewer.camera, { fov, near: extent / 500, far: extent * 50 });
      viewer.camera.position.copy(inCamera(target.clone().addScaledVector(back, distance)));
      viewer.controls.target.copy(inCamera(target));
      viewer.controls.update();
      viewer.set_dirty();
    }

    // ---- the robot and its ghost -------------------------------------------------------------------------------------
    viewer.set_transform(["robot"], data.upright);
    const bufferGeometry = (g) => {
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.BufferAttribute(floats(g.vertices), 3));
      geometry.setIndex(new THREE.BufferAttribute(unpack(g.faces, g.wide ? Uint32Array : Uint16Array), 1));
      geometry.computeVertexNormals();
      return geometry;
    };
    const shapes = {
      box: (g) => new THREE.BoxGeometry(...g.size),
      cylinder: (g) => new THREE.CylinderGeometry(g.size[0], g.size[0], g.size[1], 40).rotateX(Math.PI / 2),
      sphere: (g) => new THREE.SphereGeometry(g.size[0], 32, 20),
      mesh: bufferGeometry,
    };
    const geometries = data.geometries.map((g) => shapes[g.kind](g));
    const ghost = new THREE.MeshPhongMaterial({
      color: 0x9fd0ff, transparent: true, opacity: 0.18, depthWrite: false, side: THREE.DoubleSide,
    });
    data.visuals.forEach((visual, k) => {
      const faceted = data.geometries[visual.geometry].kind === "mesh";
      const tint = data.limbs[data.limb[visual.body]];
      const own = new THREE.Color(...visual.colour);
      const paint = new THREE.MeshPhongMaterial({
        color: tint ? own.lerp(new THREE.Color(tint.colour), 0.6) : own, flatShading: faceted, side: faceted ? THREE.DoubleSide : THREE.FrontSide,
        shininess: 25, specular: 0x222222,
      });
      for (const [robot, material] of [["calibrated", paint], ["nominal", ghost]]) {
        if (robot === "nominal" && !data.corrected[visual.body]) continue; // a ghost in the same place only flickers
        const path = ["robot", robot, `body ${visual.body}`, `shape ${k}`];
        viewer.set_object(path, new THREE.Mesh(geometries[visual.geometry], material));
        viewer.set_transform(path, visual.matrix);
      }
    });
    const axes = new THREE.AxesHelper(0.12 * extent);
    viewer.set_object(["robot", "base"], axes);

    const poses = data.poses.map(floats);
    function pose(robot, row, body) {
      const k = 7 * (row * data.bodies + body);
      const p = poses[robot].subarray(k, k + 7);
      return [new THREE.Vector3(p[0], p[1], p[2]), new THREE.Quaternion(p[3], p[4], p[5], p[6]).normalize()];
    }
    const ghostFactor = () => Math.max((state.factor * data.ghost) / data.factor, 1);
    function placeRobots() {
      const one = new THREE.Vector3(1, 1, 1);
      for (let body = 0; body < data.bodies; body++) {
        const [at, turn] = pose(1, state.row, body);
        const [nominalAt, nominalTurn] = pose(0, state.row, body);
        const matrix = new THREE.Matrix4().compose(at, turn, one);
        viewer.set_transform(["robot", "calibrated", `body ${body}`], matrix.toArray());
        // Deviation of the nominal body, as a translation and a rotation vector, times the magnification.
        const off = nominalTurn.clone().multiply(turn.clone().invert());
        if (off.w < 0) off.set(-off.x, -off.y, -off.z, -off.w);
        const sine = Math.hypot(off.x, off.y, off.z);
        const angle = 2 * Math.atan2(sine, off.w) * ghostFactor();
        const about = sine > 1e-12 ? new THREE.Vector3(off.x, off.y, off.z).divideScalar(sine) : one;
        const magnified = new THREE.Quaternion().setFromAxisAngle(about, sine > 1e-12 ? angle : 0).multiply(turn);
        const moved = at.clone().addScaledVector(nominalAt.sub(at), ghostFactor());
        matrix.compose(moved, magnified, one);
        viewer.set_transform(["robot", "nominal", `body ${body}`], matrix.toArray());
      }
    }

    // ---- targets and error vectors -----------------------------------------------------------------------------------
    function sprite(draw) {
      const canvas = document.createElement("canvas");
      canvas.width = canvas.height = 64;
      const pen = canvas.getContext("2d");
      draw(pen);
      return new THREE.CanvasTexture(canvas);
    }
    const ball = sprite((pen) => {
      const shade = pen.createRadialGradient(24, 22, 2, 32, 32, 32);
      shade.addColorStop(0, "#fff");
      shade.addColorStop(1, "#999");
      pen.fillStyle = shade;
      pen.arc(32, 32, 31, 0, 7);
      pen.fill();
    });
    const ring = (width, dashes) => sprite((pen) => {
      pen.strokeStyle = "#fff";
      pen.lineWidth = width;
      pen.setLineDash(dashes);
      pen.arc(32, 32, 26, 0, 7);
      pen.stroke();
    });
    const cloud = (material) => {
      const points = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial(material));
      points.frustumCulled = false;
      points.renderOrder = material.depthTest === false ? 1 : 0; // rings last, over everything
      return points;
    };
    const dot = (count > 2000 ? 0.004 : 0.008) * extent; // across; three.js sizes points as if the view were 90° high
    const targets = cloud({ size: dot / tangent, map: ball, alphaTest: 0.5, vertexColors: true });
    const flagged = cloud({ size: (2.2 * dot) / tangent, map: ring(9, [14, 9.3]), color: 0xff6db6, transparent: true, depthTest: false });
    const here = cloud({ size: (3 * dot) / tangent, map: ring(6, []), color: 0xffffff, transparent: true, depthTest: false });
    viewer.set_object(["robot", "targets", "measured"], targets);
    viewer.set_object(["robot", "targets", "flagged"], flagged);
    viewer.set_object(["robot", "targets", "of this row"], here);
    const needle = new THREE.ConeGeometry(1, 1, 6).translate(0, 0.5, 0);
    const needles = new THREE.InstancedMesh(needle, new THREE.MeshBasicMaterial(), count);
    needles.frustumCulled = false;
    viewer.set_object(["robot", "vectors"], needles);

    const soft = sprite((pen) => {
      const shade = pen.createRadialGradient(32, 32, 2, 32, 32, 32);
      shade.addColorStop(0, "#ffff");
      shade.addColorStop(0.5, "#fffa");
      shade.addColorStop(1, "#fff0");
      pen.fillStyle = shade;
      pen.fillRect(0, 0, 64, 64);
    });
    const cell = extent / 16;
    const fog = cloud({ map: soft, vertexColors: true, transparent: true, depthWrite: false });
    viewer.set_object(["robot", "field"], fog);

    const target = (i) => new THREE.Vector3().fromArray(measured, 3 * i);
    const visible = () => [...flags.keys()].filter((i) => (flags[i] & 1 ? shown.test : shown.train));
    const setPoints = (points, rows) =>
      points.geometry.setAttribute("position", new THREE.Float32BufferAttribute(rows.flatMap((i) => target(i).toArray()), 3));
    const paint = (points, colours) =>
      points.geometry.setAttribute("color", new THREE.Float32BufferAttribute(colours.flatMap((c) => c.toArray()), 3));

    // Either what the model leaves, RMS of the targets in each cell of the room, or how well noise lets it know the target.
    function drawField() {
      const points = new Map();
      if (state.field === "error") {
        for (const i of visible()) {
          if (flags[i] & 2) continue;
          const key = [0, 1, 2].map((k) => Math.floor(measured[3 * i + k] / cell)).join();
          const sum = points.get(key) || points.set(key, { at: new THREE.Vector3(), square: 0, used: 0 }).get(key);
          sum.at.add(target(i));
          sum.square += millimetres(i) ** 2;
          sum.used += 1;
        }
        for (const sum of points.values()) Object.assign(sum, { at: sum.at.divideScalar(sum.used), value: Math.sqrt(sum.square / sum.used) });
      } else if (state.field === "sigma") {
        sigma.forEach((value, i) => points.set(i, { at: new THREE.Vector3().fromArray(places, 3 * i), value }));
      }
      const shownPoints = [...points.values()];
      fog.material.size = ((state.field === "sigma" ? 0.8 : 1.6) * cell) / tangent;
      fog.geometry.setAttribute("position", new THREE.Float32BufferAttribute(shownPoints.flatMap((p) => p.at.toArray()), 3));
      paint(fog, shownPoints.map((p) => colour(p.value)));
    }

    function drawTargets() {
      const rows = visible();
      const colours = rows.map((i) => colour(millimetres(i)));
      setPoints(targets, rows);
      paint(targets, colours);
      setPoints(flagged, rows.filter((i) => flags[i] & 2));
      const up = new THREE.Vector3(0, 1, 0);
      needles.count = rows.length;
      rows.forEach((i, k) => {
        const error = new THREE.Vector3().fromArray(current, 3 * i);
        const long = Math.max(error.length(), 1e-12);
        const turn = new THREE.Quaternion().setFromUnitVectors(up, error.divideScalar(long));
        const width = Math.min(0.35 * dot, 0.3 * long * state.factor);
        const scale = new THREE.Vector3(width, long * state.factor, width);
        needles.setMatrixAt(k, new THREE.Matrix4().compose(target(i), turn, scale));
        needles.setColorAt(k, colours[k]);
      });
      needles.instanceMatrix.needsUpdate = true;
      if (needles.instanceColor) needles.instanceColor.needsUpdate = true;
    }

    // ---- the panel ---------------------------------------------------------------------------------------------------
    const element = (tag, parent, content, properties) => {
      const made = Object.assign(document.createElement(tag), properties);
      if (content) made.append(content);
      parent.append(made);
      return made;
    };
    byId("title").textContent = data.title;
    byId("count").textContent = `${count} measured poses`;
    byId("scored").textContent = data.scored;
    stages.forEach((stage, k) => {
      const label = element("label", byId("stages"));
      const radio = element("input", label, null, { type: "radio", name: "stage", value: k });
      label.append(stage.name);
      stage.shown = element("b", label, `${text(stage.rms)} mm`);
      radio.addEventListener("change", () => update({ stage: k }));
    });
    const flip = () => update({ stage: state.stage === last ? 0 : last });
    byId("flip").addEventListener("click", flip);
    if (effects.length) element("h3", byId("effects"), "How far each effect moves the target, beyond what frames and constants can absorb");
    effects.forEach((effect) => {
      const label = element("label", byId("effects"));
      const tick = element("input", label, null, { type: "checkbox", name: "effect", checked: true });
      element("span", label, effect.name);
      element("b", label, `${text(rms(effect.moved, 1e3 * effect.step))} mm`);
      tick.addEventListener("change", () => {
        effect.on = tick.checked;
        update({ stage: last });
      });
    });
    const fields = { none: "targets by their error", error: "space by the errors in it" };
    if (sigma.length) fields.sigma = "reachable space by 1σ of the target";
    for (const [value, name] of Object.entries(fields)) element("option", byId("field"), name, { value });
    byId("field").value = state.field;
    byId("field").addEventListener("change", (event) => update({ field: event.target.value }));
    byId("bar").style.background = `linear-gradient(90deg, ${data.colours})`;
    const decades = Array.from({ length: 30 }, (_, k) => k - 20).flatMap((k) => [1, 2, 5].map((m) => m * 10 ** k));
    function drawScale() {
      const [low, high] = ranges[state.field];
      const within = decades.filter((v) => v >= low * 0.999 && v <= high * 1.001);
      let ticks = within.length > 5 ? within.filter((v) => /^1/.test(v.toExponential(0))) : within;
      if (ticks.length < 2) ticks = [low, high];
      byId("ticks").replaceChildren();
      for (const v of ticks) {
        const tick = element("span", byId("ticks"), `${Number(v.toPrecision(2))}${v === ticks[ticks.length - 1] ? " mm" : ""}`);
        tick.style.left = `${(100 * Math.log(v / low)) / Math.log(high / low)}%`;
      }
    }
    Object.assign(byId("factor"), { max: ladder.length - 1, value: ladder.indexOf(factor) });
    byId("factor").addEventListener("input", (event) => update({ factor: ladder[event.target.value], own: true }));
    Object.assign(byId("row"), { max: data.rows.length - 1, value: 0 });
    byId("row").addEventListener("input", (event) => update({ row: Number(event.target.value) }));
    const walk = (by) => update({ row: Math.min(Math.max(state.row + by, 0), data.rows.length - 1) });
    byId("back").addEventListener("click", () => walk(-1));
    byId("on").addEventListener("click", () => walk(1));
    byId("worst").addEventListener("click", () => {
      const off = data.rows.map((i) => (flags[i] & 2 ? 0 : millimetres(i)));
      update({ row: off.indexOf(Math.max(...off)) });
    });
    window.addEventListener("keydown", (event) => {
      if (["INPUT", "SELECT"].includes(event.target.tagName)) return;
      if (event.key === "b") flip();
      const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (by) walk(by);
    }, { signal });
    for (const limb of data.limbs) element("span", byId("limbs"), limb.name).style.color = limb.colour;
    const switches = {
      calibrated: "Calibrated", nominal: "Nominal ghost", targets: "Targets", vectors: "Error needles",
      train: "Fitted rows", test: "Held-out rows",
    };
    for (const [key, name] of Object.entries(switches)) {
      const label = element("label", byId("show"));
      const tick = element("input", label, null, { type: "checkbox", name: key, checked: shown[key] });
      label.append(name);
      tick.addEventListener("change", () => {
        shown[key] = tick.checked;
        update({});
      });
    }

    function update(change) {
      Object.assign(state, change);
      const i = data.rows[state.row];
      const off = state.stage === last ? effects.filter((effect) => !effect.on) : [];
      current = stages[state.stage].error;
      if (off.length) {
        current = current.map((value, k) => off.reduce((sum, effect) => sum - effect.step * effect.moved[k], value));
      }
      const after = text(off.length ? rms(current, 1e3) : stages[last].rms);
      stages[last].shown.textContent = `${after} mm`;
      byId("alone").textContent = off.length ? "Without the effects switched off: frames and constants refitted, other effects unchanged." : "";
      byId("was").textContent = `before ${text(stages[0].rms)} mm`;
      byId("is").textContent = `after ${after} mm`;
      byId("was").classList.toggle("on", state.stage === 0);
      byId("is").classList.toggle("on", state.stage === last);
      document.getElementsByName("stage").forEach((radio, k) => (radio.checked = k === state.stage));
      placeRobots();
      drawScale();
      drawTargets();
      drawField();
      setPoints(here, [i]);
      viewer.set_property(["robot", "calibrated"], "visible", shown.calibrated);
      viewer.set_property(["robot", "nominal"], "visible", shown.nominal);
      const room = state.field === "sigma"; // its colours mean something else than those of the targets
      viewer.set_property(["robot", "targets"], "visible", shown.targets && !room);
      viewer.set_property(["robot", "vectors"], "visible", shown.vectors && !room);
      viewer.set_dirty();
      byId("times").textContent = `×${state.factor}`;
      byId("ghost").textContent = `×${Number(ghostFactor().toPrecision(2))}`;
      byId("row").value = state.row;
      byId("line").textContent = data.line[i];
      const kind = [flags[i] & 1 ? "held-out row" : "fitted row", ...(flags[i] & 2 ? ["flagged as outlier"] : [])];
      const errors = stages.map((stage) => `${stage.name} ${text(1e3 * length(stage.error, i))}`);
      byId("here").textContent = `${kind.join(", ")}: ${errors.join(" → ")} mm`;
      byId("readings").replaceChildren();
      for (const joint of data.readings) {
        const line = element("span", byId("readings"));
        const name = element("span", line, joint.name);
        if (data.limbs[joint.limb]) name.style.color = data.limbs[joint.limb].colour;
        element("span", line, `${joint.values[state.row].toFixed(1)} ${joint.unit}`);
      }
    }
    const fit = () => viewer.set_3d_pane_size(viewer.dom_element.offsetWidth, viewer.dom_element.offsetHeight);
    window.addEventListener("resize", fit, { signal });
    if (window.innerWidth <= 720) {
      byId("panel").open = false;
      byId("panel").addEventListener("toggle", () => {
        fit();
        frameCamera();
      });
    } else byId("panel").querySelector("summary").addEventListener("click", (event) => event.preventDefault());
    update({});
    requestAnimationFrame(() => {
      fit();
      // Another result of the same robot is looked at from where the user stands.
      if (framed?.title !== data.title || Math.abs(Math.log(framed.extent / extent)) > 0.4) frameCamera();
      framed = { title: data.title, extent };
      document.documentElement.dataset.ready = "yes";
    });
  }

  const data = JSON.parse(byId("scene").textContent);
  show(data);
  window.calibrationScene = { viewer, show, script: data.script }; // for live.js
})();
