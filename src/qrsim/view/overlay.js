// What each browser draws over the scene by itself: labels that do not overlap, the ring round the chosen vehicle, legend,
// theme; and its camera: the first view, and following. Its data stands before it as `data`.
(() => {
  const before = window.qrsim;
  before?.ends();
  const same = before && before.names.length === data.names.length && before.names.every((n, i) => n === data.names[i]);
  // What survives when a flight becomes its replay.
  const state = same ? before.state : { chosen: null, followed: null, ride: null, framed: false, theme: before?.state.theme ?? null,
    lens: before?.state.lens ?? null, browser: null };
  const saved = () => { try { return localStorage.getItem("qrsim-theme"); } catch { return null; } };
  state.theme ??= saved() ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  document.title = data.title ? "qrsim - " + data.title : "qrsim";
  let m = null, ended = false, reasons = {}, states = {}, place = null, seen = "", laid = "", touched = false, framedIn = "";
  let legendOpen = null, lastFollowed = null, slots = {}, toned = 0, wish;

  const make = (tag, name, parent, text) => {
    const found = document.createElement(tag);
    if (name) found.className = name;
    if (text !== undefined) found.textContent = text;
    parent?.append(found);
    return found;
  };
  const style = make("style", "", document.head, data.css);
  const root = make("div", "", document.body);
  root.id = "qrsim-overlay";
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  root.append(svg);
  const draw = (tag, name) => {
    const found = document.createElementNS("http://www.w3.org/2000/svg", tag);
    found.setAttribute("class", name);
    svg.append(found);
    return found;
  };
  const north = make("div", "qrsim-north", root, "N");
  const leaders = draw("path", "qrsim-leaders"), halo = draw("circle", "qrsim-halo"), ring = draw("circle", "qrsim-ring");
  const labels = make("div", "qrsim-labels", root);
  const tools = make("div", "qrsim-tools", root);
  const tool = (text, title, act) => {
    const button = make("button", "", tools, text);
    button.title = title;
    button.onclick = () => { act(); button.blur(); };
    return button;
  };
  tool("Show all", "look at all vehicles and routes (F)", () => extra.go("Overview"));
  const themeTool = tool("", "dark or light", () => theme(state.theme === "dark" ? "light" : "dark"));
  const { theme, exact } = themeIn({ data, state, button: themeTool, nodes: () => nodes(), m: () => m });
  tool("Legend", "what is what", () => { legendOpen = !legendOpen; touched = true; seen = ""; });
  const legend = make("div", "qrsim-legend", root);
  const showBar = colourBarIn(root), bar = root.querySelector(".qrsim-bar");
  const css = (colour) => "rgb(" + colour.join(",") + ")";
  const rows = data.legend.map((row) => {
    const line = make("div", "qrsim-row", legend), mark = make("i", "qrsim-" + row.kind, line);
    if (row.kind === "scale") mark.style.background = "linear-gradient(90deg," + row.colours.map(css).join(",") + ")";
    else mark.style.color = css(row.colours[0]);
    return { ...row, line, words: make("span", "", line, row.text) };
  });

  // ---- the scene as viser has it ----

  const nodes = () => window.__viserSceneTree?.getState() ?? {};
  const shown = (tree, name) => {
    const node = tree[name];
    return !!node && node.visibility !== false && node.overrideVisibility !== false;
  };
  const floats = (array) =>
    array instanceof Float32Array ? array : new Float32Array(array.buffer, array.byteOffset, array.byteLength / 4);
  // Places of all vehicles [m], NED, and how large they are drawn [m]; null before they are there. The same object until viser has new ones.
  let sources = [];
  const places = (tree) => {
    const bodies = data.bodies.map(([name]) => tree[name]?.message?.props);
    if (!bodies.every((props) => props?.batched_positions)) return null;
    const now = bodies.flatMap((props) => [props.batched_positions, props.batched_scales, props.batched_wxyzs]);
    if (place && now.every((array, number) => array === sources[number])) return place;
    const found = new Float32Array(3 * data.names.length), turn = new Float32Array(4 * data.names.length);
    let span = 0;
    data.bodies.forEach(([, members], body) => {
      const [at, sizes, turns] = now.slice(3 * body, 3 * body + 3).map(floats);
      members.forEach((vehicle, row) => {
        found.set(at.subarray(3 * row, 3 * row + 3), 3 * vehicle);
        turn.set(turns.subarray(4 * row, 4 * row + 4), 4 * vehicle);
      });
      span = Math.max(span, sizes[0]);
    });
    sources = now;
    return span > 0 ? { at: found, turn, span } : null;
  };
  const at3 = (...ned) => new m.camera.position.constructor(...ned).applyMatrix4(matrix());
  const three = (vehicle) => at3(...place.at.subarray(3 * vehicle, 3 * vehicle + 3));
  const matrix = () => m.nodeRefFromName["/world"].matrixWorld;
  const tangent = () => Math.tan((m.camera.fov * Math.PI) / 360);
  // Pixels of the canvas, and how large a vehicle is there; null behind the camera.
  const pixel = (vehicle, box) => pixelOf(three(vehicle), box);
  const pixelOf = (at, box) => {
    const depth = -at.clone().applyMatrix4(m.camera.matrixWorldInverse).z;
    if (depth <= m.camera.near) return null;
    const { x, y } = at.project(m.camera);
    const radius = (0.5 * place.span * box.height) / (2 * depth * tangent());
    return { x: ((x + 1) * box.width) / 2, y: ((1 - y) * box.height) / 2, radius, depth };
  };
  const canvasBox = () => m.canvas.getBoundingClientRect();
  // What panels leave of the canvas, in its pixels; `whole`: with what the table covers.
  const free = (box, whole = false) => {
    let [left, top, right, bottom] = [0, Math.max(44, 16 + tools.offsetHeight), box.width, box.height];
    const bar = document.getElementById("qrsim-timeline")?.getBoundingClientRect();
    if (bar) bottom = Math.min(bottom, bar.top - box.top);
    const plots = document.getElementById("qrsim-plots")?.getBoundingClientRect();
    if (plots?.height) bottom = Math.min(bottom, plots.top - box.top);
    const sheet = document.querySelector(".mantine-Paper-root[style*='min-height: 3.5em']")?.getBoundingClientRect();
    // In a picture it is hidden, and has no size.
    if (sheet?.height) bottom = Math.min(bottom, sheet.top - box.top);
    const panel = document.getElementById("qrsim-panel")?.getBoundingClientRect();
    if (panel && box.width > 700) right = Math.min(right, panel.left - box.left);
    // On a small screen the panel of an exported page is a line under the tools, while it is closed.
    else if (panel && panel.height < 90) top = Math.max(top, panel.bottom - box.top + 6);
    if (!whole && table.box.offsetHeight) top = table.box.offsetTop + table.box.offsetHeight + 6;
    if (legendOpen && box.width > 700) left = legend.offsetWidth + 12;
    return { left, top, right, bottom: Math.max(bottom, top + 40), width: right - left, height: bottom - top };
  };

  // ---- the camera ----

  const SHARE = data.names.length + data.ways.length === 1 ? 0.35 : data.names.length <= 20 ? 0.6 : 0.75;
  // The box of all vehicles and routes as a camera sees them that looks at `middle` from `away` [three coordinates].
  const boxOf = (points, middle, away, box) => {
    const forward = away.clone().negate().normalize(), up = m.camera.up;
    const right = forward.clone().cross(up).normalize(), above = right.clone().cross(forward);
    const eye = middle.clone().add(away), per = box.height / (2 * tangent());
    let [left, top, r, bottom, near] = [Infinity, Infinity, -Infinity, -Infinity, Infinity];
    for (const point of points) {
      const from = point.clone().sub(eye), depth = Math.max(from.dot(forward), 1e-3);
      const x = box.width / 2 + (per * from.dot(right)) / depth, y = box.height / 2 - (per * from.dot(above)) / depth;
      const wide = (0.5 * place.span * per) / depth;
      near = Math.min(near, depth);
      left = Math.min(left, x - wide); r = Math.max(r, x + wide);
      // Vehicles are flat.
      top = Math.min(top, y - 0.5 * wide); bottom = Math.max(bottom, y + 0.5 * wide);
    }
    return { left, top, right: r, bottom, per, near, axes: [right, above] };
  };
  const share = (found, room) => Math.max((found.right - found.left) / room.width, (found.bottom - found.top) / room.height);
  const all = () => [...data.names.map((_, vehicle) => three(vehicle)), ...data.ways.map((place) => at3(...place))];
  const look = (middle, away, smooth) => {
    const eye = middle.clone().add(away), control = m.cameraControl;
    if (smooth) return control.setLookAt(...eye.toArray(), ...middle.toArray(), true);
    control.setPosition(...eye.toArray(), false);
    control.setTarget(...middle.toArray(), false);
  };
  const frame = (smooth, from = data.from) => {
    if (!place) return;
    state.ride = null;
    const Vector = m.camera.position.constructor, box = canvasBox(), room = free(box), points = all(), turned = extra.lens(from === extra.down);
    const low = points[0].clone(), high = points[0].clone();
    for (const point of points) { low.min(point); high.max(point); }
    const middle = low.clone().add(high).multiplyScalar(0.5);
    const away = new Vector(...from).transformDirection(matrix());
    let far = Math.max(4 * place.span, 1.5 * high.distanceTo(low));
    for (let turn = 0; turn < 30; turn++) {
      const found = boxOf(points, middle, away.clone().multiplyScalar(far), box);
      const dx = (found.left + found.right) / 2 - (room.left + room.right) / 2;
      const dy = (found.top + found.bottom) / 2 - (room.top + room.bottom) / 2;
      // As far as the nearest one has to go: with the mean distance a row that leads away from the camera would be overshot.
      const pixel = Math.min(found.near, far) / found.per;
      middle.addScaledVector(found.axes[0], dx * pixel).addScaledVector(found.axes[1], -dy * pixel);
      far *= Math.min(2, Math.max(0.5, share(found, room) / SHARE));
    }
    if (state.followed !== null) follow(null);
    look(middle, away.multiplyScalar(far), smooth && !turned && from !== extra.down);
  };
  const follow = (vehicle) => {
    const anew = vehicle !== null && vehicle !== state.followed;
    state.followed = vehicle;
    lastFollowed = null;
    if (!anew || !place) return;
    const Vector = m.camera.position.constructor, control = m.cameraControl;
    const away = control.getPosition(new Vector()).sub(control.getTarget(new Vector()));
    const far = Math.min(away.length(), 7 * place.span * extra.farther());
    look(three(vehicle), away.setLength(far), false);
    lastFollowed = three(vehicle);
    state.framed = true;
  };
  const keepUp = () => {
    if (state.followed === null) return;
    const now = three(state.followed), Vector = m.camera.position.constructor, control = m.cameraControl;
    if (lastFollowed && now.distanceToSquared(lastFollowed) > 0) {
      const step = now.clone().sub(lastFollowed), target = control.getTarget(new Vector()).add(step);
      const eye = control.getPosition(new Vector()).add(step);
      control.setPosition(...eye.toArray(), false);
      control.setTarget(...target.toArray(), false);
    }
    lastFollowed = now;
  };

  // ---- labels, legend, scale ----

  const made = {};
  const label = (vehicle) => {
    made[vehicle] ??= make("div", "qrsim-label", labels);
    const found = made[vehicle], why = reasons[vehicle] ?? "", colour = data.colours[data.colourOf[vehicle]];
    const lines = states[vehicle] ?? [], apart = differences.of(vehicle);
    const key = why + (state.chosen === vehicle) + apart + lines.join();
    if (found.key !== key) {
      found.key = key;
      found.replaceChildren();
      make("i", "", found).style.background = css(why ? data.stopped : colour);
      make("b", "", found, data.names[vehicle] + (apart && "\u2002" + apart));
      // No number is parted from its name and unit.
      if (why) make("span", "", found, why.replace(/ = /g, "\u00a0=\u00a0").replace(/(\d) (\S+)$/, "$1\u00a0$2"));
      for (const line of lines) make("span", "", found, line);
      found.classList.toggle("qrsim-chosen", state.chosen === vehicle);
      found.classList.toggle("qrsim-stopped", !!why);
      found.size = null;
    }
    found.style.display = "";
    found.size ??= [found.offsetWidth, found.offsetHeight];
    return found;
  };
  const differences = differencesIn(svg, data.differences);
  // Vehicles whose labels are seen, with their boxes in pixels of the canvas; the vehicle under a pixel, or null.
  let named = [];
  const labelAt = (x, y) => named.find(([, own]) => hits(own, [x, y, x, y]))?.[0] ?? null;
  const layLabels = (tree, box) => {
    const room = free(box), few = data.names.length <= data.mostLabels;
    const wanted = few ? data.names.map((_, i) => i) : Object.keys(reasons).map(Number).slice(-data.mostLabels);
    if (state.chosen !== null && !wanted.includes(state.chosen)) wanted.push(state.chosen);
    const visible = shown(tree, "/world/names") && shown(tree, "/world/vehicles");
    const spots = (visible ? wanted : []).map((vehicle) => ({ vehicle, ...pixel(vehicle, box) })).filter((s) => "x" in s);
    const rank = (s) => (s.vehicle === state.chosen ? 0 : s.vehicle in reasons ? 1 : 2);
    spots.sort((a, b) => rank(a) - rank(b) || a.depth - b.depth);
    const taken = [tools, extra.scale, bar, legend, table.box, root.querySelector(".qrsim-sky"), ...extra.boxes()].filter((e) => e.offsetWidth).map((e) => {
      const r = e.getBoundingClientRect();
      return [r.left - box.left, r.top - box.top, r.right - box.left, r.bottom - box.top];
    });
    const tip = shown(tree, "/world/ground") ? pixelOf(at3(...data.north), box) : null;
    north.style.display = tip ? "" : "none";
    if (tip) north.style.transform = `translate(${tip.x - 5}px,${tip.y - 9}px)`;
    if (tip) taken.push([tip.x - 8, tip.y - 10, tip.x + 8, tip.y + 10]);
    const left = new Set(Object.keys(made).map(Number));
    let lines = "";
    named = [];
    for (const spot of spots) {
      if (spot.x < 0 || spot.y < 0 || spot.x > box.width || spot.y > room.bottom) continue;
      const found = label(spot.vehicle), [w, h] = found.size, may = around(spot, found.size);
      const order = [...may.keys()];
      if (slots[spot.vehicle] !== undefined) order.unshift(slots[spot.vehicle]);
      const slot = order.find((number) => {
        const [x, y] = may[number], own = [x - 2, y - 2, x + w + 2, y + h + 2];
        const inside = x >= 2 && y >= 2 && x + w <= box.width - 2 && y + h <= room.bottom - 2;
        return inside && !taken.some((other) => hits(own, other));
      });
      slots[spot.vehicle] = slot;
      if (slot === undefined) { found.style.display = "none"; left.delete(spot.vehicle); continue; }
      const [x, y] = may[slot];
      taken.push([x, y, x + w, y + h]);
      named.push([spot.vehicle, [x, y, x + w, y + h]]);
      found.style.transform = `translate(${Math.round(x)}px,${Math.round(y)}px)`;
      if (slot >= 8) lines += `M${spot.x},${spot.y}L${Math.min(Math.max(spot.x, x), x + w)},${y < spot.y ? y + h : y}`;
      left.delete(spot.vehicle);
    }
    for (const vehicle of left) { made[vehicle].remove(); delete made[vehicle]; }
    leaders.setAttribute("d", lines);
    const spot = state.chosen === null || !shown(tree, "/world/vehicles") ? null : pixel(state.chosen, box);
    for (const circle of [halo, ring]) {
      circle.style.display = spot ? "" : "none";
      if (!spot) continue;
      circle.setAttribute("cx", spot.x); circle.setAttribute("cy", spot.y);
      circle.setAttribute("r", Math.max(13, 1.25 * spot.radius));
    }
  };
  const sized = (value) => (value >= 10 ? value.toFixed(0) : value.toPrecision(2).replace(/\.0$/, ""));
  const layLegend = (tree, box) => {
    const room = free(box), under = box.height - room.bottom, narrow = box.width <= 700;
    const covered = document.getElementById("qrsim-plots")?.offsetHeight || table.box.offsetHeight;
    extra.scale.style.bottom = under + 10 + "px";
    // On a small screen it is over the scale, and not there while plots or the table are open.
    legend.style.bottom = under + (narrow ? 50 : 10) + "px";
    // Under the tools, and under the sky where it is shown.
    const sky = root.querySelector(".qrsim-sky");
    sky.style.top = room.top + 2 + "px";
    const top = sky.offsetHeight ? sky.offsetTop + sky.offsetHeight : room.top - 4;
    const high = box.height - under - top - (narrow ? 80 : 20);
    legend.style.maxHeight = Math.max(0, high) + "px";
    legend.style.display = legendOpen && !(narrow && covered) && high > 80 ? "" : "none";
    bar.style.bottom = under + 48 + "px";
    const some = Object.keys(reasons).length > 0;
    for (const row of rows) {
      const wanted = (!row.layer || shown(tree, row.layer)) && (some || !row.ifStopped);
      row.line.style.display = wanted ? "" : "none";
    }
    const times = place.span / data.trueSpan;
    const size = rows.find((row) => row.kind === "size");
    if (size) put(size.words, times > 1.05 ? `vehicles are drawn ${sized(times)} x their size` : "vehicles in true size");
  };

  // ---- the loop ----

  const ready = () => {
    const found = window.__viserMutable;
    return found?.camera && found.cameraControl && found.canvas && found.nodeRefFromName["/world"] ? found : null;
  };
  const touch = () => { touched = true; };
  const begin = () => {
    theme(state.theme, false);
    extra.listen(m.canvas);
    m.canvas.addEventListener("pointerdown", touch);
    m.canvas.addEventListener("wheel", touch);
    const handle = document.querySelector("[style*='height: 3.5em'][style*='cursor: pointer']");
    // On a small screen the panel would hide the scene.
    if (!same && innerWidth < 600) handle?.click();
  };
  const step = () => {
    if (ended) return;
    requestAnimationFrame(step);
    const found = ready();
    if (!found) return;
    if (found !== m) { m = found; seen = ""; begin(); }
    const tree = nodes(), now = places(tree);
    if (!now) return;
    if (!place) document.getElementById("qrsim-loading")?.remove();
    if (now !== place) { place = now; seen = ""; }
    const box = canvasBox(), eye = m.camera.matrixWorld.elements.join();
    if (performance.now() - toned > 400) { toned = performance.now(); exact(); }
    legendOpen ??= box.width > 700;
    // Again while panels and sizes settle, until somebody moves the camera.
    const { top, right, bottom } = free(box), room = [right, bottom, box.width, box.height].join();
    if (data.frame && !touched && room !== framedIn && state.followed === null) {
      if (!state.framed || framedIn) frame(false);
      framedIn = room;
      state.framed = true;
    }
    if (wish !== undefined) { follow(wish); wish = undefined; }
    keepUp();
    extra.ride();
    extra.keepLens();
    const marks = data.layers.map((name) => shown(tree, name)).join();
    // What changes it without a word: all else resets `seen`.
    const mark = [eye, box.left, box.top, box.width, box.height, top, bottom, marks, state.chosen, legendOpen].join("|");
    if (mark === seen) return;
    seen = mark;
    // The same words again would cost a layout.
    const at = `left:${box.left}px;top:${box.top}px;width:${box.width}px;height:${box.height}px`;
    if (at !== laid) root.style.cssText = laid = at;
    table.fit(free(box, true));
    layLegend(tree, box);
    extra.lay(box);
    const apart = data.differences && shown(tree, data.differences.path) && shown(tree, "/world/vehicles");
    differences.draw(apart, place.at, (vehicle) => pixel(vehicle, box), rows);
    layLabels(tree, box);
  };
  const extra = toolsIn({
    data, state, make, tools, root, draw, tool, nodes, floats, shown, at3, pixel, pixelOf, canvasBox, free, labelAt, tangent, frame, look, follow, touch,
    m: () => m, world: matrix, place: () => place, again: () => { seen = ""; },
  });
  const table = tableIn({ data, state, make, root, tool, css, again: () => { seen = ""; }, choose: (vehicle) => { state.chosen = vehicle; seen = ""; } });
  const key = (event) => {
    if (event.target.closest?.("input, textarea, select, [contenteditable]")) return;
    if (event.key.toLowerCase() === "f" && !event.ctrlKey && !event.metaKey && !event.altKey) frame(true);
  };
  window.addEventListener("keydown", key);
  window.qrsim = {
    names: data.names, state, frame, theme,
    colour: (vehicle) => css(data.colours[data.colourOf[vehicle]]),
    choose: (vehicle) => { state.chosen = vehicle; seen = ""; },
    follow: (vehicle) => { wish = vehicle; },
    browser: (told) => { state.browser = told; },
    ride: (told) => { state.ride = told; },
    reasons: (found) => { reasons = found; seen = ""; },
    states: (found) => { states = found; seen = ""; },
    sky: skyIn(root), tools: extra, table,
    paint: (told) => { showBar(told); seen = ""; },
    // The box of all vehicles and routes, what panels leave free, and how much of that it fills; pixels of the page.
    box: () => {
      const box = canvasBox(), room = free(box), Vector = m.camera.position.constructor, control = m.cameraControl;
      const middle = control.getTarget(new Vector()), away = control.getPosition(new Vector()).sub(middle);
      const { left, top, right, bottom } = boxOf(all(), middle, away, box), f = share({ left, top, right, bottom }, room);
      const on = (r) => [r.left + box.left, r.top + box.top, r.right + box.left, r.bottom + box.top];
      return { vehicles: on({ left, top, right, bottom }), free: on(room), share: f };
    },
    ends: () => {
      ended = true;
      window.removeEventListener("keydown", key);
      m?.canvas.removeEventListener("pointerdown", touch);
      m?.canvas.removeEventListener("wheel", touch);
      extra.ends();
      table.ends();
      root.remove(); style.remove();
    },
  };
  theme(state.theme, false);
  table.begin();
  for (const [what, content] of Object.entries(window.qrsimTold ?? {})) window.qrsim[what](content);
  requestAnimationFrame(step);
})();
